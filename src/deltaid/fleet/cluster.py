"""Where a fleet's work is done: by Dask, on the cores of this machine or on a cluster."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from deltaid.errors import DeltaidError
from deltaid.parallel import cores

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
# How often work of a worker that died is given to another one.
_RETRIES = 3
# Tasks that the scheduler knows at once: all of a year of a fleet would slow it down.
_AT_ONCE = 2000


def require_dask() -> None:
    """Find out whether Dask is there.

    Raises:
        DeltaidError: it is not installed.
    """
    try:
        import distributed  # noqa: F401  # pyright: ignore[reportUnusedImport]
    except ImportError:
        raise DeltaidError(
            "needs Dask, which is not installed",
            where="deltaid fleet",
            cure="pip install '.[fleet]' in a clone of deltaid, or pip install 'dask[distributed]'",
        ) from None


@contextmanager
def client(scheduler: str | None = None, workers: int | None = None) -> Generator["Client"]:
    """A Dask client: of a cluster by its address, or of processes on this machine.

    Raises:
        DeltaidError: Dask is not installed, or nobody answers at the address.
    """
    require_dask()
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            with Client(scheduler, timeout=10) as found:
                yield found
        except OSError as error:
            raise DeltaidError(
                f"no scheduler answers: {error}",
                where=f"--scheduler {scheduler}",
                cure="check the address that `dask scheduler` has printed",
            ) from None
        return
    with (
        LocalCluster(
            n_workers=workers or cores(), threads_per_worker=1, processes=True,
            dashboard_address="127.0.0.1:0", host="127.0.0.1", silence_logs=40,
        ) as cluster,
        Client(cluster) as found,
    ):  # fmt: skip
        yield found


def done(
    client: "Client",
    work: Callable[[_Item], _Result],
    items: Sequence[_Item],
    failed: Callable[[_Item, str], _Result],
) -> Iterator[_Result]:
    """`work` on all items by all workers, in whatever order they are done.

    Args:
        failed: the result of an item whose workers died again and again, or of a defect.
    """
    from distributed import as_completed

    waiting, own = iter(items), dict[Any, _Item]()

    def submitted(count: int) -> Iterable[Any]:
        for _, item in zip(range(count), waiting, strict=False):
            future = client.submit(work, item, pure=False, retries=_RETRIES)
            own[future.key] = item
            yield future

    coming = as_completed(list(submitted(_AT_ONCE)))
    for future in coming:
        item = own.pop(future.key)
        error = future.exception()
        yield future.result() if error is None else failed(item, f"{type(error).__name__}: {error}")
        future.release()
        for more in submitted(1):
            coming.add(more)
