"""The folder of a fleet: on this machine, on one that all workers share, or in a store."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.factor_file import FactorFile, read
from deltaid.fleets.store import FileStore, is_address


@dataclass(frozen=True)
class Place:
    """A folder, by its path or its address, and how to get at it.

    Attributes:
        root: its absolute path, or its address.
        store: of it, and of recordings.
    """

    root: str
    store: FileStore = field(default_factory=FileStore)

    @classmethod
    def named(cls, folder: str | Path, store: FileStore) -> "Place":
        """The folder of a name."""
        text = str(folder)
        return cls(text.rstrip("/") if is_address(text) else str(Path(text).resolve()), store)

    @property
    def is_local(self) -> bool:
        """Whether it is a path."""
        return not is_address(self.root)

    def require(self) -> None:
        """Find out before any work whether the folder can be written to.

        Raises:
            DeltaidError: it is a file, or cannot be made or written to.
        """
        if not self.is_local:
            return
        path = Path(self.root)
        there = next(folder for folder in (path, *path.parents) if folder.exists())
        if not there.is_dir():
            raise DeltaidError(
                "is a file, not a folder", where=str(there), cure="give another name"
            )
        if not os.access(there, os.W_OK):
            raise DeltaidError(
                "cannot be written to",
                where=str(there),
                cure="check the folder's permissions, or give another place",
            )

    def path_to(self, name: str) -> str:
        """Path or address of a file in it."""
        return f"{self.root}/{name}"

    def table(self, name: str) -> pl.DataFrame | None:
        """A Parquet table in it; None if there is none.

        Raises:
            DeltaidError: it is no table.
        """
        data = self.store.read(self.path_to(name))
        if data is None:
            return None
        try:
            return pl.read_parquet(BytesIO(data))
        except (OSError, pl.exceptions.PolarsError) as error:
            raise DeltaidError(
                f"is no Parquet table: {str(error).splitlines()[0]}",
                where=self.path_to(name),
                cure="remove it; it is made again",
            ) from None

    def finished(self, name: str) -> pl.DataFrame | None:
        """A table that a task has left; None if there is none that is whole."""
        try:
            return self.table(name)
        except DeltaidError:
            return None

    def save(self, name: str, frame: pl.DataFrame) -> None:
        """Write a Parquet table."""
        self.save_file(name, lambda path: frame.write_parquet(path, compression="zstd"))

    def factors(self, name: str, key: str | None = None) -> FactorFile | None:
        """A factor file in it; None if there is none that is whole, or it follows from others.

        Args:
            key: of what it has to follow from, if that is known.

        Raises:
            StoreError: the store cannot be reached.
        """
        try:
            with self.store.local(self.path_to(name)) as path:
                file = read(path)
        except (FileNotFoundError, RecordingError):
            return None
        return replace(file, path=name) if key in (None, file.key) else None

    def size(self, name: str) -> int:
        """Bytes of a file; zero if there is none."""
        return int(self.store.stamp(self.path_to(name)).partition(" ")[0] or 0)

    def listing(self, folder: str) -> dict[str, int]:
        """Sizes of all files in one of its folders, by their names seen from itself."""
        sizes = self.store.listing(self.path_to(folder))
        return {f"{folder}/{name}": size for name, size in sizes.items()}

    def save_file(self, name: str, write: Callable[[Path], None]) -> int:
        """Write a file as `write` writes it on this machine; its size in bytes."""
        with TemporaryDirectory(prefix="deltaid-") as folder:
            path = Path(folder) / name.rpartition("/")[2]
            write(path)
            data = path.read_bytes()
        self.store.write(self.path_to(name), data)
        return len(data)
