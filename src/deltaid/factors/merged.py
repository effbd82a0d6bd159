"""Recordings of one robot together, from their factors: what a fit is posed from."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.factors.columns import GatheredColumns
from deltaid.factors.condensed import Group
from deltaid.factors.file import FactorFile
from deltaid.factors.record import KnownLag
from deltaid.factors.target import Maps, maps
from deltaid.identification.additions import Addition
from deltaid.identification.gathering import Gathered
from deltaid.identification.geometry import GeometricRows
from deltaid.identification.information import Information, triangle

# Groups of all recordings together, about; of very many recordings each is one stretch.
_STRETCHES = 400

Factors = Float[np.ndarray, "drives augmented augmented"]


@dataclass(frozen=True, eq=False)
class Merging:
    """How factors of a recording become rows of a fit.

    Columns that belong to one recording alone, its lags, are eliminated from them: [Y, τ] − l b, l
    the lag's column and b what least squares over the whole recording, with what is known of the
    lag beside its rows, explains by it.

    Attributes:
        columns: that were gathered.
        dynamics: of the robot that is fitted.
        additions: of all recordings.
    """

    columns: GatheredColumns
    dynamics: Dynamics
    additions: tuple[Addition, ...] = ()

    @cached_property
    def maps(self) -> Maps:
        """From gathered columns to those of the fit."""
        return maps(self.columns, self.dynamics, self.additions)

    @cached_property
    def active(self) -> np.ndarray:
        """Which columns of the fit are not always zero."""
        return np.flatnonzero(np.any(self.maps != 0.0, axis=(0, 1)))

    def part(self, one: FactorFile) -> "Part":
        """A recording's part of the fit."""
        whole = self._over(one, one.condensed.whole)
        b = [self._by_lag(whole[i], one, i) for i in range(len(whole))]
        groups = {
            group.name: self._without(self._over(one, group), b) for group in one.condensed.groups
        }
        return Part(one, self._triangles(self._without(whole, b)), groups)

    def _over(self, one: FactorFile, group: Group) -> list[np.ndarray]:
        """[l, Y, τ] of each drive."""
        wide, names = one.condensed.over(group), list(one.condensed.names)
        found = []
        for i, F in enumerate(wide):
            lag = F[:, names.index(f"lag.{self.dynamics.robot.drives[i]}")]
            Y = F[:, :-1] @ self.maps[i][:, self.active]
            found.append(np.column_stack([lag, Y, F[:, -1]]))
        return found

    def _by_lag(self, whole: np.ndarray, one: FactorFile, drive: int) -> np.ndarray:
        """b of a drive."""
        lag = whole[:, 0]
        known: KnownLag = one.record.lags[drive]
        beside = np.zeros(whole.shape[1])
        weight = 0.0
        if known.deviation is not None:
            weight = (one.record.noise[drive] / known.deviation) ** 2
            beside[-1] = weight * known.beside
        size = float(lag @ lag) + weight
        return (lag @ whole + beside) / size if size > 0 else np.zeros(whole.shape[1])

    def _without(self, rows: list[np.ndarray], b: list[np.ndarray]) -> list[np.ndarray]:
        return [F[:, 1:] - np.outer(F[:, 0], x[1:]) for F, x in zip(rows, b, strict=True)]

    def _triangles(self, rows: list[np.ndarray]) -> Factors:
        n = len(self.active) + 1
        return np.stack([_square(triangle(F), n) for F in rows])


@dataclass(frozen=True, eq=False)
class Part:
    """A recording's part of a fit.

    Attributes:
        file: its factors.
        whole: triangles of all its rows.
        groups: rows of its stretches and places.
    """

    file: FactorFile
    whole: Factors
    groups: dict[str, list[np.ndarray]]

    def information(self, active: np.ndarray) -> Information:
        """All of it."""
        group = self.file.condensed.whole
        return Information(active, self.whole, group.samples, group.torque_max)

    def stretches(self, active: np.ndarray, count: int) -> tuple[Information, ...]:
        """Its stretches, so many or all together."""
        own = [one for one in self.file.condensed.groups if one.name.startswith("time")]
        if count <= 1 or len(own) < count:
            return (self.information(active),) if count <= 1 else self._each(own, active)
        return self._each(own, active)

    def _each(self, own: Sequence[Group], active: np.ndarray) -> tuple[Information, ...]:
        n = len(active) + 1
        return tuple(
            Information(
                active,
                np.stack([_square(triangle(F), n) for F in self.groups[one.name]]),
                one.samples,
                one.torque_max,
            )
            for one in own
        )


def merged(merging: Merging, files: Sequence[FactorFile]) -> Gathered:
    """What recordings say together, in an order of its own: by their checksums.

    So results are equal to the bit whatever order they come in.
    """
    ordered = sorted(files, key=lambda one: one.record.sha256)
    active = merging.active
    parts = [merging.part(one) for one in ordered]
    each = 2 if len(files) * len(files[0].condensed.groups) <= _STRETCHES or len(files) == 1 else 1
    sums: dict[str, np.ndarray] = {}
    for part in parts:
        for name, rows in part.groups.items():
            if name.startswith("place"):
                products = np.stack([F.T @ F for F in rows])
                sums[name] = sums.get(name, 0.0) + products
    return Gathered(
        parts=tuple(part.stretches(active, each) for part in parts),
        places=np.stack([sums[name] for name in sorted(sums)]),
        whole=_together([part.information(active) for part in parts]),
    )


def _together(parts: Sequence[Information]) -> Information:
    """Everything; triangles of all at once."""
    first = parts[0]
    n = len(first.columns) + 1
    factors = [
        _square(triangle(np.vstack([part.factors[i] for part in parts])), n)
        for i in range(len(first.factors))
    ]
    return Information(
        first.columns,
        np.stack(factors),
        np.sum([part.samples for part in parts], axis=0),
        np.max([part.torque_max for part in parts], axis=0),
    )


def geometric(merging: Merging, one: FactorFile, weights: np.ndarray) -> GeometricRows:
    """What the tolerances of the description do to rows of a recording, weighted as in the fit."""
    geometry, quantities = one.condensed.geometry, one.record.quantities
    assert geometry is not None
    Y, D, tau = [], [], []
    n = len(one.condensed.names)
    for i, (R, at) in enumerate(zip(geometry.factors, one.condensed.felt, strict=True)):
        wide = np.zeros((len(R), n))
        wide[:, at] = R[:, : len(at)]
        Y.append(weights[i] * wide @ merging.maps[i][:, merging.active])
        D.append(weights[i] * R[:, len(at) : -1])
        tau.append(weights[i] * R[:, -1])
    return GeometricRows(np.vstack(Y), np.concatenate(tau), np.vstack(D), quantities)


def _square(R: np.ndarray, n: int) -> np.ndarray:
    """A triangle with rows of zeros up to n."""
    out = np.zeros((n, n))
    out[: len(R)] = R
    return out
