"""Compliances of gears by Gauss–Newton, with parameters and all effects that could mimic them.

A motor turns ahead of its link by s τ_g, which changes the predicted torques to first order by

    Δτ = ∂(Y p)/∂s · s.

So each s is one more column of the regression, by finite differences over the links' motion. This
motion follows from measured torques τ_g, but the column from the model's: noise of torques on both
sides of the regression would look like a compliance. The same noise enters the links' motion times
M s ω² and exceeds the torques' own above the resonance of gear and inertia. So rows are filtered to
the band of the motion, half of that of a fit.

Each drive has additional columns for its lag and for friction as a free curve over speed and load:
friction that the description lacks would look like a compliance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import late
from deltaid.effects.lag_groups import agree, common_lag
from deltaid.effects.windings import (
    SOFTEST,
    UNITS_OF_STIFFNESS,
    USUAL,
    Compliance,
    Groups,
    Windings,
    Windup,
    fitted,
    free_friction,
    motors_of,
)
from deltaid.errors import DescriptionError
from deltaid.estimation.drive_rows import RecordingRows, TraceRows, stretch_starts
from deltaid.estimation.traces import Trace
from deltaid.levels import CERTAIN, LIKELY, NEAR, SWEEPS
from deltaid.recording.windows import SampleBlock

# Compliances must make rows of stretches of time better by so many standard deviations: for real
# ones this is half of their size in standard deviations, `CERTAIN`.
_BETTER = 0.5 * CERTAIN
# The search stops where the first step improves rows by less than this, or its size is unlikely.
_HOPEFULLY_BETTER = 0.5 * _BETTER
# Start values: windup at a drive's largest torque as a share of its range, from the usual one up.
_SHARES = USUAL * 2.0 ** np.arange(7)
# Step of finite differences: windup at a drive's largest torque [rad or m].
LITTLE = 1e-4


@threadpool_limits.wrap(limits=1, user_api="blas")
def compliances(
    traces: Sequence[Trace], wide: Sequence[Trace], rows: TraceRows, stated: Compliance
) -> Windup:
    """Estimate compliances of gears that measurably wind up; keep those that are stated.

    Noise of torques enters the links' motion with the opposite sign. Where M s ω² is about 1, any
    compliance cancels a part of it, so rows must improve by more than that. With few rows this
    cancellation may be all that is detected; in the whole band of a fit, where M s ω² is larger,
    such a compliance makes rows worse.

    Args:
        traces: recordings of the same machine, in the band of the motion.
        wide: the same recordings in the whole band of a fit.
        rows: poses the regression.
        stated: s where the description states it, NaN where it is to be estimated.
    """
    fit = _Fit(tuple(traces), rows, np.nan_to_num(stated))
    fit.require_linear()
    _, p = fitted(rows, traces)
    none = np.zeros(0)
    nothing = Windup(fit.known, np.zeros((len(stated), 0)), none, np.zeros((0, 0)), none, p)
    long = [bool(winding.inner(2).trace.stretches) for winding in fit.windings(p)]
    if not any(long):
        return nothing
    traces, wide = (tuple(compress(each, long)) for each in (traces, wide))
    fit = replace(fit, traces=traces)
    residuals, p = fit.residuals(fit.known, p)
    free = np.isnan(stated) & np.all([winding.loaded for winding in fit.windings(p)], axis=0)
    if not free.any():
        return nothing
    start, p = fit.start(free, residuals, p)
    S = np.eye(len(stated))[:, free]
    if np.array_equal(start, fit.known) and not fit.hopeful(S, p):
        return nothing
    gears = fit.pooled(fit.swept(S, start, p))
    while not (significant := gears.significant).all():
        if not significant.any():
            return nothing
        S = gears.groups[:, significant]
        gears = fit.swept(S, S @ gears.sizes[significant], gears.p)
    if not fit.better(gears):
        return nothing
    whole = replace(fit, traces=tuple(wide))
    with_it, without = (_size(whole.residuals(s, gears.p)[0]) for s in (gears.values, fit.known))
    return gears if with_it < without else nothing


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares over recordings of motors behind compliant gears; `known` is s as stated, or 0
    where nothing is stated."""

    traces: tuple[Trace, ...]
    rows: TraceRows
    known: Compliance

    def require_linear(self) -> None:
        """Refuse stated gears that the recorded torques would wind up by a large part of the
        drives' ranges."""
        robot, moves = self.rows.dynamics.robot, self._softer > 0
        share = np.zeros_like(self.known)
        share[moves] = self.known[moves] / self._softer[moves]
        i = int(np.argmax(share))
        if share[i] > SOFTEST:
            units = robot.units(robot.drives[i])
            raise DescriptionError(
                f"is {1 / self.known[i]:.3g} {units.stiffness}: recorded torques would "
                f"wind the gear of {robot.drives[i]} up by {share[i]:.2g} of its range",
                where="gear_stiffness",
                cure=UNITS_OF_STIFFNESS[robot.is_linear(robot.drives[i])],
            )

    def windings(self, p: Parameters) -> list[Windings]:
        robot, filters = self.rows.dynamics.robot, [trace.low_pass for trace in self.traces]
        motors = [motors_of(robot, p, low_pass.cutoff, low_pass.rate) for low_pass in filters]
        return [Windings.measured(*pair) for pair in zip(self.traces, motors, strict=True)]

    def residuals(
        self, s: Compliance, p: Parameters
    ) -> tuple[list[Float[np.ndarray, "dof _"]], Parameters]:
        """Residuals of each trace's rows with compliances s, and p fitted with lags and friction;
        the motors' own torques are those of the given p."""
        return fitted(self.rows, [winding.turned(s) for winding in self.windings(p)])

    def start(
        self,
        free: Bool[np.ndarray, " dof"],
        residuals: list[Float[np.ndarray, "dof _"]],
        p: Parameters,
    ) -> tuple[Compliance, Parameters]:
        """Start values, for rows have several minima over s: all free gears wind up by the same
        share of their drives' ranges. `residuals` are those of the known compliances."""
        best, value = self.known, _size(residuals)
        for share in _SHARES:
            s = self.known + share * np.where(free, self._softer, 0.0)
            residuals, p_s = self.residuals(s, p)
            if _size(residuals) >= value:
                break
            best, value, p = s, _size(residuals), p_s
        return best, p

    def hopeful(self, S: Groups, p: Parameters) -> bool:
        """Whether one sweep from stiff gears, with one size for identical limbs, promises a
        significant compliance."""
        gears = self.swept(_together(S, self._of_limbs(S)), self.known, p, 1)
        likely = bool(np.any(gears.sizes > LIKELY * gears.deviation))
        return likely and self.better(gears, _HOPEFULLY_BETTER)

    def pooled(self, gears: Windup) -> Windup:
        """Fit one size for the drives of identical limbs, unless sizes differ significantly: a
        fault in one drive's torques may look like a compliance that the others lack."""
        limbs = self._of_limbs(gears.groups)
        sizes, covariance = gears.sizes[limbs], gears.covariance[np.ix_(limbs, limbs)]
        if len(sizes) < 2 or (gears.significant[limbs].all() and not agree(sizes, covariance)):
            return gears
        common, together = (
            max(common_lag(sizes, covariance)[0], 0.0),
            _together(gears.groups, limbs),
        )
        return self.swept(together, together @ np.append(common, gears.sizes[~limbs]), gears.p)

    def _of_limbs(self, S: Groups) -> Bool[np.ndarray, " groups"]:
        """Which groups are of drives of identical limbs."""
        count = len(self.rows.dynamics.robot.identical_drives)
        return np.asarray(S[:count].any(axis=0))

    def swept(self, S: Groups, start: Compliance, p: Parameters, most: int = SWEEPS) -> Windup:
        """Fit ε of s = known + S ε from start values, in at most `most` sweeps."""
        dof, count = S.shape
        sizes = np.linalg.lstsq(S, np.where(S.any(axis=1), start - self.known, 0.0), rcond=None)[0]
        little, first = LITTLE / (S.T @ self._largest), self.rows.size
        softest = SOFTEST * np.min(np.where(S > 0, self._softer[:, None], np.inf), axis=0)
        covariance = np.zeros((count + dof, count + dof))
        for _ in range(most):
            s = self.known + S @ sizes
            pairs = [self._of_links(winding, s, S * little, p) for winding in self.windings(p)]
            parts, freed = zip(*pairs, strict=True)
            problem = self.rows.problem(freed)
            step = np.clip(sizes + problem.x[first : first + count], 0.0, softest) - sizes
            sizes, p = sizes + step, self.rows.robot_parameters(parts)
            covariance = problem.covariance(slice(first, first + count + dof))
            if np.all(np.abs(step) < NEAR * np.sqrt(np.diag(covariance)[:count])):
                break
        scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        correlation = np.abs(covariance / np.outer(scale, scale))[:count, count:]
        like_lag = np.max(correlation * S.T, axis=1)
        return Windup(self.known + S @ sizes, S, sizes, covariance[:count, :count], like_lag, p)

    def _of_links(
        self, winding: Windings, s: Compliance, steps: Groups, p: Parameters
    ) -> tuple[RecordingRows, RecordingRows]:
        """Rows of the links' motion by measured torques, with a column for each size and each lag;
        and the same beside free friction as well.

        Instruments are the same columns by the model's torques, free of the noise that measured
        ones bring into the links' motion: once along the motors' motion, and once along the links'
        motion by the model, which is right below the resonance of gear and inertia.
        """

        def sloped(winding: Windings, s: Compliance) -> tuple[RecordingRows, RecordingRows]:
            now = winding.turned(s)
            part = self.rows.of_trace(now).with_columns(winding.slopes(s, steps, p), late(now, p))
            return part, part.with_columns(free_friction(now, p))

        motor = Windings.modelled(winding.trace, winding.motors, p)
        link = Windings.modelled(motor.turned(s), winding.motors, p)
        clean = [sloped(along, 0 * s) for along in (motor.inner(1), link)]
        part, freed = sloped(winding.inner(2), s)
        return (
            replace(part, instruments=tuple(bare.A for bare, _ in clean)),
            replace(freed, instruments=tuple(free.A for _, free in clean)),
        )

    def better(self, gears: Windup, least: float = _BETTER) -> bool:
        """Whether these compliances fit stretches of time better by `least` standard deviations
        of their scatter, beyond the noise that they cancel."""
        residuals = [self.residuals(s, gears.p)[0] for s in (gears.values, self.known)]
        # A share above 1 does not count: the residual may be something else than noise of torques.
        left = np.minimum(self.left_of_noise(gears, residuals[1]), 1.0)[:, None]
        gains = list[np.ndarray]()
        for ours, theirs in zip(*residuals, strict=True):
            ours = ours / left
            noise = np.mean(ours**2, axis=1, keepdims=True)
            gain = np.sum((theirs**2 - ours**2) / noise, axis=0)
            gains.append(np.add.reduceat(gain, stretch_starts(len(gain))))
        by_stretch = np.concatenate(gains)
        return bool(by_stretch.mean() > least * by_stretch.std(ddof=1) / np.sqrt(len(by_stretch)))

    def left_of_noise(
        self, gears: Windup, residuals: Sequence[Float[np.ndarray, "dof _"]]
    ) -> Float[np.ndarray, " dof"]:
        """Noise of torques in the rows with these compliances, as a share of that with the known
        ones, by simulated noise of the size of the residuals."""
        scale, rng = np.concatenate(residuals, axis=1).std(axis=1), np.random.default_rng(0)

        def errors(windings: Sequence[Windings], s: Compliance) -> np.ndarray:
            turned = [winding.turned(s) for winding in windings]
            return np.hstack([trace.model(gears.p) - trace.torques() for trace in turned])

        def noisy(w: SampleBlock) -> SampleBlock:
            return replace(w, tau=w.tau + scale * rng.standard_normal(w.tau.shape))

        loud = tuple(replace(t, stretches=tuple(map(noisy, t.stretches))) for t in self.traces)
        clean, disturbed = (fit.windings(gears.p) for fit in (self, replace(self, traces=loud)))
        ours, theirs = (
            np.std(errors(disturbed, s) - errors(clean, s), axis=1)
            for s in (gears.values, self.known)
        )
        return ours / theirs

    @property
    def _largest(self) -> Float[np.ndarray, " dof"]:
        return np.max([trace.recording.log.torque_max for trace in self.traces], axis=0)

    @cached_property
    def _softer(self) -> Compliance:
        """Compliance of gears that wind up by a drive's whole range at its largest torque."""
        inverse = self.rows.dynamics.kinematics.inverse
        parts = [inverse(w.z) for trace in self.traces for w in trace.stretches]
        return np.max([np.ptp(q, axis=0) for q in parts], axis=0) / self._largest


def _together(S: Groups, pooled: Bool[np.ndarray, " groups"]) -> Float[np.ndarray, "dof together"]:
    """Merge some groups into one, which comes first."""
    return np.column_stack([S[:, pooled].sum(axis=1), S[:, ~pooled]]) if pooled.any() else S


def _size(residuals: Sequence[Float[np.ndarray, "dof _"]]) -> float:
    """Sum of the logarithms of each drive's rms residual."""
    together = np.concatenate(residuals, axis=1)
    return float(np.sum(np.log(np.maximum(together.std(axis=1), np.finfo(float).tiny))))
