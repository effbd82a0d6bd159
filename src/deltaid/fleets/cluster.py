"""Where a fleet's work is done: by Dask, on the cores of this machine or on a cluster."""

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from multiprocessing import get_all_start_methods
from os.path import exists
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar, cast
from uuid import uuid4

from deltaid.errors import DeltaidError
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
# Deaths of workers that a task may see before it is tried alone.
_FAILURES = 0
# How long a scheduler may take to answer [s].
_PATIENCE = 15


def require_dask() -> None:
    """Find out whether Dask is there, and what reaches files in any store.

    Raises:
        DeltaidError: it is not installed.
    """
    cure = "pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]' s3fs"
    for module, name in (("distributed", "Dask"), ("fsspec", "fsspec")):
        require(module, by="deltaid fleet", name=name, install=cure)


@contextmanager
def client(scheduler: str | None = None, workers: int | None = None) -> Generator["Client"]:
    """A Dask client: of a cluster by its address, or of processes on this machine.

    Raises:
        DeltaidError: Dask is not installed, nobody answers at the address, or workers have another
            version of deltaid.
    """
    require_dask()
    from dask import config
    from distributed import Client, LocalCluster

    # What Dask has to say of lost connections is said in fewer words.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            connected = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise DeltaidError(
                f"no scheduler answers: {error or type(error).__name__}",
                where=f"--scheduler {scheduler}",
                cure="give the address that `dask scheduler` has printed, such as "
                "tcp://10.0.0.5:8786",
            ) from None
        with connected:
            _require_same_version(connected, scheduler)
            _share_code(connected)
            yield connected
        return
    options: dict[str, Any] = {"distributed.scheduler.allowed-failures": _FAILURES}
    if "forkserver" in get_all_start_methods():  # processes start in a third of the time
        options["distributed.worker.multiprocessing-method"] = "forkserver"
    with (
        config.set(options),
        LocalCluster(
            n_workers=workers or cores(), threads_per_worker=1, processes=True,
            dashboard_address="127.0.0.1:0", host="127.0.0.1", memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as connected,
    ):  # fmt: skip
        _share_code(connected)
        yield connected


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
            f"is not seen by {len(blind)} of {len(seen)} workers, such as {blind[0]}",
            where=f"-o {folder}",
            cure="give a folder that this machine and all workers share, or an address such as "
            "s3://bucket/fleet",
        )


def done(
    client: "Client",
    work: Callable[[_Item], _Result],
    items: Sequence[_Item],
    failed: Callable[[_Item, str], _Result],
) -> Iterator[_Result]:
    """`work` on all items by all workers, in whatever order they are done.

    What was going on in workers that died is done again; what died with several workers waits until
    all else is done and is then tried alone, so that it takes nothing else with it.

    Args:
        failed: the result of an item whose workers died again and again, or of a defect.

    Raises:
        DeltaidError: the scheduler is gone.
    """
    from distributed import KilledWorker, as_completed
    from distributed.client import FutureCancelledError

    waiting, own, suspects = iter(items), dict[Any, _Item](), list[_Item]()

    def submitted(count: int) -> Iterable[Any]:
        for _, item in zip(range(count), waiting, strict=False):
            future = client.submit(work, item, pure=False)
            own[future.key] = item
            yield future

    try:
        coming = as_completed(list(submitted(_AT_ONCE)), loop=client.loop)
        for future in coming:
            item, error = own.pop(future.key), future.exception()
            if isinstance(error, KilledWorker):
                suspects.append(item)
            else:
                yield future.result() if error is None else failed(item, _said(error))
            future.release()
            for more in submitted(1):
                coming.add(more)
        for item in suspects:
            future = client.submit(work, item, pure=False)
            error = future.exception()
            if isinstance(error, KilledWorker):
                yield failed(item, "workers die of it, of too little memory perhaps")
            else:
                yield future.result() if error is None else failed(item, _said(error))
    except (FutureCancelledError, OSError):
        raise DeltaidError(
            "is gone; what has been gathered and fitted is kept",
            where="the scheduler",
            cure="start it again; the same command does what is left",
        ) from None


def _said(error: object) -> str:
    """A defect of the program in one line."""
    first = str(error).strip().split("\n", 1)[0][:300]
    return f"a defect of deltaid, please tell its developers: {type(error).__name__}: {first}"


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
