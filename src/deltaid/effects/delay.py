"""Torques that are recorded late: τ_meas(t) = τ(t − δ), to first order τ_meas,i = Y_i p − δ τ̇_i.

A lag is one more coefficient with the column −τ̇, the slope of the *model's* torque: noise on a
measured one would pull δ towards zero. A first-order filter of time constant T has the same
first-order term, so δ is the sum of dead time and time constants. `lag_columns` has them for a fit,
`lags` estimates them, `Trace.shifted` applies them exactly.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.effects.effect import Effect
from deltaid.effects.rigid_fit import Candidate, RigidFit
from deltaid.estimation.additions import Addition, Own, extended
from deltaid.estimation.drive_rows import OfDrives
from deltaid.estimation.traces import Trace
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples


class Delay(Effect):
    """A lag of all drives, or one a drive; verdicts of its own say how large it is."""

    kind = "torque-lag"
    is_described = False

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        columns = slopes(fit.trace, fit.p)
        yield Candidate(self.kind, "", fit.rows.stack(columns)[:, None])
        yield Candidate(self.kind, "", fit.rows.own(columns))


def slopes(trace: Trace, p: Parameters, additions: Sequence[Addition] = ()) -> OfDrives:
    """−τ̇ of the torques of p, filtered: by what a drive's torque changes for each second that it
    comes late.

    Args:
        p: parameters of the robot, then those of additions.
    """
    dynamics, by_p = trace.dynamics, replace(trace, load=p[: len(trace.dynamics.layout.names)])
    return trace.filtered(
        lambda w: slopes_along(dynamics, additions, p, w, by_p.entries(w), trace.recording),
        np.arange(dynamics.dof),
        1,
    )


def slopes_along(
    dynamics: Dynamics,
    additions: Sequence[Addition],
    p: Parameters,
    w: Samples,
    own: Own,
    recording: Recording,
) -> OfDrives:
    """−τ̇ along consecutive samples at the full rate.

    Args:
        own: entries of the robot's regressor there, in the order of its pattern.
    """
    values = np.vstack([own, *(one.entries(w, own, recording) for one in additions)])
    rows, columns = extended(dynamics, additions).regressor_pattern
    tau = w.carried.T.copy()  # of loads, which lag with all else
    for i in range(len(tau)):
        tau[i] += p[columns[rows == i]] @ values[rows == i]
    return -recording.log.rate * slope(tau, _reversals(dynamics, own))


def _reversals(dynamics: Dynamics, own: Own) -> Bool[np.ndarray, "dof steps"]:
    """Whether a joint with friction turns round between a sample and the next, in whose row."""
    layout, (rows, columns) = dynamics.layout, dynamics.regressor_pattern
    turned = np.zeros((dynamics.dof, own.shape[1] - 1), dtype=bool)
    for k in np.flatnonzero(np.isin(columns, np.arange(len(layout.names))[layout.viscous])):
        turned[rows[k]] |= own[k, :-1] * own[k, 1:] < 0
    return turned


def slope(
    tau: Float[np.ndarray, "drives samples"],
    turned: Bool[np.ndarray, "drives steps"] | bool = False,
) -> Float[np.ndarray, "drives samples"]:
    """The rise of torques from sample to sample, without the steps of friction.

    Central differences; beside a reversal the difference of the side that has no step.

    Args:
        tau: at least two samples.
        turned: between which samples and the next a joint turns round.
    """
    steps = np.diff(tau, axis=1)
    total, number = (
        np.pad(x, ((0, 0), (0, 1))) + np.pad(x, ((0, 0), (1, 0)))
        for x in (np.where(turned, 0.0, steps), np.where(turned, 0.0, np.ones_like(steps)))
    )
    return total / np.maximum(number, 1.0)
