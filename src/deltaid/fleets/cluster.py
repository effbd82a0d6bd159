"""Where a fleet's work is done: on the cores of this machine, or by Dask on a cluster."""

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from os.path import exists
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar, cast
from uuid import uuid4

from deltaid.errors import DeltaidError
from deltaid.fleets.pool import LocalPool, Workers, defect
from deltaid.libraries import require
from deltaid.mechanism.user_code import named_path
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


def require_dask() -> None:
    """Find out whether Dask is there, and what reaches files in any store.

    Raises:
        DeltaidError: it is not installed.
    """
    cure = "pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]' s3fs"
    for module, name in (("distributed", "Dask"), ("fsspec", "fsspec")):
        require(module, by="deltaid fleet --scheduler", name=name, install=cure)


@contextmanager
def workers(
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
        _share_code(connected)
        if folder is not None:
            require_shared(connected, folder)
        yield DaskWorkers(connected)


def _share_code(client: "Client") -> None:
    """Give workers the Python file of the user's own mechanism, if there is one."""
    path = named_path()
    if path is not None:
        from deltaid.fleets.own_code import OwnCode

        client.register_plugin(OwnCode(path.read_bytes()))


def require_shared(client: "Client", folder: Path) -> None:
    """Find out whether all workers see a folder of this machine.

    Raises:
        DeltaidError: one does not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".{uuid4().hex}"
    probe.touch()
    try:
        seen = _of_each(client, exists, str(probe))
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
                for more in submitted(1):
                    coming.add(more)
            for item in suspects:
                future = self.client.submit(work, item, pure=False)
                error = future.exception()
                if isinstance(error, KilledWorker):
                    yield failed(item, "workers die of it, of too little memory perhaps")
                else:
                    yield future.result() if error is None else failed(item, defect(error))
        except (FutureCancelledError, OSError):
            raise DeltaidError(
                "is gone; what has been gathered and fitted is kept",
                where="the scheduler",
                cure="start it again; the same command does the rest",
            ) from None


def _require_same_version(client: "Client", scheduler: str) -> None:
    own = version("deltaid")
    for worker, theirs in _of_each(client, version, "deltaid").items():
        if isinstance(theirs, ImportError):
            raise DeltaidError(
                f"worker {worker} cannot import deltaid: {theirs}",
                where=f"--scheduler {scheduler}",
                cure=f"install deltaid {own} where workers run",
            )
        if isinstance(theirs, str) and theirs != own:
            raise DeltaidError(
                f"worker {worker} has deltaid {theirs}, and this is {own}",
                where=f"--scheduler {scheduler}",
                cure="install the same version where workers run",
            )


def _of_each(client: "Client", ask: Callable[..., object], *words: object) -> dict[str, object]:
    """What each worker answers, or the error; one that dies just now answers with an error."""
    return cast(dict[str, object], client.run(ask, *words, on_error="return"))
