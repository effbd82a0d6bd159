"""One sweep of the contest of causes: bodies, friction and all effects in one linear fit.

Each effect has a prior and columns, the slopes of the torques at the present estimate. One fit
shrinks all effects (`estimation.shrinkage`). Then effects that the rows do not need beside all
others are dropped; the rest is applied exactly, and the next sweep takes new slopes.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.account import DETECTED
from deltaid.effects.at_drives import RippleColumns
from deltaid.effects.at_platform import LIKE_CABLES, AnisotropicSpring, Cable
from deltaid.effects.cable_search import largest_cable
from deltaid.effects.joint import BY_DIRECTION
from deltaid.effects.point import Added, Deviations, TracePoint, UnknownEffect
from deltaid.effects.ripple_search import (
    OrdersOfDrives,
    largest_ripples,
    nearest_order,
    ripple_of,
    searched_orders,
)
from deltaid.effects.unexplained import KINDS, Unexplained, is_unexplained
from deltaid.estimation.causes import CauseColumns, NoiseBlock
from deltaid.estimation.drive_rows import (
    POSITION_ERROR,
    ColumnsOfRecording,
    OfDrives,
    TraceRows,
    side_by_side,
    stretch_numbers,
)
from deltaid.estimation.problem import Columns
from deltaid.estimation.shrinkage import Shrunk
from deltaid.estimation.traces import Trace
from deltaid.identification.selection import CERTAIN_ODDS, reduced, rivals, suspects

# Most orders of ripples that a drive has.
_RIPPLES = 3


@dataclass(frozen=True, eq=False)
class Contest:
    """A linear fit of all effects.

    Attributes:
        rows: over the free parameters of the robot and of declared additions.
        points: recordings at the parameters of the sweep before.
        unknowns: the effects that take part.
        shrunk: the fit; its first columns are the free parameters.
    """

    rows: TraceRows
    points: tuple[TracePoint, ...]
    unknowns: tuple[UnknownEffect, ...]
    shrunk: Shrunk

    @property
    def p(self) -> Parameters:
        """Parameters of the robot alone."""
        return self.rows.parameters(self.shrunk.x)[: len(self.rows.dynamics.layout.names)]

    @property
    def estimate(self) -> Float[np.ndarray, " estimates"]:
        """p, and the constants of the drives' friction behind it."""
        return np.append(self.p, self.shrunk.x[self._constants])

    @property
    def _constants(self) -> Int[np.ndarray, " drives"]:
        """Columns of a constant for each moving drive, as they are in the friction by direction."""
        columns = [g.columns for g in self.shrunk.groups if g.name == BY_DIRECTION]
        return np.concatenate([np.zeros(0, dtype=int), *columns])[::2]

    def named(self, change: Float[np.ndarray, " estimates"]) -> dict[str, float]:
        """A change of the estimate, by name; constants as those of offsets."""
        layout = self.rows.dynamics.layout
        moves = layout.named(change[: len(layout.names)])
        constants = change[len(layout.names) :].tolist()
        for joint, constant in zip(self.points[0].driven, constants, strict=False):
            offset = f"offset.{joint.name}"
            moves[offset] = moves.get(offset, 0.0) + constant
        return moves

    def group(self, name: str) -> CauseColumns:
        return next(group for group in self.shrunk.groups if group.name == name)

    def unknown(self, name: str) -> UnknownEffect:
        return next(unknown for unknown in self.unknowns if unknown.name == name)

    @property
    def noise(self) -> float:
        """Logarithm of the noise level, as a mean over the rows of all drives."""
        rows = [block.count for block in self.shrunk.blocks]
        return float(np.average(np.log(self.shrunk.sigma), weights=rows))

    def with_cable(self, kept: Collection[str]) -> "Contest":
        """With the cable that explains most beside the effects `kept` by the sweep before, if a
        spring at the platform may be stiffer in some directions, as any cable is."""
        springs = [group for group in self.shrunk.groups if group.name == AnisotropicSpring.name]
        may_act = any(self.shrunk.surprise(spring) > DETECTED for spring in springs)
        if not (may_act or Cable.name in kept):
            return self
        others = [name for name in kept if name not in {Cable.name, *LIKE_CABLES}]
        cable = largest_cable(self.points, self.shrunk.of_candidates(others))
        return self._with([cable]) if cable else self

    def with_ripples(self) -> "Contest":
        """With ripples: the largest of each drive is added until none exceeds chance; all orders
        are refined each time."""
        contest, ripples = self, list[Added]()
        searched = searched_orders(self.points)
        while len(ripples) < _RIPPLES * self.points[0].dof:
            largest = largest_ripples(self.points, contest.shrunk, DETECTED, searched)
            if not largest:
                break
            ripples += [ripple_of(self.points[0], drive, order) for drive, order in largest]
            rough = self._with(ripples)
            ripples = [rough._nearer(ripple, searched) for ripple in ripples]
            contest = self._with(ripples)
        return contest

    def _nearer(self, ripple: Added, searched: OrdersOfDrives) -> Added:
        """A ripple with the order that explains most beside all others."""
        addition, bare = ripple.addition, self.shrunk.without([ripple.name])
        assert isinstance(addition, RippleColumns)
        (drive,), (order,) = addition.drives, addition.orders
        order = nearest_order(self.points, bare, drive, order, searched[drive])
        return ripple_of(self.points[0], drive, order)

    def beside_dropped(
        self, unknowns: Sequence[UnknownEffect], applied: dict[str, Float[np.ndarray, " _"]]
    ) -> "Contest":
        """The same sweep with all of these effects, some of which earlier sweeps dropped."""
        names = {unknown.name for unknown in unknowns}
        if names <= {unknown.name for unknown in self.unknowns}:
            return self
        whole = contest(self.rows, self.points, unknowns, applied)
        return whole._with([unknown for unknown in self.unknowns if unknown.name not in names])

    def _with(self, unknowns: Sequence[UnknownEffect]) -> "Contest":
        candidates = list[tuple[str, list[Columns], Deviations]]()
        for unknown in unknowns:
            own = [unknown.columns(point) for point in self.points]
            columns = [drive for recording in own for drive in recording]
            candidates.append((unknown.name, columns, _usual(unknown, self.points, own)))
        shrunk = self.shrunk.with_groups(candidates)
        return replace(self, unknowns=(*self.unknowns, *unknowns), shrunk=shrunk)

    def needs(self, unknowns: Sequence[UnknownEffect]) -> bool:
        """Whether the rows need one of these effects beside all others."""
        kept = self._with(unknowns).reduced().shrunk.candidates
        return any(unknown.name in kept for unknown in unknowns)

    def unexplained(self) -> tuple[Unexplained, ...]:
        """Free functions of the drives' torques, if the rows need any beside all effects."""
        free = tuple(Unexplained(self.points, kind) for kind in KINDS)
        return free if self.needs(free) else ()

    def prefers(self, first: "Contest", other: "Contest") -> bool:
        """Whether the rows are more probable with the effects of one reduced contest than with
        those of another."""
        ends, missing = (first, other), dict[str, UnknownEffect]()
        for end in ends:
            new = (name for name in end.shrunk.candidates if name not in self.shrunk.candidates)
            missing |= {name: end.unknown(name) for name in new}
        fit = self._with(list(missing.values())).shrunk
        evidence, of_other = (fit.of_candidates(end.shrunk.candidates).evidence for end in ends)
        return bool(evidence > of_other)

    def unexplained_torques(self) -> OfDrives | None:
        """Torques of the drives in the first recording that only free functions explain; None
        without free functions."""
        others = [name for name in self.shrunk.candidates if not is_unexplained(name)]
        if len(others) == len(self.shrunk.candidates):
            return None
        without = self.shrunk.of_candidates(others)
        blocks = zip(without.blocks, self.shrunk.blocks, strict=True)
        torques = [without.residual(a) - self.shrunk.residual(b) for a, b in blocks]
        return np.stack(torques[: self.points[0].dof])

    def reduced(self) -> "Contest":
        """Without the effects that the rows do not need."""
        return replace(self, shrunk=reduced(self.shrunk, DETECTED))

    def keeping(self, names: Collection[str]) -> "Contest":
        """With only these candidates."""
        return replace(self, shrunk=self.shrunk.of_candidates(names))

    def rivals(self, last: "Contest") -> dict[tuple[str, str], "Contest"]:
        """Contests that the rows do not separate from the reduced one `last`, by the kept effect
        and the rival that replaces it."""
        return {
            pair: replace(self, shrunk=shrunk)
            for pair, shrunk in rivals(self.shrunk, last.shrunk, DETECTED).items()
        }

    def suspects(self, last: "Contest") -> dict[str, "Contest"]:
        """Contests with one more effect than the reduced one `last`, by this effect."""
        return {
            name: replace(self, shrunk=shrunk)
            for name, shrunk in suspects(self.shrunk, last.shrunk).items()
        }

    def odds(self, other: "Contest") -> float:
        """Logarithm of the odds of the rows against those with the effects of another."""
        return self.shrunk.evidence - other.shrunk.evidence

    def is_certain(self, name: str, without: "Contest") -> bool:
        """Whether an effect is certain by evidence and by scatter, and larger than errors of
        positions."""
        group = self.group(name)
        by_chance = self.shrunk.surprise(group) * np.log(10.0)
        is_large = self.shrunk.size(group) > POSITION_ERROR
        return bool(is_large and min(self.odds(without), by_chance) > CERTAIN_ODDS)

    def errors(self, names: Sequence[str], draws: int) -> list[dict[str, Deviations]]:
        """Random errors of the coefficients of some effects, by their covariance."""
        groups, rng = [self.group(name) for name in names], np.random.default_rng(0)
        if not groups:
            return []
        moves = self.shrunk.follows(groups)
        errors = moves @ rng.standard_normal((moves.shape[1], draws))
        return [{group.name: error[group.columns] for group in groups} for error in errors.T]

    def follows(self, names: Collection[str]) -> list[Float[np.ndarray, " estimates"]]:
        """Changes of the estimate by one standard deviation of each independent error of some
        effects."""
        groups = [group for group in self.shrunk.groups if group.name in names]
        count, constants = len(self.rows.dynamics.layout.names), self._constants
        moves = self.shrunk.follows(groups).T
        own = [(self.rows.reduction.A @ move[: self.rows.size])[:count] for move in moves]
        return [np.append(p, move[constants]) for p, move in zip(own, moves, strict=True)]


def start(rows: TraceRows, traces: Sequence[Trace]) -> Parameters:
    """Parameters of the robot before any effect is known."""
    return rows.robot_parameters([rows.of_trace(trace) for trace in traces])


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def contest(
    rows: TraceRows,
    points: Sequence[TracePoint],
    unknowns: Sequence[UnknownEffect],
    applied: dict[str, Float[np.ndarray, " coefficients"]],
) -> Contest:
    """One sweep. An effect whose stated tolerance is wider than usual is not dropped.

    Args:
        points: recordings at the parameters about which effects are linearised.
        applied: coefficients by which recordings and robot have been corrected.
    """
    parts = [rows.of_trace(point.trace) for point in points]
    groups, first = list[CauseColumns](), rows.size
    for unknown in unknowns:
        own = [unknown.columns(point) for point in points]
        width = own[0].shape[2]
        if not width:
            continue
        usual = _usual(unknown, points, own)
        deviation = np.maximum(usual, unknown.stated(rows.dynamics.robot))
        may_be_dropped = bool(np.all(deviation == usual))
        if unknown.is_own:
            deviation, width = np.tile(deviation, len(own)), width * len(own)
            own = side_by_side(own)
        mean = -applied.get(unknown.name, np.zeros(width))
        parts = [part.with_columns(columns) for part, columns in zip(parts, own, strict=True)]
        places = np.arange(first, first + width)
        groups.append(
            CauseColumns(
                unknown.name,
                places,
                deviation,
                mean,
                unknown.is_candidate,
                unknown.is_positive,
                may_be_dropped,
                unknown.is_possible,
            )
        )
        first += width
    blocks = [
        NoiseBlock(part.A[i], part.tau[i], stretch_numbers(part.tau.shape[1]),
                   float(point.largest[i]), point.trace.low_pass.independent, float(counted))
        for part, point in zip(parts, points, strict=True)
        for i, counted in enumerate(point.trace.counted)
    ]  # fmt: skip
    shrunk = Shrunk.fitted(blocks, *rows.prior(first), groups)
    return Contest(rows, tuple(points), tuple(unknowns), shrunk)


def _usual(
    unknown: UnknownEffect, points: Sequence[TracePoint], own: Sequence[ColumnsOfRecording]
) -> Deviations:
    """Prior deviations by the first recording in which a coefficient's column is not zero, as that
    of a resting drive is; 1 where it is zero in all."""
    usual = np.ones(own[0].shape[2])
    for point, columns in zip(points[::-1], own[::-1], strict=True):
        is_shown = np.any(columns != 0, axis=(0, 1))
        if is_shown.any():
            usual = np.where(is_shown, unknown.deviations(point, columns), usual)
    return usual
