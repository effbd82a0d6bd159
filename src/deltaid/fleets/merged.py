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
from deltaid.estimation.information import Information, merge, triangle
from deltaid.estimation.problem import Span
from deltaid.fleets.factor_columns import GatheredColumns, map_to, plain
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import FactorGroups
from deltaid.identification.fit import FittedProblem, fit_to
from deltaid.identification.friction_constants import LawConstants
from deltaid.identification.gathering import Gathered, balanced
from deltaid.identification.geometric_rows import GeometricRows, shifted
from deltaid.identification.loads import Held, joined
from deltaid.identification.widening import widened
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.sensors.weighings import weighings

# Stretches of all recordings together at most; of more recordings each is one stretch.
_STRETCHES = 400

Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class MergedPart:
    """A recording's part of a fit; stretches and places are made where they are asked for."""

    information: Information  # all of it, with what is known of its lags
    groups: FactorGroups
    views: tuple[Rows, ...]  # V of each drive, [Y, τ] = R V

    @property
    def stretches(self) -> tuple[Information, ...]:
        """Of time, in order."""
        groups, active = self.groups.named("time"), self.information.columns
        each = zip(triangle(self._rows(groups)), groups.samples, groups.torque_max, strict=True)
        return tuple(Information(active, *stretch) for stretch in each)

    @property
    def places(self) -> dict[str, Float[np.ndarray, "drives augmented augmented"]]:
        """[Y, τ]ᵀ[Y, τ] by place."""
        groups = self.groups.named("place")
        A = self._rows(groups)
        return dict(zip(groups.names, A.swapaxes(2, 3) @ A, strict=True))

    def _rows(self, groups: FactorGroups) -> Float[np.ndarray, "groups drives _ augmented"]:
        return _stacked([R @ view for R, view in zip(groups.factors, self.views, strict=True)])


@dataclass(frozen=True, eq=False)
class Merging:
    """How factors of a recording become rows of a fit.

    Columns L of one recording alone, its lags and changes of its friction, are eliminated: rows are
    [Y, τ] − L B, and B is what least squares over the whole recording, with what is known of lags
    beside its rows, explains by them. What a load was taken to be and taken out of the torques is
    put back, and what the fit takes it to be is taken out.
    """

    columns: GatheredColumns  # that were gathered, but for those of one recording alone
    dynamics: Dynamics  # of the robot that is fitted
    additions: tuple[Addition, ...] = ()  # of all recordings

    @cached_property
    def active(self) -> Int[np.ndarray, " columns"]:
        """Which columns of the fit are not always zero."""
        return np.flatnonzero(np.any(self._map != 0.0, axis=0))

    @cached_property
    def _map(self) -> Float[np.ndarray, "kept columns"]:
        return map_to(self.columns, self.dynamics, self.additions)

    @cached_property
    def _active_map(self) -> Float[np.ndarray, "kept active"]:
        return self._map[:, self.active]

    def part(self, file: FactorFile) -> MergedPart:
        """A recording's part of the fit."""
        whole, views = list[Rows](), list[Rows]()
        for i, R in enumerate(file.condensed.whole.factors):
            view, local = self._view(file, i)
            places, lag = list(local.values()), file.record.lags[i]
            weight = file.record.noise[i] / lag.deviation if lag.deviation else 0.0
            is_lag = np.array([name == f"lag.{lag.drive}" for name in local], dtype=bool)
            prior = np.zeros(view.shape[1])
            prior[-1] = weight * lag.beside
            span, A = (
                Span.of_columns(np.vstack([R[:, places], weight * is_lag])),
                np.vstack([R @ view, prior]),
            )
            whole.append(span.without(A))
            view[places] -= span.inverse @ (span.Q.T @ A)
            views.append(view)

        group, everything = file.condensed.whole, triangle(_stacked(whole))
        information = Information(self.active, everything, group.samples, group.torque_max)
        return MergedPart(information, file.condensed.groups, tuple(views))

    def geometry(self, file: FactorFile, weights: Float[np.ndarray, " drives"]) -> GeometricRows:
        """What tolerances of the description do to rows of a recording, weighted as in the fit."""
        group = file.condensed.geometry
        assert group is not None
        rows = list[Rows]()
        for i, (R, weight) in enumerate(zip(group.factors, weights, strict=True)):
            view = self._view(file, i)[0][:-1, :-1]
            rows.append(weight * np.column_stack([R[:, : len(view)] @ view, R[:, len(view) :]]))
        Y, D, tau = np.split(np.vstack(rows), [len(self.active), -1], axis=1)
        return GeometricRows(Y, tau[:, 0], D, file.record.quantities)

    def _view(self, file: FactorFile, drive: int) -> tuple[Rows, dict[str, int]]:
        """V with [Y, τ] = R V of a drive's factors R, and places of its columns of this recording
        alone."""
        names = [file.condensed.names[k] for k in file.condensed.felt[drive]]
        place = np.array([self.columns.place.get(name, -1) for name in names])
        local = {names[row]: row for row in np.flatnonzero(place < 0).tolist()}
        view = np.zeros((len(names) + 1, len(self.active) + 1))
        view[np.flatnonzero(place >= 0), :-1] = self._active_map[place[place >= 0]]
        taken = {held.load.name: np.array(held.taken) for held in file.record.loads}
        zeros = np.zeros(len(self.dynamics.layout.names))
        view[:, -1] = view[:, :-1] @ np.append(zeros, self.of_loads(taken))[self.active]
        view[-1, -1] = 1.0
        return view, local

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


def _stacked(
    rows: Sequence[Float[np.ndarray, "*many _ augmented"]],
) -> Float[np.ndarray, "*many drives _ augmented"]:
    """Rows of all drives, with as many zero rows behind them as make all triangles of one size."""
    size = rows[0].shape[-1]
    most = max(size, *(A.shape[-2] for A in rows))
    wide = np.zeros((*rows[0].shape[:-2], len(rows), most, size))
    for i, A in enumerate(rows):
        wide[..., i, : A.shape[-2], :] = A
    return wide


def merged(merging: Merging, files: Sequence[FactorFile]) -> Gathered:
    """Recordings together, ordered by their checksums, so results do not depend on their order."""
    fine = len(files) == 1 or sum(len(file.condensed.groups) for file in files) <= _STRETCHES
    stretches, whole, places = [], list[Information](), dict[str, np.ndarray]()
    for file in ordered(files):
        part = merging.part(file)
        for name, products in part.places.items():
            places[name] = places.get(name, 0.0) + products
        stretches.append(part.stretches if fine else (part.information,))
        whole.append(part.information)
    every = np.stack([places[name] for name in sorted(places)])
    return Gathered(tuple(stretches), every, merge(whole))


def fitted(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> FittedProblem:
    """The fit of a robot, with the friction laws that are to be fitted, to its recordings by their
    factors, by the settings of method, regulariser, γ and prior's spread.

    Raises:
        IdentificationError: the fit cannot be posed, or its solver did not reach its end.
    """
    merging = merging_of(files, robot, settings)
    gathered = balanced(merged(merging, files), weighings(robot))
    problem = fit_to(gathered, merging.dynamics, settings, merging.additions)
    weights = np.sqrt(problem.information.weights)
    rows = [merging.geometry(file, weights) for file in files if file.condensed.geometry]
    if rows:
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
    columns = GatheredColumns.for_robot(robot, prior_parameters(plain(robot)), loads)
    return Merging(columns, dynamics, (*loads, constants) if constants.parameters else loads)


def holding(files: Sequence[FactorFile]) -> Held:
    """What the recordings of files hold."""
    return [(file.record.log, [held.load for held in file.record.loads]) for file in files]


def ordered(files: Sequence[FactorFile]) -> list[FactorFile]:
    """By the recordings' checksums."""
    return sorted(files, key=lambda file: file.record.sha256)
