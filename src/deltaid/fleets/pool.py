"""A fleet's work on the cores of this machine, by processes that talk through pipes.

No port is open and no socket: nobody else on the machine can give them work.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any, Protocol, TypeVar, runtime_checkable

from deltaid.mechanism.user_code import named_path, use_mechanism

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@runtime_checkable
class Workers(Protocol):
    """Who does a fleet's work."""

    def done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """`work` on all items, in whatever order they are done.

        What was going on in workers that died is done again; what died with several workers waits
        until all else is done and is then tried alone, so that it takes nothing else with it.

        Args:
            failed: the result of an item whose workers died again and again, or of a defect.

        Raises:
            DeltaidError: nobody is left to do it.
        """
        ...


class LocalPool:
    """Processes of this machine, started when there is work, for as long as its block lasts.

    Args:
        count: how many.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._stack, self._executor = ExitStack(), None

    def __enter__(self) -> "LocalPool":
        return self

    def __exit__(self, *raised: Any) -> None:
        self._stack.__exit__(*raised)

    def done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """As of `Workers`."""
        waiting, suspects = deque(items), list[_Item]()
        while waiting:
            suspects += yield from self._until_one_dies(work, waiting, failed)
        for item in suspects:
            if (yield from self._until_one_dies(work, deque([item]), failed)):
                yield failed(item, "workers die of it, of too little memory perhaps")

    def _until_one_dies(
        self,
        work: Callable[[_Item], _Result],
        waiting: deque[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Generator[_Result, None, list[_Item]]:
        """Results; what was going on when a process died, and took the others with it."""
        dead, running = list[_Item](), dict[Future[_Result], _Item]()
        executor = self._executor = self._executor or self._stack.enter_context(
            _processes(self.count)
        )
        while running or (waiting and not dead):
            while waiting and not dead and len(running) < self.count:
                item = waiting.popleft()
                try:
                    running[executor.submit(work, item)] = item
                except BrokenProcessPool:
                    dead.append(item)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                item, error = running.pop(future), future.exception()
                if isinstance(error, BrokenProcessPool):
                    dead.append(item)
                else:
                    yield future.result() if error is None else failed(item, defect(error))
        if dead:
            self._stack.close()
            self._executor = None
        return dead


def defect(error: object) -> str:
    """A defect of the program in one line."""
    first = str(error).strip().split("\n", 1)[0][:300]
    return f"a defect of deltaid, please report it: {type(error).__name__}: {first}"


@contextmanager
def _processes(count: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Processes that end at once when the block is left by an error, or this process is killed.

    They are spawned: a fork would lack the threads of this one, and a server of forks listens.
    """
    context = get_context("spawn")
    lives, ours = context.Pipe(duplex=False)
    begin: tuple[Any, ...] = (lives, named_path())
    executor = ProcessPoolExecutor(count, context, _begin, begin)
    try:
        yield executor
    except BaseException:
        ours.close()
        raise
    finally:
        executor.shutdown(cancel_futures=True)
        ours.close()
        lives.close()


def _begin(lives: Connection, mechanism: Path | None) -> None:
    """In each process: Ctrl-C is for the one that started it, whose end is its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(lives,), daemon=True).start()
    if mechanism is not None:
        use_mechanism(mechanism)


def _end_with(lives: Connection) -> None:
    try:
        lives.recv()  # until the other end is closed
    except EOFError:
        os._exit(1)
