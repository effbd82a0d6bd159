"""What the benchmarks share: options, a stopwatch and a description of the machine."""

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import llvmlite.binding as llvm

PACKAGES = ("deltaid", "numpy", "casadi", "llvmlite", "clarabel", "cvxpy", "pin")


def options(doc: str, **defaults: object) -> argparse.Namespace:
    """Options of a command, whose docstring begins with what it does.

    Each has the type of its default; False makes a flag, a type stands for no default, and a list
    takes words without a name.
    """
    parser = argparse.ArgumentParser(description=doc.split("\n", 1)[0])
    for name, default in defaults.items():
        match default:
            case bool():
                parser.add_argument(f"--{name}", action="store_true")
            case list():
                parser.add_argument(name, nargs="*", default=default)
            case type():
                parser.add_argument(f"--{name}", type=default)
            case _:
                parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser.parse_args()


def measure(
    function: Callable[[], object], repeats: int = 7, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Median time [s] of `repeats` calls; a call before them, not counted, warms up.

    With `time.process_time` as clock it is the CPU time of all threads of this process, which for
    work on one thread is the wall time of an idle machine and does not count waiting for others.
    """
    function()
    seconds = []
    for _ in range(repeats):
        start = clock()
        function()
        seconds.append(clock() - start)
    return statistics.median(seconds)


def machine() -> str:
    """CPU, cores, Python and package versions, on two lines."""
    cpu = f"{_cpu_model()} ({llvm.get_host_cpu_name()}), {os.cpu_count()} cores"
    versions = [f"Python {platform.python_version()}", *filter(None, map(_version, PACKAGES))]
    return f"{cpu}, {platform.system()}\n{', '.join(versions)}"


def _cpu_model() -> str:
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
