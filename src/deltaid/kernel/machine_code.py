"""Machine code of a graph, compiled in the process and kept on disk.

No C compiler is needed: LLVM comes with llvmlite. Kernels are compiled for this machine's
processor, or for a level of `DELTAID_KERNEL_CPU`. Results of different processors differ by
rounding; tests and studies set the level to measure that.
"""

import ctypes
import ctypes.util
import functools
import os
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import casadi as ca
import llvmlite.binding as llvm

from deltaid.errors import DescriptionError
from deltaid.kernel import llvm_ir, store
from deltaid.kernel.llvm_ir import KERNEL_NAME, LIBM_NAMES, vector_ir

# Number of instructions from which on code is not optimised: that would take minutes.
_LONG = 20_000

_POINTER, _INT = ctypes.c_void_p, ctypes.c_int64

VARIABLE = "DELTAID_KERNEL_CPU"
# Levels of the x86-64 psABI: doubles per vector, and the features that a level requires.
_LEVELS = {
    "x86-64-v2": (4, ("sse4.2", "popcnt")),
    "x86-64-v3": (4, ("avx2", "fma", "bmi2")),
    "x86-64-v4": (8, ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")),
}


@dataclass(frozen=True)
class Target:
    """Processor that machine code is compiled for.

    Attributes:
        cpu: LLVM's name of the processor.
        features: LLVM's features in addition to those that the name implies.
        width: samples (doubles) per instruction.
    """

    cpu: str
    features: str
    width: int


def target() -> Target:
    """This machine's processor, or the level that `DELTAID_KERNEL_CPU` names.

    Raises:
        DescriptionError: the level does not exist, or this machine does not support it.
    """
    return _target(os.environ.get(VARIABLE, ""))


@functools.cache
def _target(level: str) -> Target:
    present = llvm.get_host_cpu_features()
    if not level:
        width = 8 if present.get("avx512f", False) else 4
        return Target(llvm.get_host_cpu_name(), present.flatten(), width)
    usable = [name for name, (_, needed) in _LEVELS.items() if all(map(present.get, needed))]
    if level not in usable:
        raise DescriptionError(
            f"is {level!r}, which this machine cannot run",
            where=VARIABLE,
            cure=f"use one of {', '.join(usable)}, or unset it" if usable else "unset it",
        )
    return Target(level, "", _LEVELS[level][0])


class CompiledKernel:
    """Machine code of a function, loaded from the cache or compiled and saved there.

    Args:
        graph: function of batched and uniform inputs with one dense output.
        width: samples per instruction.
        apart: whether `call` reads and writes different memory.

    Attributes:
        call: machine code with arguments (out, stride of out, in, stride of in, uniform, number of
            samples).
    """

    def __init__(self, graph: ca.Function, width: int, *, apart: bool = True) -> None:
        lanes = f"{width} lanes" if apart else f"{width} lanes, one memory"
        name = store.key(graph.serialize(), *_circumstances(target()), lanes)
        code = store.load(name)
        if code is None:
            once = merged(graph)
            is_long = once.n_instructions() > _LONG
            code = _compile(vector_ir(once, width, apart=apart), 0 if is_long else 2)
            store.save(name, code)
        self._engine = _engine(code)  # keeps the code alive
        self.call = ctypes.CFUNCTYPE(None, _POINTER, _INT, _POINTER, _INT, _POINTER, _INT)(
            self._engine.get_function_address(KERNEL_NAME)
        )


def merged(graph: ca.Function) -> ca.Function:
    """Merge common subexpressions of a function."""
    inputs = graph.sx_in()
    return ca.Function("f", inputs, ca.cse(graph.call(inputs)))


@functools.cache
def _initialise() -> None:
    """Initialise LLVM for this machine and register libm's functions."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    libm = ctypes.CDLL(ctypes.util.find_library("m") or "ucrtbase")
    for name in LIBM_NAMES:
        address = ctypes.cast(getattr(libm, name), ctypes.c_void_p).value
        assert address is not None
        llvm.add_symbol(name, address)


@functools.cache
def _circumstances(cpu: Target) -> tuple[str | bytes, ...]:
    """Everything else that the machine code of a graph depends on."""
    versions = [version(package) for package in ("deltaid", "casadi", "llvmlite")]
    return (
        *versions,
        str(llvm.llvm_version_info),
        llvm.get_process_triple(),
        cpu.cpu,
        cpu.features,
        Path(llvm_ir.__file__).read_bytes(),
        Path(__file__).read_bytes(),
    )


def _compile(assembly: str, level: int) -> bytes:
    """Machine code at a level of optimisation."""
    return _machine(level).emit_object(llvm.parse_assembly(assembly))


def _engine(code: bytes) -> llvm.ExecutionEngine:
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())  # owns both
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _machine(level: int = 2) -> llvm.TargetMachine:
    _initialise()
    cpu = target()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu.cpu, features=cpu.features, opt=level, jit=True
    )
