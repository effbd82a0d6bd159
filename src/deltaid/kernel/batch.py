"""The batch kernel: one SX graph evaluated for any number of samples, compiled in the process.

No C compiler is needed: LLVM comes with llvmlite. Arrays hold samples in columns, shape
(entries, samples), which is also what a column-major factorisation wants to read.
"""

import ctypes
import ctypes.util
import functools
import os
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import llvmlite.binding as llvm
import numpy as np
from jaxtyping import Float

from deltaid.kernel.llvm_ir import KERNEL_NAME, LIBM_NAMES, vector_ir

# Samples a thread takes at a time: small enough that in- and outputs of a block stay in the cache.
BLOCK = 2048

_POINTER, _INT = ctypes.c_void_p, ctypes.c_int64


class BatchKernel:
    """A CasADi function of a batched and a uniform input, evaluated over samples in columns.

    Args:
        batched: SX inputs that differ from sample to sample, stacked.
        output: SX expression; its dense column-major entries become the output's rows.
        uniform: SX inputs that all samples share (parameters), stacked.

    The same code runs for every sample whatever the batch size or the number of threads, so equal
    inputs give equal bits. Results agree with CasADi's own evaluator to rounding; `function` is
    that evaluator.
    """

    def __init__(self, batched: ca.SX, output: ca.SX, uniform: ca.SX | None = None) -> None:
        shared = ca.SX(0, 1) if uniform is None else uniform
        dense = ca.vec(ca.densify(output))
        self.function = ca.Function("f", [batched, shared], ca.cse([dense]))
        self.n_in, self.n_out, self.n_uniform = batched.numel(), dense.numel(), shared.numel()
        self._width = _vector_width()
        self._engine = _compile(vector_ir(self.function, self._width))
        self._call = ctypes.CFUNCTYPE(None, _POINTER, _INT, _POINTER, _INT, _POINTER, _INT)(
            self._engine.get_function_address(KERNEL_NAME)
        )

    def __call__(
        self,
        x: Float[np.ndarray, "n_in samples"],
        uniform: Float[np.ndarray, " n_uniform"] | None = None,
        threads: int | None = None,
    ) -> Float[np.ndarray, "n_out samples"]:
        """Evaluate all samples, on all cores unless `threads` says otherwise."""
        x = np.asarray(x, dtype=float)
        n = x.shape[1]
        out = np.empty((self.n_out, n))
        starts = range(0, n, BLOCK)
        workers = min(threads or os.cpu_count() or 1, len(starts))
        work = functools.partial(self._block, x, self._uniform(uniform), out)
        if workers <= 1:
            for start in starts:
                work(start)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(work, starts))
        return out

    def _uniform(self, uniform: Float[np.ndarray, " n"] | None) -> Float[np.ndarray, " n"]:
        values = np.ascontiguousarray(np.zeros(0) if uniform is None else uniform, dtype=float)
        if values.shape != (self.n_uniform,):
            raise ValueError(f"the kernel has {self.n_uniform} uniform inputs, not {values.size}")
        return values

    def _block(
        self,
        x: Float[np.ndarray, "n_in samples"],
        uniform: Float[np.ndarray, " n_uniform"],
        out: Float[np.ndarray, "n_out samples"],
        start: int,
    ) -> None:
        """One block of samples; the last block's end is padded up to the vector width."""
        stop = min(start + BLOCK, x.shape[1])
        full = start + (stop - start) // self._width * self._width
        whole = x[:, start:full]
        if full > start and whole.strides[1] == x.itemsize and out.strides[1] == out.itemsize:
            self._run(whole, uniform, out[:, start:full])
        elif full > start:
            out[:, start:full] = self._padded(whole, uniform)
        if stop > full:
            out[:, full:stop] = self._padded(x[:, full:stop], uniform)

    def _padded(
        self, x: Float[np.ndarray, "n_in samples"], uniform: Float[np.ndarray, " n_uniform"]
    ) -> Float[np.ndarray, "n_out samples"]:
        n = x.shape[1]
        padding = -n % self._width
        padded = np.ascontiguousarray(np.pad(x, ((0, 0), (0, padding)), mode="edge"))
        out = np.empty((self.n_out, n + padding))
        self._run(padded, uniform, out)
        return out[:, :n]

    def _run(
        self,
        x: Float[np.ndarray, "n_in samples"],
        uniform: Float[np.ndarray, " n_uniform"],
        out: Float[np.ndarray, "n_out samples"],
    ) -> None:
        strides = (out.strides[0] // out.itemsize, x.strides[0] // x.itemsize)
        self._call(
            out.ctypes.data, strides[0], x.ctypes.data, strides[1], uniform.ctypes.data, x.shape[1]
        )


def _vector_width() -> int:
    """Doubles per vector register of this machine, at least 4."""
    return 8 if llvm.get_host_cpu_features().get("avx512f", False) else 4


@functools.cache
def _initialise() -> None:
    """Start LLVM for this machine and make libm's functions known to it."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    libm = ctypes.CDLL(ctypes.util.find_library("m") or ctypes.util.find_library("msvcrt"))
    for name in LIBM_NAMES:
        address = ctypes.cast(getattr(libm, name), ctypes.c_void_p).value
        assert address is not None
        llvm.add_symbol(name, address)


def _compile(assembly: str) -> llvm.ExecutionEngine:
    _initialise()
    module = llvm.parse_assembly(assembly)
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        jit=True,
    )
    engine = llvm.create_mcjit_compiler(module, machine)  # owns both from here on
    engine.finalize_object()
    return engine
