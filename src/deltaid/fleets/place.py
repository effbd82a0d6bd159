"""The folder of a fleet: on this machine, on one that all workers share, or in a store."""

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl

from deltaid.checksum import EMPTY, require_intact, sealed
from deltaid.errors import DeltaidError, RecordingError, typed
from deltaid.files import resolved
from deltaid.fleets import store
from deltaid.fleets.factor_file import FactorFile, read
from deltaid.forked import require_threads
from deltaid.model.record import IdentifiedModel
from deltaid.recording.source import POLARS_ERRORS, first_line

MADE_AGAIN = "remove it; it is made again"
# The table of recordings, and the file of the quarantine.
RECORDINGS, QUARANTINE = "recordings", "quarantine.csv"
# Folders of results that are not in tables yet, and of the tables before a call.
JOURNAL, BEFORE = "unfinished", "before"
_PUT_BACK = (
    f"put {BEFORE}/{RECORDINGS}.parquet in its place; if you remove it, recordings that are away "
    "are forgotten"
)

Tables = dict[str, pl.DataFrame]


@dataclass(frozen=True)
class Place:
    """A folder; `root` is its absolute path or its address, and names of files are relative to it.

    `kept` caches data between consecutive jobs, so that nothing is read twice.
    """

    root: str
    kept: dict[Hashable, Any] = field(
        default_factory=dict[Hashable, Any], compare=False, repr=False
    )

    @classmethod
    def named(cls, folder: str | Path) -> "Place":
        """The folder of a path or address.

        Raises:
            DeltaidError: it is neither text nor a path, is empty, or does not resolve.
        """
        typed("output", folder, (str, Path), "a path")
        text = str(folder)
        if not text.strip():
            raise DeltaidError(
                "is an empty name", where="output", cure="give a folder; . is this one"
            )
        return cls(text.rstrip("/") if store.is_address(text) else str(resolved(Path(text))))

    @property
    def is_local(self) -> bool:
        return not store.is_address(self.root)

    @property
    def name(self) -> str:
        return Path(self.root).name

    def path_to(self, name: str) -> str:
        return f"{self.root}/{name}"

    def read(self, name: str) -> bytes | None:
        """Bytes of a file; None if it is missing."""
        return store.read(self.path_to(name))

    def write(self, name: str, data: bytes) -> None:
        store.write(self.path_to(name), data)

    def remove(self, names: Iterable[str]) -> None:
        for name in names:
            store.remove(self.path_to(name))

    def table(self, name: str, cure: str = MADE_AGAIN) -> pl.DataFrame | None:
        """Read a Parquet table; None if it is missing.

        Raises:
            DeltaidError: it is no table.
        """
        data = self.read(name)
        if data is None:
            return None
        require_threads()
        require_intact(data, self.path_to(name), DeltaidError, cure)
        try:
            return pl.read_parquet(BytesIO(data))
        except (OSError, *POLARS_ERRORS) as error:
            raise DeltaidError(
                f"is no Parquet table: {first_line(error)}",
                where=self.path_to(name),
                cure=cure,
            ) from None

    def save(self, name: str, frame: pl.DataFrame) -> None:
        """Write a Parquet table with its checksum."""
        buffer = BytesIO()
        frame.write_parquet(buffer, compression="zstd", metadata={"checksum": EMPTY})
        self.write(name, sealed(buffer.getvalue()))

    def tables(self, schemas: Mapping[str, Mapping[str, Any]]) -> Tables:
        """Tables of earlier calls; tables of another version are made again, except of recordings.

        Args:
            schemas: columns of tables, by name.

        Raises:
            DeltaidError: a table cannot be read.
        """
        tables = Tables()
        for name, schema in schemas.items():
            table = self.table(f"{name}.parquet", _PUT_BACK if name == RECORDINGS else MADE_AGAIN)
            is_other = table is not None and table.schema != pl.Schema(schema)
            if is_other and name == RECORDINGS:
                raise DeltaidError(
                    "has other columns than this version writes",
                    where=self.path_to(f"{name}.parquet"),
                    cure="remove it, and it is made again; recordings that have been thrown away "
                    "since are then forgotten",
                )
            tables[name] = pl.DataFrame(schema=schema) if table is None or is_other else table
        return tables

    def refusals(self) -> dict[str, str]:
        """Reasons of lasting refusals by earlier calls, by key.

        Raises:
            DeltaidError: the quarantine cannot be read.
        """
        if not (data := self.read(QUARANTINE)):
            return {}
        try:
            table = pl.read_csv(BytesIO(data), infer_schema=False)
            reasons = table.select(pl.col("key").fill_null(""), "reason").rows()
        except POLARS_ERRORS as error:
            raise DeltaidError(
                f"cannot be read: {first_line(error)}",
                where=self.path_to(QUARANTINE),
                cure=MADE_AGAIN,
            ) from None
        return {key: reason for key, reason in reasons if key}

    def factors(self, name: str, key: str | None = None) -> FactorFile | None:
        """Read a factor file; None if it is missing, damaged, or of other inputs.

        Args:
            key: required checksum of its inputs, if known.

        Raises:
            StoreError: the store cannot be reached.
        """
        try:
            with store.local_file(self.path_to(name)) as path:
                file = read(path)
        except (FileNotFoundError, RecordingError):
            return None
        return replace(file, path=name) if key in (None, file.key) else None

    def size(self, name: str) -> int:
        """Size of a file [bytes]; zero if it is missing."""
        return int(store.stamp_of(self.path_to(name)).partition(" ")[0] or 0)

    def listing(self, folder: str) -> dict[str, int]:
        """Sizes of all files in one of its folders [bytes], by their names relative to `root`."""
        sizes = store.listing(self.path_to(folder))
        return {f"{folder}/{name}": size for name, size in sizes.items()}

    def save_file(self, name: str, write: Callable[[Path], None]) -> None:
        """Write a file by a function that writes to a local path."""
        with TemporaryDirectory(prefix="deltaid-") as folder:
            path = Path(folder) / name.rpartition("/")[2]
            write(path)
            self.write(name, path.read_bytes())

    def save_model(self, name: str, model: IdentifiedModel) -> None:
        """Write a model and cache it with full precision."""
        self.save_file(name, model.save)
        self.kept[name] = model

    def model(self, name: str) -> IdentifiedModel:
        """Load a model that was saved here.

        Raises:
            StoreError: the model is missing, or the store cannot be reached.
        """
        path = self.path_to(name)
        try:
            if name not in self.kept:
                with store.local_file(path) as local:
                    return IdentifiedModel.load(local)
        except FileNotFoundError:
            raise store.StoreError("is not there", where=path, cure="call again") from None
        return self.kept[name]
