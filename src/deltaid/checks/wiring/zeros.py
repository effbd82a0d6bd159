"""Verdicts on drives' zeros and the direction of gravity.

Both have columns, ∂(Y p)/∂q_0 and ∂(Y p)/∂g, in addition to those of Y. Their values are a
Gauss–Newton step; its covariance follows from the scatter of scores between blocks of time, for
noise of any colour.

They must explain the least-squares residual of a recording. Before a fit, rows are as recorded and
friction as described: clipped torques, a lag or another friction law can mimic a wrong zero, and a
wrong zero mimics one-way friction or a torque constant, which a fit then corrects. So after the fit
they are tested again on masked torques, with the fit's corrections and without.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, stdtrit

from deltaid.checks.evidence import Evidence
from deltaid.checks.wiring.candidate import WiringHypothesis
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.residual import FilteredMotion, residual
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.geometry import across, torque_slopes
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.problem import LinearProblem, Span
from deltaid.estimation.scatter import CHANCE
from deltaid.levels import FEW_ROUNDS, NEGLIGIBLE
from deltaid.model.verdict import Grade, Proposal, Verdict, listed, plus_minus
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.robot.tolerances import BY_EYE

# Number of blocks of time whose scatter gives uncertainties.
BLOCKS = 24
# Standard deviations from zero below which a cause is not needed.
_NEEDED = float(stdtrit(BLOCKS - 1, 1 - CHANCE / 2))
# Least share of the residual that zeros or gravity must explain.
_LITTLE = 0.005
# Largest error of a zero that slopes determine [rad or m].
_FARTHEST = 0.5


@dataclass(frozen=True, eq=False)
class Shifts:
    """Errors of zeros [rad or m] and of the direction of gravity [rad], from rows.

    Columns: the drives' zeros, two angles of gravity (none without gravity), then each drive's
    torque offset and gain.
    """

    H: Float[np.ndarray, "columns columns"]  # products of columns, parameters projected out
    scores: Float[np.ndarray, "blocks columns"]
    squares: float  # sum of squares without the columns, parameters projected out
    rows: int  # of that sum
    drives: int
    angles: int  # of gravity, 2 or 0

    @classmethod
    def from_rows(
        cls,
        span: Span,
        D: Float[np.ndarray, "rows columns"],
        tau: Float[np.ndarray, " rows"],
        drives: int,
        angles: int,
    ) -> "Shifts":
        """Shifts from stacked columns and torques of drives and the span of the parameters."""
        D, e = span.without(D), span.without(tau)
        count = len(e) // drives
        edges = np.linspace(0, count, BLOCKS + 1).astype(int)
        products = (D * e[:, None]).reshape(drives, count, -1).sum(axis=0)
        scores = np.stack([products[a:b].sum(axis=0) for a, b in pairwise(edges)])
        return cls(D.T @ D, scores, float(e @ e), len(e), drives, angles)

    @cached_property
    def tilt(self) -> list[int]:
        """Observable columns of the direction of gravity; a planar robot has one."""
        angles = range(self.drives, self.drives + self.angles)
        largest = max((self.H[i, i] for i in angles), default=0.0)
        return [i for i in angles if self.H[i, i] > NEGLIGIBLE * largest]

    @property
    def offsets(self) -> list[int]:
        first = self.drives + self.angles
        return list(range(first, first + self.drives))

    @property
    def gains(self) -> list[int]:
        """Columns of gains; all together sum to the torques, so one must be excluded then."""
        return list(range(2 * self.drives + self.angles, len(self.H))) if self.drives > 1 else []

    @cached_property
    def zeros(self) -> list[int]:
        """Drives whose zero error is small enough for slopes and well determined: the value of a
        weak column, such as a telescope's, is arbitrary."""

        def is_determined(drive: int) -> bool:
            (value,), ((variance,),) = self.estimate([drive])
            small = abs(value) < _FARTHEST and variance < BY_EYE**2
            return bool(small and self.certainty([drive]) > 0)

        return list(filter(is_determined, range(self.drives)))

    @cached_property
    def causes(self) -> list[list[int]]:
        """The zero that explains most, and a tilt, if observable."""
        likeliest = sorted(self.zeros, key=lambda i: -self.gain([i]))[:1]
        return [cause for cause in (likeliest, self.tilt) if cause]

    @property
    def is_significant(self) -> bool:
        """Whether the likeliest zero, or a tilt, is significant and explains enough."""
        certainty = max((self.certainty(cause) for cause in self.causes), default=0.0)
        clear = float(stdtrit(len(self.scores) - 1, 1 - 0.5 * CHANCE / (self.drives + self.angles)))
        return certainty >= clear and max(map(self.gain, self.causes)) >= _LITTLE

    @property
    def tilted(self) -> tuple[float, float]:
        """Angle between gravity and its direction as described, and half its interval [rad]."""
        if not self.tilt:
            return 0.0, 0.0
        turn, covariance = self.estimate(self.tilt)
        angle = float(np.linalg.norm(turn))
        direction = turn / max(angle, 1e-12)
        return angle, 2 * float(np.sqrt(direction @ covariance @ direction))

    def estimate(
        self, chosen: list[int], others: Sequence[int] = ()
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
        """Values of some columns and their covariance, with others fitted as well."""
        columns = [*chosen, *others]
        H, n = self.H[np.ix_(columns, columns)], len(chosen)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        scales = np.outer(scale, scale)
        inverse = np.linalg.pinv(H * scales, rcond=NEGLIGIBLE) * scales
        s = self.scores[:, columns]
        centred, blocks = s - s.mean(axis=0), len(s)
        spread = centred.T @ centred * blocks / max(blocks - len(columns), 1)
        return (inverse @ s.sum(axis=0))[:n], (inverse @ spread @ inverse)[:n, :n]

    def certainty(self, chosen: list[int], others: Sequence[int] = ()) -> float:
        """Wald's distance of some columns from zero in standard deviations; 0 if unobservable."""
        if not all(self.H[i, i] > 0 for i in chosen):
            return 0.0
        value, covariance = self.estimate(chosen, others)
        values, vectors = np.linalg.eigh(covariance)
        determined = values > NEGLIGIBLE * values[-1]
        projected = vectors[:, determined].T @ value
        return float(np.sqrt(np.sum(projected**2 / values[determined]) / max(len(chosen), 1)))

    def gain(self, chosen: list[int]) -> float:
        """Share of the residual that these columns explain."""
        H, s = self.H[np.ix_(chosen, chosen)], self.scores[:, chosen].sum(axis=0)
        return float(s @ np.linalg.pinv(H, rcond=NEGLIGIBLE, hermitian=True) @ s / self.squares)


def shifts(dynamics: Dynamics, motion: FilteredMotion, best: WiringHypothesis) -> Shifts:
    """Errors of zeros and gravity in a recording under one hypothesis."""
    residual, dof, tau, g = best.residual, dynamics.dof, best.torques, dynamics.robot.gravity
    # All parameters: the prior, corrected by the torques.
    p = prior_parameters(dynamics.robot)
    noise = np.linalg.norm(residual.span.without(tau)) / np.sqrt(len(tau))
    Y, rest = residual.Y / noise, (tau - residual.Y @ residual.prior) / noise
    known = np.diag(1.0 / (PRIOR_SPREAD * residual.scale)), np.zeros(Y.shape[1])
    p[residual.columns] += LinearProblem(Y, rest, residual.rows.groups).with_known(*known).x
    # Slopes at the kept samples are smooth enough to need no filter.
    kept, low_pass = np.flatnonzero(residual.keep), motion.low_pass
    places = low_pass.half + low_pass.decimation * kept
    qd, qdd = (best.map.rates(rate[places]) for rate in (motion.qd, motion.qdd))
    slopes, axes = torque_slopes(dynamics, residual.z[places], qd, qdd, p), across(np.array(g))
    D = np.stack([*map(slopes.of_zero, range(dof)), *map(slopes.of_gravity, axes)], axis=2)
    offsets = residual.rows.per_drive(np.ones((dof, len(kept))))
    columns = np.hstack([residual.rows.stack(D), offsets, best.columns * best.gains])
    return Shifts.from_rows(residual.span, columns, tau, dof, len(axes))


def zero_verdicts(log: RemappedRecording) -> Iterator[Verdict]:
    best, motion = log.best, log.motion
    shift = shifts(log.evidence.dynamics, motion, best)
    doubted = bool(shift.zeros) and shift.is_significant
    if not doubted or _better_explained(shift, np.flatnonzero(best.loose).tolist()):
        if not best.closes:
            yield _open(best)
        elif shift.zeros and not doubted:
            yield _good(shift)
        return
    drive = max(shift.zeros, key=lambda i: shift.gain([i]))
    of_zero = shift.certainty([drive], shift.tilt)
    of_tilt = shift.certainty(shift.tilt, [drive]) if shift.tilt else 0.0
    # Zeros of several drives mimic any tilt, so the simpler cause is reported if both are needed.
    either, zero = (of_tilt < _NEEDED) == (of_zero < _NEEDED), of_zero >= _NEEDED
    if either and shift.tilt:
        zero = shift.gain([drive]) > shift.gain(shift.tilt)
    others = (i for i in shift.zeros if i != drive)
    rivals = [drive, *(i for i in others if shift.certainty([drive], [i]) < _NEEDED)]
    error = _zero(log.evidence, motion, best, shift, drive)
    grade = Grade.DOUBTFUL if best.closes else Grade.WRONG
    yield _verdict(log.evidence, shift, rivals, error, grade=grade, zero=zero, either=either)


def _better_explained(shift: Shifts, loose: list[int]) -> bool:
    """Whether torque gains or offsets explain the residual instead of zeros and gravity: those of
    all drives if they explain what these cannot, that of one drive, which is as simple, if it
    explains more. A loose drive's gain and offset absorb errors of its prior."""
    for instead in filter(None, (shift.offsets, shift.gains[1:])):
        if all(
            shift.certainty(cause, instead) < _NEEDED <= shift.certainty(instead, cause)
            for cause in shift.causes
        ):
            return True
    needed = max(map(shift.gain, shift.causes)) + chdtri(1.0, CHANCE) / shift.rows
    return any(
        shift.gain([column]) > needed
        for columns in (shift.offsets, shift.gains)
        for i, column in enumerate(columns)
        if i not in loose
    )


def _zero(
    evidence: Evidence, motion: FilteredMotion, best: WiringHypothesis, shift: Shifts, drive: int
) -> tuple[float, float]:
    """Error of one drive's zero and half its interval, by Gauss–Newton steps."""
    map, share = best.map, best.residual.share
    for _ in range(FEW_ROUNDS):
        (step,), ((variance,),) = shift.estimate([drive])
        zeros = list(map.shift)
        zeros[drive] += float(np.clip(step, -_FARTHEST, _FARTHEST))
        moved = residual(evidence.dynamics, motion, replace(map, shift=tuple(zeros)))
        if moved is None or moved.share < share:
            break
        map = moved.map
        shift = shifts(evidence.dynamics, motion, replace(best, residual=moved))
        if abs(step) < np.sqrt(variance):
            break
    return map.shift[drive], 2 * float(np.sqrt(shift.estimate([drive])[1][0, 0]))


def _verdict(
    evidence: Evidence,
    shift: Shifts,
    rivals: list[int],
    error: tuple[float, float],
    *,
    grade: Grade,
    zero: bool,
    either: bool,
) -> Verdict:
    """`zero`: a zero explains the torques rather than a tilt; `either`: both do."""
    names = [evidence.robot.drives[i] for i in rivals]
    unit = "mm" if evidence.robot.is_linear(names[0]) else "mrad"
    off, half = (1e3 * value for value in error)
    of_zero = f"a zero of {names[0]} that is {plus_minus(abs(off), half)} {unit} off"
    if others := names[1:]:
        of_zero += f" (or one of {listed(others)}: the motion does not separate these)"
    angle, by = shift.tilted
    of_tilt = f"a base out of level by {plus_minus(1e3 * angle, 1e3 * by)} mrad"
    if zero:
        share, number, text, rival = shift.gain([rivals[0]]), off, of_zero, of_tilt
        cause, cure = f"homing: {of_zero}", "home the drive anew, or declare its zero"
        shifted = {rivals[0]: evidence.shifted(rivals[0], error[0])}
        proposals = evidence.proposal({"position": shifted})
    else:
        share, number, text, rival = shift.gain(shift.tilt), 1e3 * angle, of_tilt, of_zero
        unit = "mrad"
        cause, cure = _tilt_cause(angle, of_tilt)
        proposals = _gravity(evidence, shift, is_written=angle <= BY_EYE) if shift.tilt else ()
    if either:
        cause = f"one of both, the motion does not show which: {text}, or {rival}"
        cure = "home the drives anew and check the level of the base; then correct what was wrong"
    return Verdict(
        "homing-or-tilt",
        grade,
        f"torques repeat with the pose what {text} would do, which explains {100 * share:.0f} % of "
        "the residual",
        ", ".join(names) if zero else "",
        cause,
        cure,
        proposals,
        number,
        unit,
    )


def _tilt_cause(angle: float, of_tilt: str) -> tuple[str, str]:
    """Cause and cure."""
    if angle <= BY_EYE:  # else its proposal is not written without inspection
        return f"a tilted base: {of_tilt}", "level the base, or describe gravity as it is"
    return (
        f"a tilted base: {of_tilt}, or a force that pulls at the platform, as of a hose or a "
        "spring",
        "look at the mounting and at what pulls at the platform; measure the base's angle with a "
        "level, and describe gravity by it",
    )


def _gravity(evidence: Evidence, shift: Shifts, *, is_written: bool) -> tuple[Proposal, ...]:
    g = np.array(evidence.robot.gravity)
    turn, _ = shift.estimate(shift.tilt)
    gravity = g + np.cross(turn @ across(g)[[i - shift.drives for i in shift.tilt]], g)
    gravity *= np.linalg.norm(g) / np.linalg.norm(gravity)
    return (Proposal("robot", (("gravity", [float(f"{x:.5g}") for x in gravity]),), is_written),)


def _good(shift: Shifts) -> Verdict:
    angle, by = shift.tilted
    seen = "zeros and gravity go with the torques"
    if not 0 < by < _FARTHEST:
        return Verdict("homing-or-tilt", Grade.GOOD, seen)
    seen += f": a tilt of {plus_minus(1e3 * angle, 1e3 * by, 2)} mrad"
    return Verdict("homing-or-tilt", Grade.GOOD, seen, number=1e3 * angle, unit="mrad")


def _open(best: WiringHypothesis) -> Verdict:
    share = best.residual.share
    return Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        f"the loops close at {100 * share:.0f} % of the samples only, and no unit, gear, sign or "
        "order of the drives makes them close at all",
        cause="a zero far off, or lengths of the description that are not the robot's",
        cure="check the drives' zeros and the robot's lengths",
        number=share,
    )
