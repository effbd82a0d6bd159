"""Where a fleet's work is done: on the cores of this machine, or by Dask on a cluster.

On this machine processes talk through pipes. No port is open and no socket: nobody else on the
machine can give them work.
"""

import logging
import os
import signal
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
# Of one process: what runs within a task shares its work among threads, or is not safe among them.
ALONE = Lock()
# Tasks that the scheduler knows at once: all of a year of a fleet would slow it down.
_AT_ONCE = 2000
# How long a scheduler may take to answer [s].
_PATIENCE = 15
_DEADLY = "workers die of it, of too little memory perhaps"
# Errors of futures whose workers have died, of a process and in Dask.
_DEATHS = ("BrokenProcessPool", "KilledWorker")


class Workers:
    """Who does a fleet's work, started when there is some.

    Args:
        start: an executor for as long as its block lasts; another one where one has broken.
        most: tasks that it is given at once.
        stack: what ends it.
        gone: errors of an executor that nobody can start again from here.
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
        """`work` on all items, in whatever order they are done.

        What was going on in workers that died is done again; what died with several workers waits
        until all else is done and is then tried alone, so that it takes nothing else with it.

        Args:
            failed: the result of an item whose workers died again and again, or of a defect.

        Raises:
            DeltaidError: nobody is left to do it.
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
        """Results; what was going on when a worker died. A process takes all others with it."""
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
        with ExitStack() as stack:
            yield Workers(partial(_processes, count or cores()), count or cores(), stack)
        return
    # What reaches files in any store, too.
    cure = "pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]' s3fs"
    for module, name in (("distributed", "Dask"), ("fsspec", "fsspec")):
        require(module, by="deltaid fleet --scheduler", name=name, install=cure)
    from distributed import Client, WorkerPlugin

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
    with connected, ExitStack() as stack:
        _require_same_version(connected, scheduler)
        if (path := named_path()) is not None:  # the user's own mechanism
            code = path.read_bytes()

            class OwnCode(WorkerPlugin):
                """The file that the user has named, as it was when the command was called; on each
                worker, also on those that start later."""

                def setup(self, worker: Any) -> None:
                    del worker
                    with TemporaryDirectory(prefix="deltaid-") as folder:
                        copy = Path(folder) / "mechanism.py"
                        copy.write_bytes(code)
                        use_mechanism(copy)

            connected.register_plugin(OwnCode())
        if folder is not None:
            require_shared(connected, folder)
        executor = connected.get_executor(pure=False)  # which ends with the client
        gone = (CancelledError, OSError)
        yield Workers(lambda: nullcontext(executor), _AT_ONCE, stack, gone)


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
