"""Files that carry a checksum, by what reads each, and what they hold as values that compare."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from deltaid.checksum import require_intact
from deltaid.errors import DeltaidError
from deltaid.fleets.factor_file import read
from deltaid.fleets.member import read_member
from deltaid.fleets.place import Place
from deltaid.model.record import IdentifiedModel


@dataclass(frozen=True)
class Held:
    """What a file holds, and what is said about it."""

    numbers: tuple[object, ...]
    words: tuple[str, ...] = ()


def _numbers(value: Any) -> Iterator[object]:
    """All that a value is made of, with every bit."""
    match value:
        case np.ndarray():
            yield value.tobytes()
        case pl.DataFrame():
            yield repr(value.rows())
        case dict():
            for entry in value.values():
                yield from _numbers(entry)
        case list() | tuple():
            for entry in value:
                yield from _numbers(entry)
        case _ if is_dataclass(value):
            for field in fields(value):
                yield from _numbers(getattr(value, field.name))
        case bool() | int() | float():
            yield value
        case _ if hasattr(value, "model_dump"):
            yield from _numbers(value.model_dump(mode="json"))


def _factors(path: Path) -> Held:
    file = read(path)
    return Held(tuple(_numbers((file.record, file.whole, file.groups, file.geometry))))


def _table(path: Path) -> Held:
    return Held(tuple(_numbers(Place.named(path.parent).table(path.name))))


def _member(path: Path) -> Held:
    return Held(tuple(_numbers(read_member(path.read_bytes(), str(path)))))


def _drawn(path: Path) -> Held:
    """Drawn models are read by NumPy; what the package says of them is whether they are whole."""
    require_intact(path.read_bytes(), str(path), DeltaidError, "draw them again")
    with np.load(path) as file:
        return Held(tuple(_numbers(dict(file))))


def _model(path: Path) -> Held:
    model = IdentifiedModel.load(path)
    return Held(tuple(_numbers(model)), model.warnings)


# Where one lies among good files (`damaged_commands.make_inputs`), and what reads it.
SEALED: dict[str, tuple[str, Callable[[Path], Held]]] = {
    "factor file": ("g/*.factors.parquet", _factors),
    "fleet table": ("fleet/parameters.parquet", _table),
    "fleet member": ("fleet/members/*.npz", _member),
    "drawn models": ("drawn.npz", _drawn),
    "model file": ("model.yaml", _model),
}
