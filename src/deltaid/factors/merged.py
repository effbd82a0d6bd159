"""Recordings of one robot together, from their factors: what a fit is posed from."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.factors.columns import GatheredColumns
from deltaid.factors.condensed import Group
from deltaid.factors.file import FactorFile
from deltaid.factors.target import Map, map_to
from deltaid.identification.additions import Addition
from deltaid.identification.gathering import Gathered
from deltaid.identification.geometry import GeometricRows
from deltaid.identification.information import Information, triangle
from deltaid.identification.load_columns import LoadColumns

# Stretches of all recordings together at most; of more recordings each is one stretch.
_STRETCHES = 400

Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Merging:
    """How factors of a recording become rows of a fit.

    Columns L of one recording alone, its lags and changes of its friction, are eliminated: rows are
    [Y, τ] − L B, and B is what least squares over the whole recording, with what is known of lags
    beside its rows, explains by them. What a load was taken to be and taken out of the torques is
    put back, and what the fit takes it to be is taken out.

    Attributes:
        columns: that were gathered, but for those of one recording alone.
        dynamics: of the robot that is fitted.
        additions: of all recordings.
    """

    columns: GatheredColumns
    dynamics: Dynamics
    additions: tuple[Addition, ...] = ()

    @cached_property
    def map(self) -> Map:
        """From gathered columns to those of the fit that are not always zero."""
        return self._map[:, self.active]

    @cached_property
    def active(self) -> Int[np.ndarray, " columns"]:
        """Which columns of the fit are not always zero."""
        return np.flatnonzero(np.any(self._map != 0.0, axis=0))

    @cached_property
    def _map(self) -> Map:
        return map_to(self.columns, self.dynamics, self.additions)

    def part(self, one: FactorFile) -> "Part":
        """A recording's part of the fit."""
        embedding = self._embedding(one)
        whole, by_own = list[Rows](), list[Rows]()
        for i, (L, A) in enumerate(self._rows(one, embedding, one.condensed.whole)):
            lag = _known_lag(one, embedding, i)
            L = np.vstack([L, lag[:, :-1]])
            A = np.vstack([A, np.pad(lag[:, -1:], ((0, 0), (A.shape[1] - 1, 0)))])
            B = _explained(L, A)
            by_own.append(B)
            whole.append(A - L @ B)
        groups = {
            group.name: tuple(
                A - L @ B
                for (L, A), B in zip(self._rows(one, embedding, group), by_own, strict=True)
            )
            for group in one.condensed.groups
        }
        return Part(one, self.active, tuple(whole), groups)

    def geometry(self, one: FactorFile, weights: Float[np.ndarray, " drives"]) -> GeometricRows:
        """What tolerances of the description do to rows of a recording, weighted as in the fit."""
        group, shared = one.condensed.geometry, self._embedding(one).shared
        assert group is not None
        Y, D, tau = [], [], []
        for R, at, weight in zip(group.factors, one.condensed.felt, weights, strict=True):
            n = len(at)
            Y.append(weight * R[:, :n] @ shared[at] @ self.map)
            D.append(weight * R[:, n:-1])
            tau.append(weight * R[:, -1])
        return GeometricRows(np.vstack(Y), np.concatenate(tau), np.vstack(D), one.record.quantities)

    def _embedding(self, one: FactorFile) -> "_Embedding":
        place = {name: k for k, name in enumerate(self.columns.kept_names)}
        names = one.condensed.names
        shared = np.zeros((len(names), len(place)))
        for k, name in enumerate(names):
            if name in place:
                shared[k, place[name]] = 1.0
        own = np.array([k for k, name in enumerate(names) if name not in place], dtype=int)
        return _Embedding(shared, own, self._put_back(one, place))

    def _put_back(self, one: FactorFile, place: dict[str, int]) -> Float[np.ndarray, " kept"]:
        """Loads that were taken out of the torques less those that the fit takes out."""
        taken = {load.load.name: np.array(load.taken) for load in one.record.loads}
        back = np.zeros(len(place))
        for load in self.additions:
            if isinstance(load, LoadColumns) and load.load.name in taken and load.parameters:
                more = taken[load.load.name] - load.taken
                for parameter, value in zip(load.parameters, more.tolist(), strict=True):
                    if parameter.name in place:
                        back[place[parameter.name]] = value
        return back

    def _rows(
        self, one: FactorFile, embedding: "_Embedding", group: Group
    ) -> list[tuple[Rows, Rows]]:
        """L and [Y, τ] of each drive."""
        found = list[tuple[Rows, Rows]]()
        for F in one.condensed.over(group):
            G = F[:, :-1] @ embedding.shared
            tau = F[:, -1] + G @ embedding.back
            found.append((F[:, embedding.own], np.column_stack([G @ self.map, tau])))
        return found


@dataclass(frozen=True, eq=False)
class _Embedding:
    """How columns of one recording stand among those of all.

    Attributes:
        shared: ones where a column is one of all; rows of its own columns are zero.
        own: which these are.
        back: what is put back to the torques, by columns of all.
    """

    shared: Float[np.ndarray, "gathered kept"]
    own: Int[np.ndarray, " own"]
    back: Float[np.ndarray, " kept"]


@dataclass(frozen=True, eq=False)
class Part:
    """A recording's part of a fit.

    Attributes:
        file: its factors.
        active: columns of the fit that are not always zero.
        whole: all its rows of [Y, τ], drive by drive, and what is known of its lags.
        groups: rows of its stretches and places.
    """

    file: FactorFile
    active: Int[np.ndarray, " columns"]
    whole: tuple[Rows, ...]
    groups: dict[str, tuple[Rows, ...]]

    @cached_property
    def information(self) -> Information:
        """All of it."""
        return self._information(self.whole, self.file.condensed.whole)

    @property
    def stretches(self) -> tuple[Information, ...]:
        """Its stretches of time, in order."""
        return tuple(
            self._information(self.groups[group.name], group)
            for group in self.file.condensed.groups
            if group.name.startswith("time")
        )

    def _information(self, rows: Sequence[Rows], group: Group) -> Information:
        factors = _triangles([[own] for own in rows])
        return Information(self.active, factors, group.samples, group.torque_max)


def merged(merging: Merging, files: Sequence[FactorFile]) -> Gathered:
    """What recordings say together, in an order of its own: by their checksums.

    So results are equal to the bit whatever order they come in.
    """
    parts = [merging.part(one) for one in sorted(files, key=lambda one: one.record.sha256)]
    is_fine = sum(len(part.groups) for part in parts) <= _STRETCHES or len(parts) == 1
    sums: dict[str, np.ndarray] = {}
    for part in parts:
        for name, rows in part.groups.items():
            if name.startswith("place"):
                products = np.stack([F.T @ F for F in rows])
                sums[name] = sums.get(name, 0.0) + products
    return Gathered(
        parts=tuple(part.stretches if is_fine else (part.information,) for part in parts),
        places=np.stack([sums[name] for name in sorted(sums)]),
        whole=_together([part.information for part in parts]),
    )


def _together(parts: Sequence[Information]) -> Information:
    """Everything; triangles of all at once."""
    drives = range(len(parts[0].factors))
    return Information(
        parts[0].columns,
        _triangles([[part.factors[i] for part in parts] for i in drives]),
        np.sum([part.samples for part in parts], axis=0),
        np.max([part.torque_max for part in parts], axis=0),
    )


def _triangles(rows: Sequence[Sequence[Rows]]) -> Float[np.ndarray, "drives n n"]:
    """A square triangle of each drive's rows."""
    found = [triangle(np.vstack(own)) for own in rows]
    n = found[0].shape[1]
    return np.stack([np.pad(R, ((0, n - len(R)), (0, 0))) for R in found])


def _explained(L: Rows, A: Rows) -> Rows:
    """B of the least ‖A − L B‖; columns of any size, and those that are zero explain nothing."""
    sizes = np.linalg.norm(L, axis=0)
    sizes[sizes == 0.0] = 1.0
    return np.linalg.lstsq(L / sizes, A, rcond=None)[0] / sizes[:, None]


def _known_lag(one: FactorFile, embedding: _Embedding, drive: int) -> Rows:
    """What is known of a drive's lag without its rows, as one row of them or none: [L, τ]."""
    lag, names = one.record.lags[drive], one.condensed.names
    if lag.deviation is None:
        return np.zeros((0, len(embedding.own) + 1))
    weight = one.record.noise[drive] / lag.deviation
    is_its = np.array([names[k] == f"lag.{lag.drive}" for k in embedding.own])
    return weight * np.append(is_its, lag.beside)[None]
