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

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.lag_groups import agree
from deltaid.identification.reduction import Reduction
from deltaid.identification.rows_with_prior import (
    Prior,
    Sheet,
    Solution,
    reduced,
    solved,
    stretches,
)
from deltaid.identification.setup import Setup
from deltaid.identification.traces import Trace
from deltaid.identification.windings import Compliance, Windings, motors_of, wound
from deltaid.recording.gears import Gears
from deltaid.recording.windows import Samples

# Sweeps at most; a compliance counts that is so many standard deviations, and makes the rows of
# most stretches of time better by so many, which are half as many for one that is there.
_SWEEPS, _SIGNIFICANT, _BETTER = 8, 5.0, 2.5
# How far gears wind up at most, as a share of a drive's range, to begin with.
_SHARES = 2e-3 * 2.0 ** np.arange(6)
# A gear that winds up by so many radians or metres at a drive's largest torque, for differences.
_LITTLE = 1e-4
# Speeds over which friction changes, as shares of the largest.
_KNEES = (0.03, 0.1, 0.3)

Groups = Float[np.ndarray, "dof groups"]
Columns = Float[np.ndarray, "dof samples columns"]


@dataclass(frozen=True, eq=False)
class Found:
    """Compliances of all gears.

    Attributes:
        values: s of every drive [rad/(N m) or m/N].
        groups: which drives have each of the sizes that were looked for, ones and zeros.
        sizes, covariance: of these.
        like_lag: how far the size of each correlates with its drives' lags, between 0 and 1.
        p: parameters of the robot that go with them.
    """

    values: Compliance
    groups: Groups
    sizes: Float[np.ndarray, " groups"]
    covariance: Float[np.ndarray, "groups groups"]
    like_lag: Float[np.ndarray, " groups"]
    p: Parameters

    @property
    def deviation(self) -> Float[np.ndarray, " groups"]:
        """Standard deviations of the sizes."""
        return np.sqrt(np.diag(self.covariance))


@threadpool_limits.wrap(limits=1, user_api="blas")
def compliances(traces: Sequence[Trace], setup: Setup, stated: Compliance) -> Found:
    """Those of gears that show that they wind up, and those that are stated.

    Args:
        traces: of recordings of the same machine.
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
    found = fit.swept(S, start, p)
    S, found = _pooled(fit, S, found)
    while True:
        seen = found.sizes > _SIGNIFICANT * found.deviation
        if seen.all():
            return found if fit.better(found) else fit.nothing(fit.at(fit.known)[1])
        if not seen.any():
            return fit.nothing(fit.at(fit.known)[1])
        S = S[:, seen]
        found = fit.swept(S, S @ found.sizes[seen], found.p)


def _pooled(fit: "_Fit", S: Groups, found: Found) -> tuple[Groups, Found]:
    """One size for the drives of identical limbs, if theirs do not contradict that."""
    limbs = fit.setup.robot.limbs
    if limbs is None or not limbs.identical:
        return S, found
    alike = S[: limbs.count].any(axis=0)
    own = np.ix_(alike, alike)
    if alike.sum() < 2 or not agree(found.sizes[alike], found.covariance[own]):
        return S, found
    weights = np.linalg.solve(found.covariance[own], np.ones(int(alike.sum())))
    common = float(max(weights @ found.sizes[alike] / weights.sum(), 0.0))
    S, rest = np.column_stack([S[:, alike].sum(axis=1), S[:, ~alike]]), found.sizes[~alike]
    return S, fit.swept(S, S @ np.append(common, rest), found.p)


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
            rows = _Rows.of(self.traces, self.setup)
            _, p = rows.fitted(self.traces)
        turned = [one.turned(s) for one in self.windings(p)]
        return _Rows.of(turned, self.setup).fitted(turned)

    def start(
        self, free: Bool[np.ndarray, " dof"], left: list[np.ndarray], p: Parameters
    ) -> tuple[Compliance, Parameters]:
        """Compliances to begin with: gears that wind up alike, as a share of their drives' range,
        for rows have several minima over it.

        Args:
            left: of gears as they are known.
        """
        best, value = self.known, _size(left)
        softer = np.where(free, self._range / self._largest, 0.0)
        for share in _SHARES:
            s = self.known + share * softer
            left, own = self.at(s, p)
            if _size(left) >= value:
                break
            best, value, p = s, _size(left), own
        return best, p

    def swept(self, S: Groups, start: Compliance, p: Parameters) -> Found:
        """s = known + S ε with the best ε, from a start on."""
        free = S.any(axis=1)
        sizes = np.linalg.lstsq(S, np.where(free, start - self.known, 0.0), rcond=None)[0]
        little, count = _LITTLE / (S.T @ self._largest), S.shape[1]
        for _ in range(_SWEEPS):
            s, sheets = self.known + S @ sizes, list[Sheet]()
            windings = self.windings(p)
            turned = [one.by_model(s, p) for one in windings]
            rows = _Rows.of([now for now, _ in turned], self.setup)
            for now, modelled in turned:
                before, columns = now.model(p), list[np.ndarray]()
                for step, which in zip(little, S.T, strict=True):
                    more = modelled.turned(step * which)
                    change = more.model(p) - before - _torques(more) + _torques(now)
                    columns.append(change / step)
                sheets.append(rows.sheet(now, p, np.stack(columns, axis=2)))
            solution = rows.solved(sheets)
            moved = np.maximum(sizes + solution.a[:count], 0.0) - sizes
            sizes, p = sizes + moved, rows.parameters(sheets)
            covariance = solution.covariance
            if np.all(np.abs(moved) < 0.1 * np.sqrt(np.diag(covariance)[:count])):
                break
        return Found(
            self.known + S @ sizes, S, sizes, covariance[:count, :count],
            _like_lag(covariance, S), p,
        )  # fmt: skip

    def better(self, found: Found) -> bool:
        """Whether rows of most stretches of time are nearer with what was found than without."""
        gains = list[np.ndarray]()
        with_it, without = (self.at(s, found.p)[0] for s in (found.values, self.known))
        for ours, theirs in zip(with_it, without, strict=True):
            noise = np.mean(ours**2, axis=1, keepdims=True)
            gain = np.sum((theirs**2 - ours**2) / noise, axis=0)
            gains.append(np.add.reduceat(gain, stretches(len(gain))))
        each = np.concatenate(gains)
        return bool(each.mean() > _BETTER * each.std(ddof=1) / np.sqrt(len(each)))

    def _motors(self, one: Trace, p: Parameters) -> Gears:
        return motors_of(self.setup.robot, p, one.low_pass.cutoff, one.low_pass.rate)

    @property
    def _largest(self) -> Float[np.ndarray, " dof"]:
        return np.max([one.recording.log.torque_max for one in self.traces], axis=0)

    @property
    def _range(self) -> Float[np.ndarray, " dof"]:
        inverse = self.setup.dynamics.kinematics.inverse
        parts = [inverse(w.z) for one in self.traces for w in one.stretches]
        return np.max([np.ptp(q, axis=0) for q in parts], axis=0)


@dataclass(frozen=True, eq=False)
class _Rows:
    """What rows of traces are made for: the free parameters of a fit, and their prior."""

    reduction: Reduction
    additions: tuple[Addition, ...]
    prior: Prior

    @classmethod
    def of(cls, traces: Sequence[Trace], setup: Setup) -> "_Rows":
        """For the fit that a setup leads to."""
        reduction = reduced(traces[0], setup.additions)
        return cls(reduction, setup.additions, Prior.of(reduction, setup.settings.prior_spread))

    def fitted(self, traces: Sequence[Trace]) -> tuple[list[np.ndarray], Parameters]:
        """What is left of each trace's rows, and p."""
        nothing = [np.zeros((*_torques(one).shape, 0)) for one in traces]
        sheets = [self.sheet(one, None, none) for one, none in zip(traces, nothing, strict=True)]
        p = self.parameters(sheets)
        sheets = [
            replace(one, A=np.concatenate([_slopes(now, p), one.A], axis=2))
            for one, now in zip(sheets, traces, strict=True)
        ]
        solution = self.solved(sheets)
        x = np.concatenate([solution.x, solution.a])
        left = [one.tau - np.concatenate([one.X, one.A], axis=2) @ x for one in sheets]
        return left, self.parameters(sheets)

    def sheet(self, one: Trace, p: Parameters | None, columns: Columns) -> Sheet:
        """Rows of a trace, with columns beside the parameters', those of lags and friction behind.

        Args:
            p: whose torques lag; without lags if not given.
        """
        active = active_columns(extended(one.dynamics, self.additions))
        rows = one.regressor(self.additions)
        tau = _torques(one) - rows @ self.reduction.p_0[active]
        lags = [] if p is None else [_slopes(one, p)]
        A = np.concatenate([columns, *lags, _friction(one)], axis=2)
        return Sheet(rows @ self.reduction.A[active], A, tau)

    def solved(self, sheets: Sequence[Sheet]) -> Solution:
        """Of all recordings; of what stands beside the parameters nothing is known."""
        nothing = np.zeros(sheets[0].A.shape[2])
        return solved(sheets, self.prior.beside(nothing, nothing + np.inf))

    def parameters(self, sheets: Sequence[Sheet]) -> Parameters:
        """p of the robot, whose friction is viscous and Coulomb's as well as that goes: beside a
        free curve, hardly anything tells them."""
        free = len(_SHAPES) * len(sheets[0].tau)
        plain = self.solved([replace(one, A=one.A[:, :, :-free]) for one in sheets])
        p = self.reduction.A @ plain.x + self.reduction.p_0
        return p[: len(p) - sum(len(one.parameters) for one in self.additions)]


def _torques(one: Trace) -> Float[np.ndarray, "dof samples"]:
    return one.torques(np.zeros(one.dynamics.dof))


def _slopes(now: Trace, p: Parameters) -> Columns:
    """−τ̇ of each drive, in a column of its own."""
    dof = now.dynamics.dof

    def slope(w: Samples) -> np.ndarray:
        return -np.gradient(now.dynamics.torque(w.z, w.qd, w.qdd, p), axis=0).T

    return _apart(now.low_pass.rate * now.filtered(slope, np.arange(dof), 1)[:, :, None])


# Friction over the speed, as a share v of the largest: falling within a knee and growing with its
# square, both ways alike; and what may differ between them.
_SHAPES = (
    *(lambda v, knee=knee: np.sign(v) * np.exp(-np.abs(v) / knee) for knee in _KNEES),
    lambda v: v * np.abs(v),
    lambda v: np.ones_like(v),
    np.abs,
    lambda v: np.exp(-np.abs(v) / _KNEES[1]),
)


def _friction(now: Trace) -> Columns:
    """Friction of each drive beside Coulomb's and viscous, in columns of its own; and a share of
    what its gear carries."""
    fastest = np.max([np.abs(w.qd).max(axis=0) for w in now.stretches], axis=0)

    def shapes(w: Samples) -> np.ndarray:
        v = w.qd / fastest
        return np.hstack([shape(v) for shape in _SHAPES]).T

    dof = now.dynamics.dof
    out = now.filtered(shapes, np.tile(np.arange(dof), len(_SHAPES)))
    return _apart(out.reshape(len(_SHAPES), dof, -1).transpose(1, 2, 0))


def _apart(own: Float[np.ndarray, "dof samples own"]) -> Columns:
    """Columns that each drive has by itself, zero in the rows of others."""
    dof, samples, count = own.shape
    out = np.zeros((dof, samples, dof, count))
    out[np.arange(dof), :, np.arange(dof)] = own
    return out.reshape(dof, samples, dof * count)


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
