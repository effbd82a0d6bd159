"""Converts arrays to columns of a recording: checks shapes, numbers, times and units."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from deltaid.errors import RecordingError, typed
from deltaid.mechanism.one_or_many import real_numbers

# One unit for all drives, or one unit per drive.
Units = str | Sequence[str]


def copied(values: np.ndarray) -> np.ndarray:
    """Contiguous copy, because polars would share the memory of the array.

    Truth values are kept, so that columns other than states can refuse them.
    """
    kind = bool if values.dtype == bool else np.float64
    return np.array(values, dtype=kind, order="C", copy=True)


def numbers_of(value: ArrayLike, where: str, *, truths: bool = False) -> np.ndarray:
    """Array-like values as real numbers.

    Args:
        where: place of the values, for messages.
        truths: whether arrays of truth values are allowed.

    Raises:
        RecordingError: the values are not real numbers.
    """
    is_truth = getattr(getattr(value, "dtype", None), "kind", "") == "b"
    if truths and is_truth and not np.ma.is_masked(value):
        return np.asarray(value)
    cure = "give an array of real numbers, one sample a row"
    return real_numbers(value, where, cure=cure, error=RecordingError)


def require_shapes(arrays: dict[str, np.ndarray], name: str) -> None:
    """Refuse arrays whose shape is not (samples, drives), or not that of q."""
    shape = arrays["q"].shape
    for key, array in arrays.items():
        if array.ndim != 2 or not array.size:
            raise RecordingError(
                f"has shape {array.shape}, not (samples, drives)",
                where=f"{name}, {key}",
                cure="one sample a row, one drive a column; for a single drive x.reshape(-1, 1)",
            )
        if array.shape != shape:
            raise RecordingError(
                f"has shape {array.shape}, but q has {shape}",
                where=f"{name}, {key}",
                cure="all of them have one row a sample and one column a drive",
            )


def time_of(
    t: ArrayLike | None, rate: float | None, unit: str | None, samples: int, name: str
) -> np.ndarray:
    """Times of the samples, from t or from the rate [Hz]."""
    if (t is None) == (rate is None):
        raise RecordingError(
            "neither t nor rate is given" if t is None else "both t and rate are given",
            where=name,
            cure="give the times t, or the sampling rate in Hz",
        )
    if rate is not None:
        if not (0 < rate < math.inf):
            raise RecordingError(
                f"is {rate}", where=f"{name}, rate", cure="give a positive number of Hz"
            )
        if unit is not None:
            raise RecordingError(
                "belongs to t, but rate is given, in Hz", where=f"{name}, unit_t", cure="omit it"
            )
        return np.arange(samples) / rate
    assert t is not None
    time = numbers_of(t, f"{name}, t")
    if time.shape != (samples,):
        raise RecordingError(
            f"has shape {time.shape}, but q has {samples} rows",
            where=f"{name}, t",
            cure="give one time a sample; drives are columns of q, so perhaps q.T",
        )
    return copied(time)


def extra_columns(
    given: Mapping[str, ArrayLike], samples: int, taken: Collection[str], name: str
) -> dict[str, np.ndarray]:
    """Copies of extra columns; an array with several columns gives `key[0]`, `key[1]`, …

    Args:
        taken: names of the other columns.
    """
    typed(f"{name}, extra", given, Mapping, "a dictionary of arrays")
    for key in given:
        if key in taken:
            raise RecordingError(
                f"{key} is the name of a drive's column, or of the time",
                where=f"{name}, extra {key}",
                cure="give it another name",
            )
    return _columns(given, f"{name}, extra ", samples)


def columns_of(table: Mapping[str, ArrayLike] | np.ndarray, name: str) -> dict[str, np.ndarray]:
    """Copies of the columns of a dictionary of arrays, or of a structured array.

    An array with several columns under a key gives `key[0]`, `key[1]`, …

    Raises:
        RecordingError: columns hold no numbers, their lengths differ, or the array has no names.
    """
    if isinstance(table, np.ndarray):
        if table.dtype.names is None:
            raise RecordingError(
                f"an array of shape {table.shape} has no names of columns",
                where=name,
                cure="give a dictionary of arrays, or deltaid.Recording.from_arrays(…)",
            )
        table = {key: table[key] for key in table.dtype.names}
    return _columns(table, f"{name}, ")


def _columns(
    given: Mapping[str, ArrayLike], prefix: str, samples: int | None = None
) -> dict[str, np.ndarray]:
    """Copies of columns; an array with several columns gives `key[0]`, `key[1]`, …

    Args:
        prefix: text ahead of their names in messages.
        samples: number of samples of each column; None if the first column determines it.
    """
    columns: dict[str, np.ndarray] = {}
    for key, value in given.items():
        array = numbers_of(value, f"{prefix}{key}", truths=True)
        if array.ndim not in (1, 2) or samples not in (None, len(array)):
            turned = array.ndim == 2 and array.shape[1] == samples
            raise RecordingError(
                f"has shape {array.shape}" + f", but others have {samples} rows" * bool(samples),
                where=f"{prefix}{key}",
                cure="give one row a sample: "
                + (f"{key}.T" if turned else "(samples,) or (samples, columns)"),
            )
        samples = len(array)
        if array.ndim == 1:
            columns[str(key)] = copied(array)
        else:
            columns |= {f"{key}[{i}]": copied(column) for i, column in enumerate(array.T)}
    return columns


def units_of(
    given: Mapping[str, Units | None], unit_t: str | None, arrays: dict[str, np.ndarray], name: str
) -> dict[str, str]:
    """Stated units by the names of columns."""
    units = {} if unit_t is None else {"t": str(unit_t)}
    for key, unit in given.items():
        if unit is None:
            continue
        where = f"{name}, unit_{key}"
        if key not in arrays:
            raise RecordingError(
                f"{key} is not given", where=where, cure=f"omit unit_{key} or give {key}"
            )
        typed(where, unit, Iterable, "a unit, or one for each drive")
        drives = arrays[key].shape[1]
        each = [unit] * drives if isinstance(unit, str) else list(unit)
        if len(each) != drives:
            raise RecordingError(
                f"has {len(each)} units for {drives} drives",
                where=where,
                cure="give one for all, or one a drive",
            )
        units |= {f"{key}{i}": str(text) for i, text in enumerate(each, start=1)}
    return units
