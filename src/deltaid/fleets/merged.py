"""Rows of a robot's fit from the factors of recordings."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from statistics import median

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.load_columns import LoadColumns
from deltaid.estimation.additions import Addition
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.problem import Span, lengths
from deltaid.fleets.factor_columns import GatheredColumns, map_to, plain
from deltaid.fleets.factor_file import FactorFile, digest
from deltaid.fleets.factor_record import FactorGroups, RecordingBrief
from deltaid.identification.friction_constants import LawConstants
from deltaid.identification.loads import HeldLoads, joined_loads
from deltaid.levels import NEGLIGIBLE, ROUNDING
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import TERMS


def with_laws(
    robot: RobotDescription, briefs: Sequence[RecordingBrief], settings: Settings
) -> RobotDescription:
    """The robot with the friction laws to fit: those of the description, or for each joint the law
    that most of its recordings chose, in a tie the simpler one. Constants of its terms, such as
    Stribeck's speed, are medians over the recordings that chose it."""
    if settings.friction != "choose":
        return robot
    laws = {
        joint: _usual([brief.friction[joint] for brief in briefs])
        for joint in robot.friction
        if all(joint in brief.friction for brief in briefs)
    }
    return robot.changed(friction=dict(robot.friction) | laws)


def _usual(laws: Sequence[Friction]) -> Friction:
    kinds = Counter(terms_of(law) for law in laws)
    terms = min(kinds, key=lambda kind: (-kinds[kind], len(kind), kind))
    same = [law for law in laws if terms_of(law) == terms]
    law = min(same, key=lambda law: law.model_dump_json())
    for term in (term for term in TERMS if term.constants and term.kind in terms):
        parts = [getattr(law, term.kind) for law in same]
        values = {name: median(getattr(part, name) for part in parts) for name in term.constants}
        law = law.changed(**{term.kind: getattr(law, term.kind).changed(**values)})
    return law


def terms_of(law: Friction) -> tuple[str, ...]:
    return tuple(name for name, value in law if value is not None)


Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class MergedPart:
    """A recording's part of a fit; stretches and places are computed on request."""

    file: FactorFile
    information: Information  # all samples, with the prior of its lags
    views: tuple[Rows, ...]  # V of each drive, [Y, τ] = R V

    @property
    def stretches(self) -> tuple[Information, ...]:
        groups, active = self.file.groups.named("time"), self.information.columns
        each = zip(triangle(self.rows(groups)), groups.samples, groups.torque_max, strict=True)
        return tuple(Information(active, *stretch) for stretch in each)

    def rows(self, groups: FactorGroups) -> Float[np.ndarray, "groups drives _ augmented"]:
        """[Y, τ] of each group and drive."""
        return stacked([R @ view for R, view in zip(groups.factors, self.views, strict=True)])


@dataclass(frozen=True, eq=False)
class Independent:
    """Independent columns of rows Y, and all columns as their combinations: Y = Y[:, at] C.

    Attributes:
        at: indices of the independent columns.
        combinations: C.
    """

    at: Int[np.ndarray, " rank"]
    combinations: Float[np.ndarray, "rank columns"]

    @classmethod
    def of_columns(cls, Y: Rows) -> "Independent":
        """Independent columns of a matrix, by QR with pivoting of columns of unit length."""
        R, order = qr(Y / lengths(Y), mode="r", pivoting=True)
        size = np.abs(np.diag(R))
        rank = int(np.count_nonzero(size > NEGLIGIBLE * size.max(initial=0.0)))
        at = np.sort(order[:rank])
        C = np.linalg.lstsq(Y[:, at], Y, rcond=None)[0]
        C[np.abs(C) < ROUNDING * np.abs(C).max(initial=0.0)] = 0.0
        C[:, at] = np.eye(rank)
        return cls(at, C)


@dataclass(frozen=True, eq=False)
class Merging:
    """Map from the factors of a recording to rows of a fit.

    Columns L of one recording alone, its lags and changes of its friction, are eliminated: rows are
    [Y, τ] − L B, with B from least squares over the whole recording and the prior of its lags. The
    torques of loads are restored, and torques of the fit's loads subtracted.
    """

    columns: GatheredColumns  # of all recordings, without columns of one alone
    dynamics: Dynamics  # of the robot that is fitted
    additions: tuple[Addition, ...] = ()  # of all recordings

    @cached_property
    def active(self) -> Int[np.ndarray, " columns"]:
        """Columns of the fit that are not always zero."""
        return np.flatnonzero(np.any(self._map != 0.0, axis=0))

    @cached_property
    def _map(self) -> Float[np.ndarray, "kept columns"]:
        return map_to(self.columns, self.dynamics, self.additions)

    @cached_property
    def _active_map(self) -> Float[np.ndarray, "kept active"]:
        return self._map[:, self.active]

    @cached_property
    def independent(self) -> Independent:
        """Independent active columns, over all drives."""
        return Independent.of_columns(self._active_map)

    @cached_property
    def drives(self) -> tuple[Independent, ...]:
        """Independent active columns in the rows of each drive."""
        return tuple(
            Independent.of_columns(self._active_map[places]) for places in self.columns.of_drives
        )

    @cached_property
    def fingerprint(self) -> str:
        """Checksum of all inputs of a recording's rows except its factors."""
        taken = {
            added.load.name: added.taken.tolist()
            for added in self.additions
            if isinstance(added, LoadColumns)
        }
        return digest(
            [
                list(self.columns.place),
                sha256(np.ascontiguousarray(self._map).tobytes()).hexdigest(),
                self.dynamics.layout.names,
                taken,
            ]
        )

    def part(self, file: FactorFile) -> MergedPart:
        whole, views = list[Rows](), list[Rows]()
        for i, (R,) in enumerate(file.whole.factors):
            view, local = self._view(file, i)
            places, lag = list(local.values()), file.record.lags[i]
            weight = file.record.noise[i] / lag.deviation if lag.deviation else 0.0
            is_lag = np.array([name == f"lag.{lag.drive}" for name in local], dtype=bool)
            prior = np.append(np.zeros(view.shape[1] - 1), weight * lag.beside)
            span = Span.of_columns(np.vstack([R[:, places], weight * is_lag]))
            A = np.vstack([R @ view, prior])
            whole.append(span.without(A))
            view[places] -= span.inverse @ (span.Q.T @ A)
            views.append(view)

        information = Information(
            self.active,
            triangle(stacked(whole)),
            file.whole.samples[0],
            file.whole.torque_max[0],
        )
        return MergedPart(file, information, tuple(views))

    def geometry(self, file: FactorFile) -> list[Rows]:
        """Effect of the description's tolerances on rows of each drive: [Y, D, τ], with D the
        torques of one standard deviation of each of the record's quantities; empty without
        tolerances."""
        rows = list[Rows]()
        for i, (R,) in enumerate(() if file.geometry is None else file.geometry.factors):
            view = self._view(file, i)[0][:-1, :-1]
            rows.append(np.column_stack([R[:, : len(view)] @ view, R[:, len(view) :]]))
        return rows

    def _view(self, file: FactorFile, drive: int) -> tuple[Rows, dict[str, int]]:
        """V with [Y, τ] = R V for a drive's factors R, and indices of the columns of this recording
        alone."""
        names = [file.record.names[k] for k in file.record.felt[drive]]
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
        """Values of the additions: known loads minus what has been subtracted already; zero for all
        others."""
        values = [
            known[added.load.name] - added.taken
            if isinstance(added, LoadColumns) and added.parameters and added.load.name in known
            else np.zeros(len(added.parameters))
            for added in self.additions
        ]
        return np.concatenate([np.zeros(0), *values])


def stacked(
    rows: Sequence[Float[np.ndarray, "*many _ augmented"]],
) -> Float[np.ndarray, "*many drives _ augmented"]:
    """Rows of all drives, padded with zero rows to triangles of one size."""
    size = rows[0].shape[-1]
    most = max(size, *(A.shape[-2] for A in rows))
    wide = np.zeros((*rows[0].shape[:-2], len(rows), most, size))
    for i, A in enumerate(rows):
        wide[..., i, : A.shape[-2], :] = A
    return wide


def merging_of(
    briefs: Sequence[RecordingBrief], robot: RobotDescription, settings: Settings
) -> Merging:
    """The map from recordings to rows of a robot's fit, with all of their loads, one for each name,
    and changes of the laws' constants."""
    dynamics, briefs = compiled(robot), ordered(briefs)
    taken = {held.load.name: held.taken for brief in reversed(briefs) for held in brief.loads}
    loads = tuple(
        LoadColumns(dynamics, load, settings.prior_spread, np.array(taken[load.name]))
        for load in joined_loads(holding(briefs))
    )
    constants = LawConstants(dynamics)
    columns = GatheredColumns.for_robot(robot, prior_parameters(plain(robot)), loads)
    return Merging(columns, dynamics, (*loads, constants) if constants.parameters else loads)


def holding(briefs: Sequence[RecordingBrief]) -> HeldLoads:
    return [(brief.log, [held.load for held in brief.loads]) for brief in briefs]


def ordered(briefs: Sequence[RecordingBrief]) -> list[RecordingBrief]:
    """Recordings sorted by checksum, so results do not depend on their order."""
    return sorted(briefs, key=lambda brief: brief.sha256)
