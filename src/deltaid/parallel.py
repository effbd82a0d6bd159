"""Work shared among threads whose results come in the order of what goes in.

So no bit of a result depends on how many threads there are. Threads are enough: kernels, LAPACK and
NumPy let go of Python's lock while they compute.
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
# What there is behind the last item.
_END: Any = object()


@functools.cache
def _cores() -> int:
    """Cores that this process may use; asking the system takes as long as a kernel's sample."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cores() -> int:
    """Threads to share work among: one a core, and a single one where work is shared already."""
    return _limit.get() or _cores()


@contextmanager
def threads(count: int) -> Generator[None, None, None]:
    """Share work among so many threads."""
    token = _limit.set(count)
    try:
        yield
    finally:
        _limit.reset(token)


def ordered(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """`work` done on every item, in order, by all threads, with few items in memory at a time.

    Items are made one after the other, in a thread of their own, while the caller adds up results.
    If making one fails, the results of those before it come first, so the error that is told does
    not depend on threads either. The first item is worked on before there are threads, so that what
    is compiled on first use is compiled once. BLAS keeps to the thread that calls it: on small
    matrices more threads only wait.
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
    """Results in order; the next item is made while those before it are worked on."""

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
    """The items, and behind them the error by which making one fails."""
    try:
        yield from source
    except DeltaidError as error:
        yield error
