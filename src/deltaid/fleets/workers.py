"""Workers of a fleet: processes on this machine, or a Dask cluster.

Processes on this machine communicate through pipes. No port or socket is open, so no other user can
give them work.
"""

import logging
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from threading import Lock, Thread
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar, cast
from uuid import uuid4

from deltaid.errors import DeltaidError
from deltaid.libraries import require
from deltaid.mechanism.user_code import named_path, use_mechanism
from deltaid.parallel import cores

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
# One task at a time in a process: tasks use threads, or are not thread-safe.
ALONE = Lock()
# Largest number of tasks submitted to a scheduler at once: tasks of a year would slow it down.
_AT_ONCE = 2000
# Time limit of a scheduler's answer [s].
_PATIENCE = 15
_DEADLY = "workers die of it, of too little memory perhaps"
# Errors of futures whose workers died: processes, and Dask.
_DEATHS = ("BrokenProcessPool", "KilledWorker")


class Workers:
    """Workers of a fleet, started when there is work.

    Args:
        start: context of an executor; called again if one breaks.
        most: largest number of submitted tasks.
        stack: that closes the executor.
        gone: errors of an executor that cannot be started again from here.
    """

    def __init__(
        self,
        start: Callable[[], AbstractContextManager[Executor]],
        most: int,
        stack: ExitStack,
        gone: tuple[type[BaseException], ...] = (),
    ) -> None:
        self._start, self._most, self._stack, self._gone = start, most, stack, gone
        self._executor: Executor | None = None

    def done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """Results of `work` on all items, in any order.

        Items whose workers died are retried after all others, one at a time, so that they do not
        take others with them.

        Args:
            failed: the result of an item whose workers died again, or of a defect.

        Raises:
            DeltaidError: the executor is gone.
        """
        waiting, suspects = deque(items), list[_Item]()
        try:
            while waiting:
                suspects += yield from self._until_broken(work, waiting, failed)
            for item in suspects:
                if (yield from self._until_broken(work, deque([item]), failed)):
                    yield failed(item, _DEADLY)
        except self._gone:
            raise DeltaidError(
                "is gone; what has been gathered and fitted is kept",
                where="the scheduler",
                cure="start it again; the same command does the rest",
            ) from None

    def _until_broken(
        self,
        work: Callable[[_Item], _Result],
        waiting: deque[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Generator[_Result, None, list[_Item]]:
        """Yields results; returns items that were running when a worker died. The death of a
        process ends all others."""
        suspects, running, is_broken = list[_Item](), dict[Future[_Result], _Item](), False
        finished = SimpleQueue[Future[_Result]]()
        self._executor = self._executor or self._stack.enter_context(self._start())
        while running or (waiting and not is_broken):
            while waiting and not is_broken and len(running) < self._most:
                item = waiting.popleft()
                try:
                    future = self._executor.submit(work, item)
                except BrokenProcessPool:
                    suspects.append(item)
                    is_broken = True
                else:
                    running[future] = item
                    future.add_done_callback(finished.put)
            if running:
                future = finished.get()
                item, error = running.pop(future), future.exception()
                is_broken |= isinstance(error, BrokenProcessPool)
                if type(error).__name__ in _DEATHS:
                    suspects.append(item)
                else:
                    yield future.result() if error is None else failed(item, defect(error))
        if is_broken:
            self._stack.close()
            self._executor = None
        return suspects


def defect(error: object) -> str:
    """Text of a defect of the program, one line."""
    first = str(error).strip().split("\n", 1)[0][:300]
    return f"a defect of deltaid, please report it: {type(error).__name__}: {first}"


class _Processes(ProcessPoolExecutor):
    """Processes that do not import this process's script, which would start workers again where it
    lacks a `__main__` guard; tasks only need deltaid."""

    def submit(self, *task: Any, **options: Any) -> Future[Any]:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return super().submit(*task, **options)  # starts a process if none is idle
        finally:
            sys.modules["__main__"] = script


@contextmanager
def _processes(count: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Processes that end at once if the block raises, or if this process is killed.

    They are spawned: a fork lacks this process's threads, and a fork server opens a socket.
    """
    context = get_context("spawn")
    lives, ours = context.Pipe(duplex=False)
    begin: tuple[Any, ...] = (lives, named_path())
    executor = _Processes(count, context, _begin, begin)
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
    """Start of each process: ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(lives,), daemon=True).start()
    if mechanism is not None:
        use_mechanism(mechanism)


def _end_with(lives: Connection) -> None:
    try:
        lives.recv()  # until the other end is closed
    except EOFError:
        os._exit(1)


@contextmanager
def open_workers(
    scheduler: str | None = None, count: int | None = None, folder: Path | None = None
) -> Generator[Workers]:
    """Workers of a Dask cluster by its address, or processes on this machine.

    Args:
        count: of processes; None for one per core.
        folder: that all workers have to see, if any.

    Raises:
        DeltaidError: Dask is not installed, no scheduler answers at the address, workers have
            another version of deltaid, or one does not see the folder.
    """
    if scheduler is None:
        with ExitStack() as stack:
            yield Workers(partial(_processes, count or cores()), count or cores(), stack)
        return
    # Includes the libraries of stores.
    cure = "pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]' s3fs"
    for module, name in (("distributed", "Dask"), ("fsspec", "fsspec")):
        require(module, by="deltaid fleet --scheduler", name=name, install=cure)
    from distributed import Client, WorkerPlugin

    # Errors below replace Dask's messages about lost connections.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        connected = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise DeltaidError(
            f"no scheduler answers: {error or type(error).__name__}",
            where=f"--scheduler {scheduler}",
            cure="give the address that `dask scheduler` has printed, such as tcp://10.0.0.5:8786",
        ) from None
    with connected, ExitStack() as stack:
        _require_same_version(connected, scheduler)
        if (path := named_path()) is not None:  # the user's own mechanism
            code = path.read_bytes()

            class OwnCode(WorkerPlugin):
                """The user's file as it was at the call, on each worker, also on workers that start
                later."""

                def setup(self, worker: Any) -> None:
                    with TemporaryDirectory(prefix="deltaid-") as folder:
                        copy = Path(folder) / "mechanism.py"
                        copy.write_bytes(code)
                        use_mechanism(copy)

            connected.register_plugin(OwnCode())
        if folder is not None:
            require_shared(connected, folder)
        executor = connected.get_executor(pure=False)  # which ends with the client
        yield Workers(
            lambda: nullcontext(executor), _AT_ONCE, stack, gone=(CancelledError, OSError)
        )


def require_shared(client: "Client", folder: Path) -> None:
    """Check that all workers see a folder of this machine.

    Raises:
        DeltaidError: one does not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".{uuid4().hex}"
    probe.touch()
    try:
        answers = _of_each(client, os.path.exists, str(probe))
    finally:
        probe.unlink()
    blind = sorted(address for address, answer in answers.items() if answer is False)
    if blind:
        raise DeltaidError(
            f"is not visible to {len(blind)} of {len(answers)} workers, such as {blind[0]}",
            where=f"-o {folder}",
            cure="give a folder that this machine and all workers share, or an address such as "
            "s3://bucket/fleet",
        )


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
    """Answer or error of each worker; one that dies meanwhile gives an error."""
    return cast(dict[str, object], client.run(ask, *words, on_error="return"))
