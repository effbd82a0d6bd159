"""What the benchmarks share: a stopwatch and a description of the machine."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import llvmlite.binding as llvm

PACKAGES = ("deltaid", "numpy", "casadi", "llvmlite", "clarabel", "cvxpy", "pin")


def measure(function: Callable[[], object], repeats: int = 7) -> float:
    """Median wall time [s] of `repeats` calls; a call before them, not counted, warms up."""
    function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def machine() -> str:
    """CPU, cores, Python and package versions, on two lines."""
    cpu = f"{_cpu_model()} ({llvm.get_host_cpu_name()}), {os.cpu_count()} cores"
    versions = [f"Python {platform.python_version()}", *filter(None, map(_version, PACKAGES))]
    return f"{cpu}, {platform.system()}\n{', '.join(versions)}"


def _cpu_model() -> str:
    """The CPU's name as the system gives it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str:
    """'numpy 2.4.6', or nothing if the package is not installed."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return ""
