"""Gears that wind up: the compliance of every drive, estimated beside parameters and lags.

What a motor turns ahead of its link, s τ_g, changes what a model predicts by

    Δτ = ∂(Y p)/∂s · s,

to first order one more column of the regression for each drive: torques of a motion turned back by
a little less those of the motion, by the little. How far it is turned back follows from measured
torques, the column from the model's: noise of the torques would stand on both sides and be taken
for a compliance. Free lags of all drives stand beside them, since
on a slow motion both look alike; what cannot be told apart has a wide interval and is left alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.errors import RecordingError
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.lag_stage import without_lags
from deltaid.identification.lags import BLOCKS, reduced
from deltaid.identification.objective import NOISE_FLOOR
from deltaid.identification.reduction import Reduction
from deltaid.identification.regularizer import Euclidean
from deltaid.identification.scatter import quantile
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.traces import Trace, trace
from deltaid.model.corrections import Correction
from deltaid.recording.filter import HIGHEST
from deltaid.recording.gears import Gears, convolved
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW, Samples
from deltaid.robot.description import RobotDescription

# Windows of a recording that are looked at, and seconds.
_WINDOWS, _SECONDS = 2, 12.0
# The low-pass over what gears carry, as a multiple of that over rows.
_WIDER = 2.5
# Sweeps of Gauss and Newton; a compliance counts that is so many standard deviations, and
# is looked at further with so many.
_ROUNDS, _SWEEPS, _SIGNIFICANT, _HOPEFUL = 3, 4, 5.0, 2.0
# A gear that winds up by so many radians or metres at a drive's largest torque, for differences.
_LITTLE = 1e-4
_DEPENDENT, _LOADED = 1e-9, 0.2

Compliance = Float[np.ndarray, " dof"]
Columns = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, eq=False)
class _Found:
    """Compliances with their standard deviations."""

    values: Compliance
    deviation: Compliance


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Positions of links in the place of those of motors, where their gears wind up."""
    for one in setup.recordings:
        setup = setup.repaired(one, gears=None)
    # Lags stand here as columns of their own.
    setup = setup.told((), "compliance").changed(additions=without_lags(setup.additions))
    # Rows that are not quite where they stand in time are off by their speed, like wound gears.
    even = [one for one in setup.recordings if one.log.laid.steady]
    seen = [(one, found) for one in even if (found := _traced(setup, one)) is not None]
    if not seen:
        return setup
    progress("looking for gears that wind up")
    traces = [found for _, found in seen]
    free, found = np.ones(setup.dynamics.dof, dtype=bool), None
    turned, gears = traces, list[Gears]()
    for round in range(_ROUNDS):
        p = _parameters(turned, setup)
        filters = [one.low_pass for one in traces]
        gears = [motors_of(setup.robot, p, each.cutoff, each.rate) for each in filters]
        wound = [_wound(one, motors) for one, motors in zip(traces, gears, strict=True)]
        loaded = np.all([one.loaded for one in wound], axis=0)
        found = _estimated(wound, setup, p, free & loaded, found)
        if not np.any(found.values > _HOPEFUL * found.deviation):
            return setup
        while round == _ROUNDS - 1 and np.any(free & ~_seen(found)):
            free &= _seen(found)
            found = _estimated(wound, setup, p, free, found)
        turned = [one.turned(found.values) for one in wound]
    if not free.any():
        return setup
    assert found is not None
    values = tuple(np.where(free, found.values, 0.0).tolist())
    for (one, _), motors in zip(seen, gears, strict=True):
        setup = setup.repaired(one, gears=replace(motors, compliance=values))
    return setup.told(_told(setup, found, free), "compliance")


def gears_seen_again(setup: Setup, progress: Progress) -> Setup:
    """Compliances once more, where laws of friction were chosen that may have looked like them."""
    kinds = {one.kind for one in setup.corrections}
    return gears_turned_back(setup, progress) if kinds >= {"compliance", "friction"} else setup


def _seen(found: _Found) -> np.ndarray:
    return found.values > _SIGNIFICANT * found.deviation


def _told(setup: Setup, found: _Found, free: np.ndarray) -> list[Correction]:
    wide = float(quantile(np.array([BLOCKS - 1.0]))[0])
    corrections = []
    for i in np.flatnonzero(free):
        drive, value = setup.robot.drives[i], float(found.values[i])
        half, slides = wide * float(found.deviation[i]), setup.robot.is_linear(drive)
        corrections.append(
            Correction(
                kind="compliance",
                subject=drive,
                value=value,
                low=value - half,
                high=value + half,
                unit="m/N" if slides else "rad/(N m)",
                text=f"its gear winds up by what it carries over {1 / value:.3g} "
                f"{'N/m' if slides else 'N m/rad'}, {value / found.deviation[i]:.0f} standard "
                "deviations beside a free lag; positions are those of the link. The interval holds "
                "noise alone: a stiffness found like this may be off by half",
            )
        )
    return corrections


def _traced(setup: Setup, recording: Recording) -> Trace | None:
    """A recording in memory; None where it has no filter or nothing can be differentiated."""
    if recording.low_pass is None:
        return None
    windows = max(_WINDOWS, round(_SECONDS * recording.log.rate / WINDOW))
    load = prior_parameters(setup.robot)
    try:
        return trace(
            setup.dynamics,
            recording,
            load,
            cutoff=recording.cutoff,
            reach=0.0,
            reversals=False,
            windows=windows,
        )
    except RecordingError:
        return None


def motors_of(robot: RobotDescription, p: Parameters, cutoff: float, rate: float) -> Gears:
    """Stiff gears between links and motors with the friction and rotors of p.

    Args:
        cutoff: of the low-pass over rows [Hz], which that over what gears carry must not bend.
        rate: samples per second.
    """
    layout = parameter_layout(robot)
    named = dict(zip((one.name for one in layout.parameters), p.tolist(), strict=True))

    def of(kind: str) -> tuple[float, ...]:
        return tuple(named.get(f"{kind}.{drive}", 0.0) for drive in robot.drives)

    stiff = (0.0,) * len(robot.drives)
    widest = min(_WIDER * cutoff, HIGHEST * rate)
    return Gears(stiff, of("viscous"), of("coulomb"), of("rotor"), widest)


@threadpool_limits.wrap(limits=1, user_api="blas")
def _estimated(
    wound: Sequence["_Windings"],
    setup: Setup,
    p: Parameters,
    free: np.ndarray,
    start: _Found | None,
) -> _Found:
    """Compliances of free drives by Gauss and Newton, others stiff."""
    dof = setup.dynamics.dof
    values = np.zeros(dof) if start is None else start.values.copy()
    deviation = np.full(dof, np.inf)
    values[~free] = 0.0
    if not free.any():
        return _Found(values, deviation)
    largest = np.max([one.trace.recording.log.torque_max for one in wound], axis=0)
    little = _LITTLE / largest
    rows = _Rows.of(wound[0].trace, setup)
    for _ in range(_SWEEPS):
        sheets = list[_Sheet]()
        for windings in wound:
            now, modelled = windings.by_model(values, p)
            before = _left(now, p)
            A = np.zeros((dof, before.shape[1], int(free.sum())))
            for k, i in enumerate(np.flatnonzero(free)):
                more = np.zeros(dof)
                more[i] = little[i]
                A[:, :, k] = (_left(modelled.turned(more), p) - before) / little[i]
            sheets.append(rows.sheet(now, np.concatenate([A, _slopes(now, p)], axis=2)))
        x, spread = rows.solved(sheets, int(free.sum()))
        change = x[rows.free : rows.free + len(spread)]
        values[free] = np.maximum(values[free] + change, 0.0)
        deviation[free] = spread
        if np.all(np.abs(change) < 0.1 * spread):
            break
    return _Found(values, deviation)


def _left(now: Trace, p: Parameters) -> Float[np.ndarray, "dof samples"]:
    """What a model predicts less what was measured."""
    return now.model(p) - now.torques(np.zeros(now.dynamics.dof))


def _slopes(now: Trace, p: Parameters) -> Float[np.ndarray, "dof samples dof"]:
    """−τ̇ of each drive, in a column of its own."""
    dof = now.dynamics.dof

    def slope(w: Samples) -> np.ndarray:
        return -np.gradient(now.dynamics.torque(w.z, w.qd, w.qdd, p), axis=0).T

    rates = now.low_pass.rate * now.filtered(slope, np.arange(dof), 1)
    out = np.zeros((dof, rates.shape[1], dof))
    out[np.arange(dof), :, np.arange(dof)] = rates
    return out


def _parameters(traces: Sequence[Trace], setup: Setup) -> Parameters:
    """p of the robot beside a free lag for every drive."""
    rows, dof, p = _Rows.of(traces[0], setup), setup.dynamics.dof, None
    for _ in range(2):
        sheets = list[_Sheet]()
        for one in traces:
            count = one.torques(np.zeros(dof)).shape[1]
            columns = np.zeros((dof, count, 0)) if p is None else _slopes(one, p)
            sheets.append(rows.sheet(one, columns))
        x, _ = rows.solved(sheets, 0)
        found = rows.reduction.A @ x[: rows.free] + rows.reduction.p_0
        p = found[: len(setup.dynamics.layout.names)]
    assert p is not None
    return p


@dataclass(frozen=True, eq=False)
class _Rows:
    """What rows of a trace are made for: free parameters of robot and additions, and their prior.

    Attributes:
        reduction: of robot and additions.
        additions: columns beside those of the robot.
        D, known: of the prior, D x = known with standard deviations of 1.
    """

    reduction: Reduction
    additions: tuple[Addition, ...]
    D: Float[np.ndarray, "known variables"]
    known: Float[np.ndarray, " known"]

    @classmethod
    def of(cls, one: Trace, setup: Setup) -> "_Rows":
        """For the fit that a setup leads to."""
        reduction, spread = reduced(one, setup.additions), setup.settings.prior_spread
        prior = Euclidean().regularizer(reduction).quadratic
        D = prior.D / spread
        return cls(reduction, setup.additions, D, D @ prior.x_reg)

    @property
    def free(self) -> int:
        """Number of free parameters."""
        return self.D.shape[1]

    def sheet(self, one: Trace, A: Float[np.ndarray, "dof samples columns"]) -> "_Sheet":
        """Rows of a trace, with columns beside the parameters'."""
        active = active_columns(extended(one.dynamics, self.additions))
        rows = one.regressor(self.additions)
        tau = one.torques(np.zeros(one.dynamics.dof)) - rows @ self.reduction.p_0[active]
        return _Sheet(rows @ self.reduction.A[active], A, tau)

    def solved(self, sheets: Sequence["_Sheet"], count: int) -> tuple[np.ndarray, np.ndarray]:
        """Free parameters and coefficients of A, and deviations of the first of these."""
        return _least_squares(sheets, self.D, self.known, count)


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Filtered rows: columns of the free parameters, those of compliances and lags, torques."""

    X: Float[np.ndarray, "dof samples variables"]
    A: Float[np.ndarray, "dof samples columns"]
    tau: Float[np.ndarray, "dof samples"]

    def weighted(self) -> tuple[Columns, Float[np.ndarray, " rows"]]:
        """Rows of all drives, by what each one's own columns leave of it, and its torques."""
        rows, right = [], []
        for X, A, tau in zip(self.X, self.A, self.tau, strict=True):
            columns = np.column_stack([X, A])
            norms = np.linalg.norm(columns, axis=0)
            own = columns[:, norms > 0] / norms[norms > 0]
            left = tau - own @ np.linalg.lstsq(own, tau, rcond=_DEPENDENT)[0]
            floor = NOISE_FLOOR * max(float(np.abs(tau).max()), np.finfo(float).tiny)
            noise = max(float(np.sqrt(np.mean(left**2))), floor)
            rows.append(columns / noise)
            right.append(tau / noise)
        return np.concatenate(rows), np.concatenate(right)


def _least_squares(
    sheets: Sequence[_Sheet],
    D: Float[np.ndarray, "known variables"],
    known: Float[np.ndarray, " known"],
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters with a prior and coefficients of A, and deviations by scatter of the first of A.

    Args:
        D, known: of the prior, D x = known with standard deviations of 1.
        count: so many coefficients.
    """
    parts = [one.weighted() for one in sheets]
    free, more = sheets[0].X.shape[2], sheets[0].A.shape[2]
    prior = np.hstack([D, np.zeros((len(D), more))])
    rows = np.vstack([*(x for x, _ in parts), prior])
    right = np.concatenate([*(x for _, x in parts), known])
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0] = 1.0
    Q, R = np.linalg.qr(rows / norms)
    inverse = np.linalg.pinv(R, rcond=_DEPENDENT)
    x = inverse @ (Q.T @ right)
    left = right - rows @ (x / norms)
    influence = Q @ inverse[free : free + count].T
    scores, first = [], 0
    for one in sheets:
        part, samples = slice(first, first + one.tau.size), one.tau.shape[1]
        starts = np.unique(np.arange(BLOCKS) * samples // BLOCKS)
        shares = (influence[part] * left[part, None]).reshape(len(one.tau), samples, -1)
        scores.append(np.add.reduceat(shares, starts, axis=1).sum(axis=0))
        first += one.tau.size
    stretches = np.vstack(scores)
    scatter = np.sum(stretches**2, axis=0) * len(stretches) / max(len(stretches) - 1, 1)
    white = np.sum(influence[:first] ** 2, axis=0) * np.mean(left[:first] ** 2)
    deviation = np.sqrt(np.maximum(scatter, white) + np.sum(influence[first:] ** 2, axis=0))
    own = slice(free, free + count)
    return x / norms, deviation / norms[own]


@dataclass(frozen=True, eq=False)
class _Windings:
    """A trace of the motors' motion, and what gears carry along it: τ_g, its rate, and the next.

    Attributes:
        trace: without the ends for which τ_g is not known.
        motors: with their friction and rotors.
        carried: for each stretch (3, samples, drives).
    """

    trace: Trace
    motors: Gears
    carried: tuple[Float[np.ndarray, "3 _ dof"], ...]

    def by_model(self, compliance: Compliance, p: Parameters) -> "tuple[Trace, _Windings]":
        """The links' motion, and how it would wind up gears by the torques of p."""
        dynamics, turned = self.trace.dynamics, self.turned(compliance)

        def torque(w: Samples) -> np.ndarray:
            return dynamics.carried(w.z, w.qd, w.qdd, p) + w.carried

        found = _filtered(turned, self.motors, torque)
        return found.trace, found

    @property
    def loaded(self) -> np.ndarray:
        """Whose gears carry a good share of what their motors take by themselves; of others, how
        much is carried is hardly known."""
        carried = np.concatenate([x[0] for x in self.carried])
        own = [self.motors.of_motor(w.qd, w.qdd) for w in self.trace.stretches]
        return carried.std(axis=0) > _LOADED * np.concatenate(own).std(axis=0)

    def turned(self, compliance: Compliance) -> Trace:
        """The links' motion."""
        kinematics = self.trace.dynamics.kinematics

        def back(w: Samples, carried: np.ndarray) -> Samples:
            by = compliance * carried
            z, _ = kinematics.forward_unchecked(kinematics.inverse(w.z) - by[0])
            tau = w.tau - self.motors.less(w.qd, w.qdd, by[1], by[2])
            return replace(w, z=z, qd=w.qd - by[1], qdd=w.qdd - by[2], tau=tau)

        parts = zip(self.trace.stretches, self.carried, strict=True)
        return replace(self.trace, stretches=tuple(back(w, x) for w, x in parts))


def _wound(one: Trace, motors: Gears) -> _Windings:
    """What gears carry along a trace, by its measured torques."""

    def torque(w: Samples) -> np.ndarray:
        return w.tau + w.carried - motors.of_motor(w.qd, w.qdd)

    return _filtered(one, motors, torque)


def _filtered(
    one: Trace, motors: Gears, torque: Callable[[Samples], Float[np.ndarray, "samples dof"]]
) -> _Windings:
    """A torque that gears carry and its derivatives; the filter's length is lost at both ends."""
    low_pass = motors.low_pass(one.low_pass.rate)
    stretches, carried = list[Samples](), list[np.ndarray]()
    for w in one.stretches:
        along, lost = torque(w), low_pass.margin
        taps = (low_pass.level, low_pass.first, low_pass.second)
        parts = np.array([convolved(each, along) for each in taps])
        if parts.shape[1] > 0:
            stretches.append(w.part(slice(lost, lost + parts.shape[1])))
            carried.append(parts)
    return _Windings(replace(one, stretches=tuple(stretches)), motors, tuple(carried))
