"""Gears that wind up: the compliance of every drive, estimated beside parameters and lags.

What a motor turns ahead of its link, s τ_g, changes what a model predicts by

    Δτ = ∂(Y p)/∂s · s,

to first order one more column of the regression for each drive: torques of a motion turned back by
a little less those of the motion, by the little. How far it is turned back follows from measured
torques, the column from the model's: noise of the torques would stand on both sides and be taken
for a compliance. Free lags of all drives stand beside them, since
on a slow motion both look alike; what cannot be told apart has a wide interval and is left alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.lag_stage import without_lags
from deltaid.identification.reduction import Reduction
from deltaid.identification.rows_with_prior import BLOCKS, Prior, Sheet, Solution, reduced, solved
from deltaid.identification.scatter import quantile
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.traces import Trace, trace
from deltaid.identification.windings import Compliance, Windings, motors_of, wound
from deltaid.model.corrections import Correction
from deltaid.recording.gears import Gears
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW, Samples

# Windows of a recording that are looked at, and seconds.
_WINDOWS, _SECONDS = 2, 12.0
# Sweeps of Gauss and Newton; a compliance counts that is so many standard deviations, and
# is looked at further with so many.
_ROUNDS, _SWEEPS, _SIGNIFICANT, _HOPEFUL = 3, 4, 5.0, 2.0
# A gear that winds up by so many radians or metres at a drive's largest torque, for differences.
_LITTLE = 1e-4


@dataclass(frozen=True, eq=False)
class _Found:
    """Compliances with their standard deviations."""

    values: Compliance
    deviation: Compliance


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Positions of links in the place of those of motors, where their gears wind up."""
    turned = _turned_back(setup, progress)
    gears = [one.repairs.gears for one in (*setup.recordings, *turned.recordings)]
    return turned if any(gears) else setup  # with its lags


def _turned_back(setup: Setup, progress: Progress) -> Setup:
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
        windings = [wound(one, motors) for one, motors in zip(traces, gears, strict=True)]
        loaded = np.all([one.loaded for one in windings], axis=0)
        found = _estimated(windings, setup, p, free & loaded, found)
        if not np.any(found.values > _HOPEFUL * found.deviation):
            return setup
        while round == _ROUNDS - 1 and np.any(free & ~_seen(found)):
            free &= _seen(found)
            found = _estimated(windings, setup, p, free, found)
        turned = [one.turned(found.values) for one in windings]
    if not free.any():
        return setup
    assert found is not None
    values = tuple(np.where(free, found.values, 0.0).tolist())
    for (one, _), motors in zip(seen, gears, strict=True):
        setup = setup.repaired(one, gears=replace(motors, compliance=values))
    return setup.told(_told(setup, found, free), "compliance")


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


@threadpool_limits.wrap(limits=1, user_api="blas")
def _estimated(
    wound_up: Sequence[Windings],
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
    largest = np.max([one.trace.recording.log.torque_max for one in wound_up], axis=0)
    little = _LITTLE / largest
    rows = _Rows.of(wound_up[0].trace, setup)
    for _ in range(_SWEEPS):
        sheets = list[Sheet]()
        for windings in wound_up:
            now, modelled = windings.by_model(values, p)
            before = _left(now, p)
            A = np.zeros((dof, before.shape[1], int(free.sum())))
            for k, i in enumerate(np.flatnonzero(free)):
                more = np.zeros(dof)
                more[i] = little[i]
                A[:, :, k] = (_left(modelled.turned(more), p) - before) / little[i]
            sheets.append(rows.sheet(now, np.concatenate([A, _slopes(now, p)], axis=2)))
        solution, count = rows.solved(sheets), int(free.sum())
        spread = np.sqrt(np.diag(solution.covariance)[:count])
        change = solution.a[:count]
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
        sheets = list[Sheet]()
        for one in traces:
            count = one.torques(np.zeros(dof)).shape[1]
            columns = np.zeros((dof, count, 0)) if p is None else _slopes(one, p)
            sheets.append(rows.sheet(one, columns))
        found = rows.reduction.A @ rows.solved(sheets).x + rows.reduction.p_0
        p = found[: len(setup.dynamics.layout.names)]
    assert p is not None
    return p


@dataclass(frozen=True, eq=False)
class _Rows:
    """What rows of a trace are made for: the free parameters of a fit, and their prior."""

    reduction: Reduction
    additions: tuple[Addition, ...]
    prior: Prior

    @classmethod
    def of(cls, one: Trace, setup: Setup) -> "_Rows":
        """For the fit that a setup leads to."""
        reduction = reduced(one, setup.additions)
        return cls(reduction, setup.additions, Prior.of(reduction, setup.settings.prior_spread))

    def sheet(self, one: Trace, A: Float[np.ndarray, "dof samples columns"]) -> Sheet:
        """Rows of a trace, with columns beside the parameters'."""
        active = active_columns(extended(one.dynamics, self.additions))
        rows = one.regressor(self.additions)
        tau = one.torques(np.zeros(one.dynamics.dof)) - rows @ self.reduction.p_0[active]
        return Sheet(rows @ self.reduction.A[active], A, tau)

    def solved(self, sheets: Sequence[Sheet]) -> Solution:
        """Of all recordings; of what stands beside the parameters nothing is known."""
        nothing = np.zeros(sheets[0].A.shape[2])
        return solved(sheets, self.prior.beside(nothing, nothing + np.inf))
