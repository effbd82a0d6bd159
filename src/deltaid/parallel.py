"""Parallel work by threads, with results in the order of the items.

So results do not depend on the number of threads, to the bit. Threads suffice: kernels, LAPACK and
NumPy release Python's lock while they compute.
"""

import functools
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from threadpoolctl import get_cached_controller

from deltaid.errors import DeltaidError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_limit: ContextVar[int | None] = ContextVar("threads", default=None)
# Marks the end of the items.
_END: Any = object()


@functools.cache
def _cores() -> int:
    """Cores that this process may use, cached: a query takes as long as a sample of a kernel."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cores() -> int:
    """Number of threads: one per core, or a single one inside work that is already shared."""
    return _limit.get() or _cores()


@contextmanager
def threads(count: int) -> Generator[None, None, None]:
    """Limit the number of threads inside the block."""
    token = _limit.set(count)
    try:
        yield
    finally:
        _limit.reset(token)


def ordered(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """Results of `work` for every item, in order, computed by all threads with few items in memory.

    A separate thread makes the items one after the other, while the caller consumes results. If
    making an item fails, the results of all items before it come first, so the reported error does
    not depend on threads. The first item is processed before any thread starts, so that code which
    is compiled on first use is compiled once. BLAS uses the calling thread only: with small
    matrices, more threads only wait.
    """
    source = iter(items)
    with get_cached_controller().limit(limits=1, user_api="blas"):
        for first in source:
            yield work(first)
            break
        count = cores()
        if count == 1:
            yield from map(work, source)
            return
        maker = ThreadPoolExecutor(1)
        pool = ThreadPoolExecutor(count, initializer=_limit.set, initargs=(1,))
        try:
            yield from _in_turn(maker, pool, work, source, ahead=2 * count)
        finally:
            maker.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)


def _in_turn(
    maker: ThreadPoolExecutor,
    pool: ThreadPoolExecutor,
    work: Callable[[_Item], _Result],
    source: Iterator[_Item],
    ahead: int,
) -> Iterator[_Result]:
    """Results in order; the next item is made while earlier ones are processed."""

    def attempt(item: _Item | DeltaidError) -> _Result:
        if isinstance(item, DeltaidError):
            raise item
        return work(item)

    pending: deque[Future[_Result]] = deque()
    items = _or_failure(source)
    coming = maker.submit(next, items, _END)
    while (item := coming.result()) is not _END:
        coming = maker.submit(next, items, _END)
        pending.append(pool.submit(attempt, item))
        if len(pending) > ahead:
            yield pending.popleft().result()
    while pending:
        yield pending.popleft().result()


def _or_failure(source: Iterator[_Item]) -> Iterator[_Item | DeltaidError]:
    """The items, followed by the error if making one fails."""
    try:
        yield from source
    except DeltaidError as error:
        yield error
