"""Where a fleet's work is done: on the cores of this machine, or by Dask on a cluster.

On this machine processes talk through pipes. No port is open and no socket: nobody else on the
machine can give them work.
"""

import logging
import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast, runtime_checkable
from uuid import uuid4

from deltaid.errors import DeltaidError
from deltaid.libraries import require
from deltaid.mechanism.user_code import named_path, use_mechanism
from deltaid.parallel import cores

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
# Of one process: what runs within a task shares its work among threads, or is not safe among them.
ALONE = Lock()
# Tasks that the scheduler knows at once: all of a year of a fleet would slow it down.
_AT_ONCE = 2000
# How long a scheduler may take to answer [s].
_PATIENCE = 15
_DEADLY = "workers die of it, of too little memory perhaps"


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
                yield failed(item, _DEADLY)

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


def require_dask() -> None:
    """Find out whether Dask is there, and what reaches files in any store.

    Raises:
        DeltaidError: it is not installed.
    """
    cure = "pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]' s3fs"
    for module, name in (("distributed", "Dask"), ("fsspec", "fsspec")):
        require(module, by="deltaid fleet --scheduler", name=name, install=cure)


@contextmanager
def open_workers(
    scheduler: str | None = None, count: int | None = None, folder: Path | None = None
) -> Generator[Workers]:
    """Workers of a Dask cluster by its address, or processes on this machine.

    Args:
        scheduler: the address.
        count: of processes; one a core if None.
        folder: that all workers have to see, if there is one.

    Raises:
        DeltaidError: Dask is not installed, nobody answers at the address, workers have another
            version of deltaid, or one does not see the folder.
    """
    if scheduler is None:
        with LocalPool(count or cores()) as pool:
            yield pool
        return
    require_dask()
    from distributed import Client

    # What Dask has to say of lost connections is said in fewer words.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        connected = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise DeltaidError(
            f"no scheduler answers: {error or type(error).__name__}",
            where=f"--scheduler {scheduler}",
            cure="give the address that `dask scheduler` has printed, such as tcp://10.0.0.5:8786",
        ) from None
    with connected:
        _require_same_version(connected, scheduler)
        if (path := named_path()) is not None:  # the user's own mechanism
            from deltaid.fleets.own_code import OwnCode

            connected.register_plugin(OwnCode(path.read_bytes()))
        if folder is not None:
            require_shared(connected, folder)
        yield DaskWorkers(connected)


def require_shared(client: "Client", folder: Path) -> None:
    """Find out whether all workers see a folder of this machine.

    Raises:
        DeltaidError: one does not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".{uuid4().hex}"
    probe.touch()
    try:
        seen = _of_each(client, os.path.exists, str(probe))
    finally:
        probe.unlink()
    blind = sorted(address for address, answer in seen.items() if answer is False)
    if blind:
        raise DeltaidError(
            f"is not visible to {len(blind)} of {len(seen)} workers, such as {blind[0]}",
            where=f"-o {folder}",
            cure="give a folder that this machine and all workers share, or an address such as "
            "s3://bucket/fleet",
        )


@dataclass(frozen=True)
class DaskWorkers:
    """Workers of a cluster.

    Attributes:
        client: of its scheduler.
    """

    client: "Client"

    def done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """As of `Workers`."""
        from distributed import KilledWorker, as_completed
        from distributed.client import FutureCancelledError

        waiting, own, suspects = iter(items), dict[Any, _Item](), list[_Item]()

        def submitted(count: int) -> Iterable[Any]:
            for _, item in zip(range(count), waiting, strict=False):
                future = self.client.submit(work, item, pure=False)
                own[future.key] = item
                yield future

        try:
            coming = as_completed(list(submitted(_AT_ONCE)), loop=self.client.loop)
            for future in coming:
                item, error = own.pop(future.key), future.exception()
                if isinstance(error, KilledWorker):
                    suspects.append(item)
                else:
                    yield future.result() if error is None else failed(item, defect(error))
                future.release()
                for submission in submitted(1):
                    coming.add(submission)
            for item in suspects:
                future = self.client.submit(work, item, pure=False)
                error = future.exception()
                why = _DEADLY if isinstance(error, KilledWorker) else defect(error)
                yield future.result() if error is None else failed(item, why)
        except (FutureCancelledError, OSError):
            raise DeltaidError(
                "is gone; what has been gathered and fitted is kept",
                where="the scheduler",
                cure="start it again; the same command does the rest",
            ) from None


def _require_same_version(client: "Client", scheduler: str) -> None:
    own = version("deltaid")
    for worker, installed in _of_each(client, version, "deltaid").items():
        if isinstance(installed, ImportError):
            raise DeltaidError(
                f"worker {worker} cannot import deltaid: {installed}",
                where=f"--scheduler {scheduler}",
                cure=f"install deltaid {own} where workers run",
            )
        if isinstance(installed, str) and installed != own:
            raise DeltaidError(
                f"worker {worker} has deltaid {installed}, and this is {own}",
                where=f"--scheduler {scheduler}",
                cure="install the same version where workers run",
            )


def _of_each(client: "Client", ask: Callable[..., object], *words: object) -> dict[str, object]:
    """What each worker answers, or the error; one that dies just now answers with an error."""
    return cast(dict[str, object], client.run(ask, *words, on_error="return"))
