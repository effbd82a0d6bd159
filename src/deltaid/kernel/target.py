"""The processor that kernels are compiled for: this machine's, or a plainer one on request.

Results for different processors differ by rounding, so two machines give two sets of bits. Tests
and studies ask for another processor to see what that changes.
"""

import functools
import os
from dataclasses import dataclass

import llvmlite.binding as llvm

from deltaid.errors import DescriptionError

VARIABLE = "DELTAID_KERNEL_CPU"
# Levels of the x86-64 psABI: doubles in a vector, and the features that tell whether a processor
# has the level.
_LEVELS = {
    "x86-64-v2": (4, ("sse4.2", "popcnt")),
    "x86-64-v3": (4, ("avx2", "fma", "bmi2")),
    "x86-64-v4": (8, ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")),
}


@dataclass(frozen=True)
class Target:
    """What machine code is made for.

    Attributes:
        cpu: name of the processor, as LLVM knows it.
        features: of it, beyond those that its name stands for.
        width: samples (doubles) that one instruction works on.
    """

    cpu: str
    features: str
    width: int


def target() -> Target:
    """This machine's processor, or the level that `DELTAID_KERNEL_CPU` names.

    Raises:
        DescriptionError: there is no such level, or this machine does not have it.
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
