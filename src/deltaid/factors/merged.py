"""Recordings of one robot together, from their factors: the input of a fit, and the fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.load_columns import LoadColumns
from deltaid.estimation.additions import Addition
from deltaid.estimation.information import Information, merge
from deltaid.estimation.span import Span
from deltaid.factors.columns import GatheredColumns, map_to, plain
from deltaid.factors.condensed import Group
from deltaid.factors.file import FactorFile
from deltaid.identification.balance import balanced
from deltaid.identification.fit import FittedProblem, fit_to
from deltaid.identification.friction_curves import LawConstants
from deltaid.identification.gathering import Gathered
from deltaid.identification.geometry import GeometricRows, shifted
from deltaid.identification.loads import Held, joined
from deltaid.identification.widening import widened
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.sensors.weighings import weighings

# Stretches of all recordings together at most; of more recordings each is one stretch.
_STRETCHES = 400

Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Part:
    """A recording's part of a fit: all of it, with what is known of its lags; stretches of time in
    order, or all in one; [Y, τ]ᵀ[Y, τ] of each drive by place."""

    information: Information
    stretches: tuple[Information, ...]
    places: dict[str, Float[np.ndarray, "drives augmented augmented"]]


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
    def active(self) -> Int[np.ndarray, " columns"]:
        """Which columns of the fit are not always zero."""
        return np.flatnonzero(np.any(self._map != 0.0, axis=0))

    @cached_property
    def _map(self) -> Float[np.ndarray, "kept columns"]:
        return map_to(self.columns, self.dynamics, self.additions)

    def part(self, file: FactorFile, *, fine: bool = True) -> Part:
        """A recording's part of the fit.

        Args:
            fine: whether its stretches of time are taken one by one.
        """
        whole, views = list[Rows](), list[Rows]()
        for i, R in enumerate(file.condensed.whole.factors):
            view, local = self._view(file, i)
            lag = file.record.lags[i]
            weight = file.record.noise[i] / lag.deviation if lag.deviation else 0.0
            prior = np.zeros(view.shape[1])
            prior[-1] = weight * lag.beside
            L = np.vstack([R[:, list(local.values())],
                           [weight * (name == f"lag.{lag.drive}") for name in local]])  # fmt: skip
            span, A = Span.of(L), np.vstack([R @ view, prior])
            whole.append(span.without(A))
            view[list(local.values())] -= span.inverse @ (span.Q.T @ A)
            views.append(view)

        def rows(group: Group) -> list[Rows]:
            return [R @ view for R, view in zip(group.factors, views, strict=True)]

        groups, everything = file.condensed.groups, self._information(file.condensed.whole, whole)
        stretches = (self._information(group, rows(group)) for group in groups.named("time"))
        places = {
            group.name: np.stack([A.T @ A for A in rows(group)]) for group in groups.named("place")
        }
        return Part(everything, tuple(stretches) if fine else (everything,), places)

    def geometry(self, file: FactorFile, weights: Float[np.ndarray, " drives"]) -> GeometricRows:
        """What tolerances of the description do to rows of a recording, weighted as in the fit."""
        group, n = file.condensed.geometry, len(self.active)
        assert group is not None
        rows = list[Rows]()
        for i, (R, weight) in enumerate(zip(group.factors, weights, strict=True)):
            view = self._view(file, i)[0][:-1, :-1]
            rows.append(weight * np.column_stack([R[:, : len(view)] @ view, R[:, len(view) :]]))
        Y, D, tau = np.split(np.vstack(rows), [n, n + len(file.record.quantities)], axis=1)
        return GeometricRows(Y, tau[:, 0], D, file.record.quantities)

    def _information(self, group: Group, rows: Sequence[Rows]) -> Information:
        size = len(self.active) + 1
        wide = np.zeros((len(rows), max(size, *(len(A) for A in rows)), size))
        for i, A in enumerate(rows):
            wide[i, : len(A)] = A
        factors = np.asarray(np.linalg.qr(wide, mode="r"))
        return Information(self.active, factors, group.samples, group.torque_max)

    def _view(self, file: FactorFile, drive: int) -> tuple[Rows, dict[str, int]]:
        """V with [Y, τ] = R V of a drive's factors R, and places of its columns of this recording
        alone."""
        place = self.columns.place
        names = [file.condensed.names[k] for k in file.condensed.felt[drive]]
        view = np.zeros((len(names) + 1, len(self.active) + 1))
        for row, name in zip(view, names, strict=False):
            if name in place:
                row[:-1] = self._map[place[name], self.active]
        taken = {held.load.name: np.array(held.taken) for held in file.record.loads}
        zeros = np.zeros(len(self.dynamics.layout.names))
        view[:, -1] = view[:, :-1] @ np.append(zeros, self.of_loads(taken))[self.active]
        view[-1, -1] = 1.0
        return view, {name: k for k, name in enumerate(names) if name not in place}

    def of_loads(self, known: Mapping[str, Float[np.ndarray, " 10"]]) -> Float[np.ndarray, " _"]:
        """Values of the additions: of known loads less what has been taken out already; zero of all
        others."""
        values = [
            known[added.load.name] - added.taken
            if isinstance(added, LoadColumns) and added.parameters and added.load.name in known
            else np.zeros(len(added.parameters))
            for added in self.additions
        ]
        return np.concatenate([np.zeros(0), *values])


def merged(merging: Merging, files: Sequence[FactorFile]) -> Gathered:
    """Recordings together, ordered by their checksums, so results do not depend on their order."""
    fine = len(files) == 1 or sum(len(file.condensed.groups) for file in files) <= _STRETCHES
    parts, places = list[Part](), dict[str, np.ndarray]()
    for file in ordered(files):
        part = merging.part(file, fine=fine)
        for name, products in part.places.items():
            places[name] = places.get(name, 0.0) + products
        parts.append(replace(part, places={}))
    return Gathered(
        parts=tuple(part.stretches for part in parts),
        places=np.stack([places[name] for name in sorted(places)]),
        whole=merge([part.information for part in parts]),
    )


def fitted(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> FittedProblem:
    """The fit of a robot to recordings by their factors.

    Args:
        files: of recordings of the same robot.
        robot: with the friction laws that are to be fitted.
        settings: method, regulariser, γ, prior's spread.

    Raises:
        IdentificationError: the fit cannot be posed, or its solver did not reach its end.
    """
    merging = merging_of(files, robot, settings)
    gathered = balanced(merged(merging, files), weighings(robot))
    problem = fit_to(gathered, merging.dynamics, settings, merging.additions)
    drives = np.sqrt(problem.information.drive_weights)
    with_geometry = [file for file in files if file.condensed.geometry is not None]
    if with_geometry:
        rows = [merging.geometry(file, drives) for file in with_geometry]
        geometry = shifted(rows, problem.base, problem.information, merging.additions)
        estimate = problem.estimate.with_shifts(geometry.shifts)
        problem = replace(problem, estimate=estimate, geometry=geometry)
    return widened(problem)


def merging_of(files: Sequence[FactorFile], robot: RobotDescription, settings: Settings) -> Merging:
    """How files become rows of a robot's fit, with loads of all of them, one of each name, and
    changes of the laws' constants."""
    dynamics, files = compiled(robot), ordered(files)
    taken = {held.load.name: held.taken for file in reversed(files) for held in file.record.loads}
    loads = tuple(
        LoadColumns(dynamics, load, settings.prior_spread, np.array(taken[load.name]))
        for load in joined(holding(files))
    )
    constants = LawConstants(dynamics)
    columns = GatheredColumns.of(robot, prior_parameters(plain(robot)), loads)
    return Merging(columns, dynamics, (*loads, constants) if constants.parameters else loads)


def holding(files: Sequence[FactorFile]) -> Held:
    """What the recordings of files hold."""
    return [(file.record.log, [held.load for held in file.record.loads]) for file in files]


def ordered(files: Sequence[FactorFile]) -> list[FactorFile]:
    """By the recordings' checksums."""
    return sorted(files, key=lambda file: file.record.sha256)
