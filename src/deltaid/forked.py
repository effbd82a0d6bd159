"""Detection of forks that break polars: a forked process lacks its threads and waits forever."""

import os
import sys

# Linux's list of threads, and how the names of polars' threads begin.
_TASKS, _OF_POLARS = "/proc/self/task", ("polars-0", "polars-1")
_began = _lost = False


def _before() -> None:
    """Record whether polars has started threads; without /proc, whether it is loaded."""
    global _began
    _began = "polars" in sys.modules
    if _began and os.path.isdir(_TASKS):
        _began = any(_name(task).startswith(_OF_POLARS) for task in os.listdir(_TASKS))


def _name(task: str) -> str:
    try:
        with open(f"{_TASKS}/{task}/comm") as file:
            return file.read()
    except OSError:  # the thread has ended meanwhile
        return ""


def _after() -> None:
    global _lost
    _lost = _lost or _began


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_after)


def require_threads() -> None:
    """Refuse to use polars in a process where its calls would never return.

    Raises:
        DeltaidError: the process was forked from one that had used polars.
    """
    if _lost:
        from deltaid.errors import DeltaidError

        raise DeltaidError(
            "was forked from one that had read recordings, and lacks its threads",
            where="this process",
            cure='start processes with multiprocessing.get_context("spawn") or "forkserver"',
        )
