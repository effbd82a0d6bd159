"""Validation of array arguments, and decorators by which methods of many samples accept a single
one."""

import functools
import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, ParamSpec, TypeVar

import numpy as np

from deltaid.errors import DeltaidError, KinematicsError


def real_numbers(
    value: Any, where: str, *, cure: str = "", error: type[DeltaidError] = DeltaidError
) -> np.ndarray:
    """An array of integers or floating-point numbers from anything array-like.

    NumPy itself would accept masked numbers, real parts of complex ones, true as 1 and '1' as 1.

    Raises:
        DeltaidError: values are masked, complex or not numbers, or rows differ in length; `error`
            is its class.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise error(
            "has masked values", where=where, cure="cut them off; deltaid does not fill gaps"
        )
    cure = cure or "give an array of real numbers"
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise error("rows differ in length", where=where, cure=cure) from None
    if array.dtype.kind not in "iuf":
        raise error(f"holds {array.dtype}, not numbers", where=where, cure=cure)
    return array


_P = ParamSpec("_P")
_R = TypeVar("_R")


def one_or_many(*names: str) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Let a method of rows (samples, dof) accept a single sample (dof,).

    The named arguments come first. If all are vectors, the method gets each as one row, and the
    caller the first row of its result: of an array, or of each array in a tuple or data class.
    Sequences of numbers count as arrays.

    Raises:
        KinematicsError: an argument, which is named, is no vector or matrix, has not one column for
            each of the robot's drives, has another number of rows than the first, or is not finite
            where the pose is.
    """

    def decorate(method: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(method)
        def call(self: Any, /, *arguments: Any, **keywords: Any) -> Any:
            first = dict(zip(names, arguments, strict=False))
            given = first | {k: keywords[k] for k in names if keywords.get(k) is not None}
            rows = dict(zip(given, as_rows(self.dof, **given), strict=True))
            require_finite(**rows)
            ordered = [*(rows[name] for name in first), *arguments[len(first) :]]
            named = {name: rows.get(name, value) for name, value in keywords.items()}
            out = method(self, *ordered, **named)  # pyright: ignore[reportCallIssue]
            single = rows and all(np.ndim(value) == 1 for value in given.values())
            return _first(out) if single else out

        return call  # pyright: ignore[reportReturnType]

    return decorate


def as_rows(dof: int, **given: Any) -> tuple[np.ndarray, ...]:
    """Arrays with one sample a row, from rows or single samples.

    Raises:
        KinematicsError: as in `one_or_many`.
    """
    arrays = {name: np.atleast_2d(_array(value, dof, name)) for name, value in given.items()}
    first = next(iter(arrays), "")
    for name, rows in arrays.items():
        if len(rows) != len(arrays[first]):
            raise KinematicsError(
                f"has {len(rows)} samples, but {first} has {len(arrays[first])}",
                where=name,
                cure="give one row a sample in each of them",
            )
    return tuple(arrays.values())


def numbered(**arrays: np.ndarray) -> dict[str, np.ndarray]:
    """Columns q1, q2, … of arrays with one sample a row."""
    return {f"{name}{i}": x for name, rows in arrays.items() for i, x in enumerate(rows.T, 1)}


def one_or_many_times(method: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let a method of times (samples,) accept a single time."""

    @functools.wraps(method)
    def call(self: Any, time: Any) -> Any:
        times = real_numbers(time, "time").astype(float)
        out = method(self, np.atleast_1d(times))  # pyright: ignore[reportCallIssue]
        return out if times.ndim else _first(out)

    return call  # pyright: ignore[reportReturnType]


def _array(value: Any, dof: int, name: str) -> np.ndarray:
    cure = f"give an array of shape (samples, {dof}), or a single sample of shape ({dof},)"
    array = real_numbers(value, name, cure=cure, error=KinematicsError).astype(float, copy=False)
    if array.ndim not in (1, 2) or array.shape[-1] != dof:
        turned = array.ndim == 2 and array.shape[0] == dof
        raise KinematicsError(
            f"expected arrays of shape (samples, {dof}), got {array.shape}",
            where=name,
            cure=f"give one sample a row: {name}.T"
            if turned
            else "give one sample a row, or a single sample as a vector",
        )
    return array


# Arguments that are poses. They are NaN out of reach, and so is all that follows from them.
_POSES = ("z", "q")


def require_finite(**given: np.ndarray) -> None:
    """Refuse a speed, acceleration or torque that is not finite at a pose that is.

    Raises:
        KinematicsError: names the argument with the place of its first such number.
    """
    for name, rows in given.items():
        if name in _POSES or _is_finite(rows):
            continue
        there = np.ones((len(rows), 1), dtype=bool)
        for pose in given.keys() & _POSES:
            there &= np.isfinite(given[pose]).all(axis=1, keepdims=True)
        wrong = ~np.isfinite(rows) & there
        for sample, drive in np.argwhere(wrong)[:1]:
            raise not_finite(name, rows, int(sample), int(drive))


def not_finite(name: str, rows: np.ndarray, sample: int, drive: int) -> KinematicsError:
    return KinematicsError(
        f"is {rows[sample, drive]:g}, not a finite number",
        where=f"{name}[{sample}, {drive}]",
        cure="cut off the samples without a number, or fill them in",
    )


def _is_finite(rows: np.ndarray) -> bool:
    if len(rows) == 1:  # half the time; for many samples it would start BLAS's threads
        return math.isfinite(np.vdot(rows, rows))
    return bool(np.isfinite(rows).all())


def _first(out: Any) -> Any:
    """The first row of an array, or of each array in a tuple or data class."""
    if isinstance(out, np.ndarray):
        return out[0]
    if isinstance(out, tuple):
        return tuple(map(_first, out))
    if is_dataclass(out) and not isinstance(out, type):
        held = {field.name: getattr(out, field.name) for field in fields(out)}
        arrays = {key: np.asarray(x[0]) for key, x in held.items() if isinstance(x, np.ndarray)}
        return replace(out, **arrays)
    return out
