"""Recordings of one robot together, from their factors: what a fit is posed from."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition
from deltaid.estimation.information import Information, merge, triangle
from deltaid.factors.columns import GatheredColumns
from deltaid.factors.condensed import Group
from deltaid.factors.file import FactorFile
from deltaid.factors.target import Map, map_to
from deltaid.identification.gathering import Gathered
from deltaid.identification.geometry import GeometricRows
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

    def part(self, one: FactorFile, *, fine: bool = True) -> "Part":
        """A recording's part of the fit.

        Args:
            fine: whether its stretches of time are looked at one by one.
        """
        whole, views = list[Rows](), list[Rows]()
        for i, R in enumerate(one.condensed.whole.factors):
            view, own = self._view(one, i)
            lag = _known_lag(one, own, i)
            L, A = np.vstack([R @ own.at, lag[:, :-1]]), R @ view
            beside = np.zeros((len(lag), A.shape[1]))
            beside[:, -1] = lag[:, -1]
            A = np.vstack([A, beside])
            B = _explained(L, A)
            whole.append(A - L @ B)
            views.append(view - own.at @ B)

        def information(group: Group, rows: Iterable[Rows]) -> Information:
            return Information(self.active, _triangles(rows), group.samples, group.torque_max)

        def rows(group: Group) -> Iterator[Rows]:
            return (R @ view for R, view in zip(group.factors, views, strict=True))

        everything = information(one.condensed.whole, whole)
        stretches = (
            information(group, rows(group)) for group in one.condensed.groups.named("time")
        )
        return Part(
            everything,
            tuple(stretches) if fine else (everything,),
            {
                group.name: np.stack([A.T @ A for A in rows(group)])
                for group in one.condensed.groups.named("place")
            },
        )

    def geometry(self, one: FactorFile, weights: Float[np.ndarray, " drives"]) -> GeometricRows:
        """What tolerances of the description do to rows of a recording, weighted as in the fit."""
        group = one.condensed.geometry
        assert group is not None
        Y, D, tau = [], [], []
        for i, (R, weight) in enumerate(zip(group.factors, weights, strict=True)):
            view, _ = self._view(one, i)
            n = len(view) - 1
            Y.append(weight * R[:, :n] @ view[:-1, :-1])
            D.append(weight * R[:, n:-1])
            tau.append(weight * R[:, -1])
        return GeometricRows(np.vstack(Y), np.concatenate(tau), np.vstack(D), one.record.quantities)

    def _view(self, one: FactorFile, drive: int) -> tuple[Rows, "_Own"]:
        """V with [Y, τ] = R V of a drive's factors R, and its columns of this recording alone."""
        names = [one.condensed.names[k] for k in one.condensed.felt[drive]]
        shared = np.zeros((len(names), len(self._place)))
        for k, name in enumerate(names):
            if name in self._place:
                shared[k, self._place[name]] = 1.0
        view = np.zeros((len(names) + 1, len(self.active) + 1))
        view[:-1, :-1], view[:-1, -1] = shared @ self.map, shared @ self._put_back(one)
        view[-1, -1] = 1.0
        own = [k for k, name in enumerate(names) if name not in self._place]
        return view, _Own(tuple(names[k] for k in own), np.eye(len(names) + 1)[:, own])

    @cached_property
    def _place(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.columns.kept_names)}

    def _put_back(self, one: FactorFile) -> Float[np.ndarray, " kept"]:
        """Loads that were taken out of the torques less those that the fit takes out."""
        taken = {load.load.name: np.array(load.taken) for load in one.record.loads}
        back = np.zeros(len(self._place))
        for load in self.additions:
            if isinstance(load, LoadColumns) and load.load.name in taken and load.parameters:
                more = taken[load.load.name] - load.taken
                for parameter, value in zip(load.parameters, more.tolist(), strict=True):
                    if parameter.name in self._place:
                        back[self._place[parameter.name]] = value
        return back


@dataclass(frozen=True, eq=False)
class _Own:
    """Columns of one recording alone.

    Attributes:
        names: of them.
        at: ones where they stand in a drive's factors.
    """

    names: tuple[str, ...]
    at: Float[np.ndarray, "felt own"]


@dataclass(frozen=True, eq=False)
class Part:
    """A recording's part of a fit.

    Attributes:
        information: all of it, and what is known of its lags.
        stretches: of time, in order; or all in one.
        places: [Y, τ]ᵀ[Y, τ] of each drive, place by place.
    """

    information: Information
    stretches: tuple[Information, ...]
    places: dict[str, Float[np.ndarray, "drives augmented augmented"]]


def merged(merging: Merging, files: Sequence[FactorFile]) -> Gathered:
    """What recordings say together, in an order of its own: by their checksums.

    So results are equal to the bit whatever order they come in.
    """
    fine = len(files) == 1 or sum(len(one.condensed.groups) for one in files) <= _STRETCHES
    parts, places = list[Part](), dict[str, np.ndarray]()
    for one in sorted(files, key=lambda one: one.record.sha256):
        part = merging.part(one, fine=fine)
        for name, products in part.places.items():
            places[name] = places.get(name, 0.0) + products
        parts.append(replace(part, places={}))
    return Gathered(
        parts=tuple(part.stretches for part in parts),
        places=np.stack([places[name] for name in sorted(places)]),
        whole=merge([part.information for part in parts]),
    )


def _triangles(rows: Iterable[Rows]) -> Float[np.ndarray, "drives n n"]:
    """A square triangle of each drive's rows."""
    found = [triangle(own) for own in rows]
    n = found[0].shape[1]
    return np.stack([np.pad(R, ((0, n - len(R)), (0, 0))) for R in found])


def _explained(L: Rows, A: Rows) -> Rows:
    """B of the least ‖A − L B‖; columns of any size, and those that are zero explain nothing."""
    sizes = np.linalg.norm(L, axis=0)
    sizes[sizes == 0.0] = 1.0
    return np.linalg.lstsq(L / sizes, A, rcond=None)[0] / sizes[:, None]


def _known_lag(one: FactorFile, own: _Own, drive: int) -> Rows:
    """What is known of a drive's lag without its rows, as one row of them or none: [L, τ]."""
    lag = one.record.lags[drive]
    if lag.deviation is None:
        return np.zeros((0, len(own.names) + 1))
    weight = one.record.noise[drive] / lag.deviation
    return weight * np.array([[*(name == f"lag.{lag.drive}" for name in own.names), lag.beside]])
