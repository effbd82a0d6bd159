"""A fleet's work on the cores of this machine, by processes that talk through pipes.

No port is open and no socket: nobody else on the machine can give them work.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import TypeVar

from deltaid.mechanism.user_code import named_path, use_mechanism

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class LocalPool:
    """Processes of this machine, which start when they are asked for.

    Attributes:
        workers: how many.
    """

    workers: int

    def done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """As of `cluster.done`."""
        waiting, suspects = deque(items), list[_Item]()
        while waiting:
            suspects += yield from self._until_one_dies(work, waiting, failed)
        for item in suspects:
            if (yield from LocalPool(1)._until_one_dies(work, deque([item]), failed)):
                yield failed(item, "workers die of it, of too little memory perhaps")

    def _until_one_dies(
        self,
        work: Callable[[_Item], _Result],
        waiting: deque[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Generator[_Result, None, list[_Item]]:
        """Results; what was going on when a process died, and took the others with it."""
        dead, running = list[_Item](), dict[Future[_Result], _Item]()
        with _processes(min(self.workers, len(waiting))) as executor:
            while running or (waiting and not dead):
                while waiting and not dead and len(running) < self.workers:
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
        return dead


def defect(error: object) -> str:
    """A defect of the program in one line."""
    first = str(error).strip().split("\n", 1)[0][:300]
    return f"a defect of deltaid, please tell its developers: {type(error).__name__}: {first}"


@contextmanager
def _processes(count: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Processes that end at once when the block is left by an error, or this process is killed.

    They are spawned: a fork would lack the threads of this one, and a server of forks listens.
    """
    context = get_context("spawn")
    lives, ours = context.Pipe(duplex=False)
    executor = ProcessPoolExecutor(count, context, _begin, (lives, named_path()))
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
