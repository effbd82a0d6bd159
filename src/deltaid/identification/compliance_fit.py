"""Compliances of gears by Gauss and Newton, beside parameters and all that might look like them.

What a motor turns ahead of its link, s τ_g, changes what a model predicts by

    Δτ = ∂(Y p)/∂s · s,

to first order one more column of the regression for each s: torques of a motion turned back by a
little less those of the motion, by the little. How far it is turned back follows from measured
torques, the column from the model's: noise of the torques would stand on both sides and be taken
for a compliance. That noise is in the links' motion as well, times M s ω², more than the torques'
own above the frequency at which gear and inertia resonate; so rows are filtered down to the band of
the motion, half of that which a fit sees.

Beside them stand the lag of every drive, and its friction as a free curve over its speed and what
it carries: a law that the description lacks would be taken for a compliance, and is none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.drive_rows import stretch_starts
from deltaid.estimation.trace_rows import RecordingRows
from deltaid.estimation.traces import Trace
from deltaid.identification.compliance_found import Found, Groups
from deltaid.identification.compliance_rows import Columns, Rows, late
from deltaid.identification.lag_groups import agree
from deltaid.identification.setup import Setup
from deltaid.identification.windings import Compliance, Windings, motors_of, wound
from deltaid.recording.gears import Gears

# Sweeps at most, and steps that are small enough, in standard deviations. A compliance counts that
# is so many of them, and that makes the rows of most stretches of time better by so many: for one
# that is there, these are half as many.
_SWEEPS, _SETTLED, _SIGNIFICANT, _BETTER = 8, 0.3, 5.0, 2.5
# One that is not so many of them after a first step, with rows by so many better, is not gone on
# with.
_HOPEFUL, _HOPEFULLY_BETTER = 2.0, 0.5 * _BETTER
# How far gears wind up at most, as a share of a drive's range, to begin with.
_SHARES = 2e-3 * 2.0 ** np.arange(6)
# The same for any gear: beyond that the linearised winding means nothing.
_SOFTEST = 4.0 * _SHARES[-1]
# A gear that winds up by so many radians or metres at a drive's largest torque, for differences.
_LITTLE = 1e-4


@threadpool_limits.wrap(limits=1, user_api="blas")
def compliances(
    traces: Sequence[Trace], wide: Sequence[Trace], setup: Setup, stated: Compliance
) -> Found:
    """Those of gears that show that they wind up, and those that are stated.

    Noise of the torques is in the links' motion with the opposite sign: rows lose it where M s ω²
    is about one, whatever the gear. Of few rows that is all that is found; in the whole band of a
    fit, where M s ω² is more, such gears make all rows worse.

    Args:
        traces: of recordings of the same machine, in the band of the motion.
        wide: the same in the whole band of a fit.
        setup: the fit that they are meant for.
        stated: s where it is known, NaN where it is to be found.
    """
    fit = _Fit(tuple(traces), setup, np.nan_to_num(stated))
    left, p = fit.at(fit.known)
    free = np.isnan(stated) & fit.loaded(p)
    if not free.any():
        return fit.nothing(p)
    start, p = fit.start(free, left, p)
    S = np.eye(len(stated))[:, free]
    if np.array_equal(start, fit.known) and not _hopeful(fit, S, p):
        return fit.nothing(p)
    found = _searched(fit, S, start, p)
    if found is None or not fit.better(found):
        return fit.nothing(fit.at(fit.known)[1])
    whole = replace(fit, traces=tuple(wide))
    return found if whole.nearer(found) else fit.nothing(fit.at(fit.known)[1])


def _searched(fit: "_Fit", S: Groups, start: Compliance, p: Parameters) -> Found | None:
    """What shows from a start on; None if nothing does."""
    found = _pooled(fit, fit.swept(S, start, p))
    while not (seen := _shown(found)).all():
        if not seen.any():
            return None
        S = found.groups[:, seen]
        found = fit.swept(S, S @ found.sizes[seen], found.p)
    return found


def _shown(found: Found) -> Bool[np.ndarray, " groups"]:
    """Which sizes are none by chance."""
    return found.sizes > _SIGNIFICANT * found.deviation


def _hopeful(fit: "_Fit", S: Groups, p: Parameters) -> bool:
    """Whether one step away from stiff gears, those of identical limbs alike, may come to count."""
    limbs = fit.setup.robot.limbs
    if limbs is not None and limbs.identical:
        alike = S[: limbs.count].any(axis=0)
        S = np.column_stack([S[:, alike].sum(axis=1), S[:, ~alike]])
        S = S[:, S.any(axis=0)]
    found = fit.swept(S, fit.known, p, 1)
    likely = bool(np.any(found.sizes > _HOPEFUL * found.deviation))
    return likely and fit.better(found, _HOPEFULLY_BETTER)


def _pooled(fit: "_Fit", found: Found) -> Found:
    """One size for the drives of identical limbs, unless each shows by itself that it has its own:
    a fault of one drive's torques may look like a compliance that the others lack."""
    limbs, S = fit.setup.robot.limbs, found.groups
    if limbs is None or not limbs.identical:
        return found
    alike = S[: limbs.count].any(axis=0)
    sizes, covariance = found.sizes[alike], found.covariance[np.ix_(alike, alike)]
    shown = bool(np.all(_shown(found)[alike]))
    if alike.sum() < 2 or (shown and not agree(sizes, covariance)):
        return found
    weights = np.linalg.solve(covariance, np.ones(len(sizes)))
    common = float(max(weights @ sizes / weights.sum(), 0.0))
    together = np.column_stack([S[:, alike].sum(axis=1), S[:, ~alike]])
    return fit.swept(together, together @ np.append(common, found.sizes[~alike]), found.p)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares over traces, with gears that wind up by what is known and what is not.

    Attributes:
        traces: of motors.
        setup: the fit that they are meant for.
        known: s of gears whose is stated, else 0.
    """

    traces: tuple[Trace, ...]
    setup: Setup
    known: Compliance

    @cached_property
    def rows(self) -> Rows:
        """What rows are made for."""
        return Rows.of(self.setup)

    def windings(self, p: Parameters) -> list[Windings]:
        """What gears carry in each trace, with the motors of p."""
        motors = (self._motors(one, p) for one in self.traces)
        return [wound(one, each) for one, each in zip(self.traces, motors, strict=True)]

    def loaded(self, p: Parameters) -> Bool[np.ndarray, " dof"]:
        """Which gears carry enough."""
        return np.all([one.loaded for one in self.windings(p)], axis=0)

    def nothing(self, p: Parameters) -> Found:
        """What is known alone."""
        empty, none = np.zeros((len(self.known), 0)), np.zeros(0)
        return Found(self.known, empty, none, np.zeros((0, 0)), none, p)

    def at(self, s: Compliance, p: Parameters | None = None) -> tuple[list[np.ndarray], Parameters]:
        """What is left of each trace's rows with compliances, and p beside lags and friction.

        Args:
            p: by which it is known what motors take; of stiff gears if not given.
        """
        if p is None:
            _, p = self.rows.fitted(self.traces)
        turned = [one.turned(s) for one in self.windings(p)]
        return self.rows.fitted(turned)

    def start(
        self, free: Bool[np.ndarray, " dof"], left: list[np.ndarray], p: Parameters
    ) -> tuple[Compliance, Parameters]:
        """Compliances to begin with: gears that wind up alike, as a share of their drives' range,
        for rows have several minima over it.

        Args:
            left: of gears as they are known.
        """
        best, value = self.known, _size(left)
        softer = np.where(free, self._softer, 0.0)
        for share in _SHARES:
            s = self.known + share * softer
            left, own = self.at(s, p)
            if _size(left) >= value:
                break
            best, value, p = s, _size(left), own
        return best, p

    def swept(self, S: Groups, start: Compliance, p: Parameters, most: int = _SWEEPS) -> Found:
        """s = known + S ε with the best ε, from a start on, in so many sweeps at most."""
        free = S.any(axis=1)
        sizes = np.linalg.lstsq(S, np.where(free, start - self.known, 0.0), rcond=None)[0]
        covariance = np.zeros((0, 0))
        little, count = _LITTLE / (S.T @ self._largest), S.shape[1]
        softest = _SOFTEST * np.min(np.where(S > 0, self._softer[:, None], np.inf), axis=0)
        for _ in range(most):
            s, windings = self.known + S @ sizes, self.windings(p)
            parts = [
                replace(
                    self._of_links(one, s, S * little, p),
                    instruments=self._clean(one, s, S * little, p),
                )
                for one in windings
            ]
            problem, first = self.rows.rows.problem(parts), self.rows.rows.size
            moved = np.clip(sizes + problem.x[first : first + count], 0.0, softest) - sizes
            sizes, p = sizes + moved, self.rows.parameters(parts)
            covariance = problem.covariance(slice(first, first + count + len(s)))
            if np.all(np.abs(moved) < _SETTLED * np.sqrt(np.diag(covariance)[:count])):
                break
        return Found(
            self.known + S @ sizes, S, sizes, covariance[:count, :count],
            _like_lag(covariance, S), p,
        )  # fmt: skip

    def _of_links(
        self, one: Windings, s: Compliance, steps: Groups, p: Parameters
    ) -> RecordingRows:
        """Rows of the links' motion by measured torques, beside slopes over each size."""
        low_pass = one.motors.low_pass(one.trace.low_pass.rate)

        def at(s: Compliance) -> Trace:  # without the ends that clean ones lose
            return one.inner(low_pass).inner(low_pass).turned(s)

        now = at(s)
        more = [at(s + step) for step in steps.T]
        return self.rows.of_trace(now, p, _slopes_over(now, more, steps, p), late(now, p))

    def _clean(
        self, one: Windings, s: Compliance, steps: Groups, p: Parameters
    ) -> tuple[Columns, ...]:
        """The same columns by torques of the model, without the noise that measured ones bring into
        the links' motion: along that of the motors, and along this turned back by the model's
        torques, which is that of the links below the frequency at which gear and inertia resonate.
        """
        low_pass = one.motors.low_pass(one.trace.low_pass.rate)
        motor = one.by_model(p)
        link = replace(motor, trace=motor.turned(s)).by_model(p)
        motor = motor.inner(low_pass)
        return tuple(
            self.rows.of_trace(
                along.trace,
                p,
                _slopes_over(along.trace, [along.turned(step) for step in steps.T], steps, p),
                late(along.trace, p),
            ).A
            for along in (motor, link)
        )

    def better(self, found: Found, least: float = _BETTER) -> bool:
        """Whether rows of most stretches of time are nearer with what was found than without, by
        at least so many standard deviations."""
        gains = list[np.ndarray]()
        with_it, without = (self.at(s, found.p)[0] for s in (found.values, self.known))
        for ours, theirs in zip(with_it, without, strict=True):
            noise = np.mean(ours**2, axis=1, keepdims=True)
            gain = np.sum((theirs**2 - ours**2) / noise, axis=0)
            gains.append(np.add.reduceat(gain, stretch_starts(len(gain))))
        each = np.concatenate(gains)
        return bool(each.mean() > least * each.std(ddof=1) / np.sqrt(len(each)))

    def nearer(self, found: Found) -> bool:
        """Whether less is left of rows with what was found than without."""
        with_it, without = (self.at(s, found.p)[0] for s in (found.values, self.known))
        return _size(with_it) < _size(without)

    def _motors(self, one: Trace, p: Parameters) -> Gears:
        return motors_of(self.setup.robot, p, one.low_pass.cutoff, one.low_pass.rate)

    @property
    def _largest(self) -> Float[np.ndarray, " dof"]:
        return np.max([one.recording.log.torque_max for one in self.traces], axis=0)

    @property
    def _softer(self) -> Compliance:
        """That of gears that wind up by a drive's whole range at its largest torque."""
        return self._range / self._largest

    @property
    def _range(self) -> Float[np.ndarray, " dof"]:
        inverse = self.setup.dynamics.kinematics.inverse
        parts = [inverse(w.z) for one in self.traces for w in one.stretches]
        return np.max([np.ptp(q, axis=0) for q in parts], axis=0)


def _size(left: Sequence[np.ndarray]) -> float:
    """Logarithm of what is left, all drives counting alike."""
    together = np.concatenate(left, axis=1)
    return float(np.sum(np.log(np.maximum(together.std(axis=1), np.finfo(float).tiny))))


def _like_lag(
    covariance: Float[np.ndarray, "beside beside"], S: Groups
) -> Float[np.ndarray, " groups"]:
    """The largest correlation of each size with the lag of one of its drives."""
    dof, count = S.shape
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    correlation = np.abs(covariance / np.outer(scale, scale))
    return np.max(correlation[:count, count : count + dof] * S.T, axis=1)


def _slopes_over(now: Trace, more: Sequence[Trace], steps: Groups, p: Parameters) -> Columns:
    """How much what a model predicts less what is measured grows with each size.

    Args:
        more: traces of gears that are softer by a step.
        steps: of each size (drives, sizes).
    """
    before = now.model(p) - now.torques()
    columns = [(one.model(p) - one.torques() - before) for one in more]
    return np.stack(columns, axis=2) / steps.max(axis=0)
