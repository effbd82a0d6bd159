"""The lag between torques and positions, drive by drive, found together with the parameters.

With torques that are recorded δ_i late, τ_meas,i(t) = τ_i(t − δ_i), so what was measured δ_i later
is what the model says now. About lags δ that are known so far,

    τ_meas,i(t + δ_i) = Y_i(t) p − ε_i τ̇_i(t)

with the derivative of the *model's* torque, τ̇ = d/dt Y p: noise on a measured one would pull ε
towards zero. p and ε come from linear least squares; torques are shifted by ε and it is repeated. A
first-order filter of time constant T has the same first-order term, so what is found is the sum of
dead time and time constants.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.drive_rows import STRETCHES, DriveRows
from deltaid.estimation.problem import scatter
from deltaid.estimation.span import DEPENDENT, Columns, Rows, Span
from deltaid.identification.information import active_columns
from deltaid.identification.scatter import quantile
from deltaid.identification.traces import Delay, Trace
from deltaid.recording.windows import Samples

# Lags that are looked for [s], and the grid on which the search for a common one begins.
REACH = 0.02
_GRID = np.linspace(-REACH, REACH, 21)
# Sweeps at most, and the step [s] below which a lag has settled.
_SWEEPS, _SETTLED = 12, 1e-6


@dataclass(frozen=True, eq=False)
class Lag:
    """Lags of the torques behind the positions.

    Attributes:
        values: of each drive [s]; positive where torques come late.
        deviation: their standard deviations [s].
        p: the parameters that go with them, of least squares.
        tau: torques without their lags, as rows.
        left: what p leaves of them.
    """

    values: Delay
    deviation: Delay
    p: Parameters
    tau: Rows
    left: Rows

    @property
    def interval(self) -> Delay:
        """Half widths of their 95 % intervals [s]."""
        return quantile(np.full(len(self.deviation), STRETCHES - 1.0)) * self.deviation


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def coarse_lag(trace: Trace, rows: DriveRows, span: Span) -> float:
    """The common lag on a grid with which parameters explain the torques best [s]."""
    left = []
    for delay in _GRID:
        tau = rows.stack(trace.torques(np.full(len(rows.scale), delay)))
        left.append(np.linalg.norm(span.without(tau)) / np.linalg.norm(tau))
    return float(_GRID[int(np.argmin(left))])


@threadpool_limits.wrap(limits=1, user_api="blas")
def estimate_lag(trace: Trace, rows: DriveRows, span: Span, start: Delay, *, common: bool) -> Lag:
    """The lag of every drive, or the one that all have in common.

    Intervals come from the scatter of the estimating equation between stretches of time, or from
    the white noise of what is left if that is wider.

    Args:
        trace: the recording.
        rows, span: its samples, and what parameters explain of them, steps of friction between
            samples.
        start: lags to begin with [s], within half a period of the motion's fastest part.
        common: whether all drives have the same.
    """
    share = np.ones((len(start), 1)) if common else np.eye(len(start))
    delay, slopes = np.array(start, dtype=float), np.zeros((0, 0))
    tau = rows.stack(trace.torques(delay))
    for _ in range(_SWEEPS):
        p, left = parameters_of(trace.dynamics, span, tau), span.without(tau)
        slopes = span.without(rows.own(model_slope(trace, p)) @ share)
        step, *_ = np.linalg.lstsq(slopes, -left, rcond=DEPENDENT)
        moved = np.clip(delay + share @ step, -REACH, REACH)
        settled = np.abs(moved - delay).max() < _SETTLED
        delay = moved
        tau = rows.stack(trace.torques(delay))
        if settled:
            break
    left = span.without(tau)
    spread = share @ deviations(slopes, left, rows, span)
    return Lag(delay, spread, parameters_of(trace.dynamics, span, tau), tau, left)


def parameters_of(dynamics: Dynamics, span: Span, b: Rows) -> Parameters:
    """p of least squares, for the span of the active columns; zero where nothing is shown."""
    p = np.zeros(len(dynamics.layout.names))
    p[active_columns(dynamics)] = span.coefficients(b)
    return p


def model_slope(trace: Trace, p: Parameters) -> Float[np.ndarray, "dof thinned"]:
    """τ̇ of the model, filtered."""

    def slope(w: Samples) -> np.ndarray:
        return np.gradient(trace.dynamics.torque(w.z, w.qd, w.qdd, p), axis=0).T

    return trace.low_pass.rate * trace.filtered(slope, np.arange(trace.dynamics.dof), 1)


def deviations(
    A: Columns, left: Rows, rows: DriveRows, span: Span
) -> Float[np.ndarray, " columns"]:
    """Standard deviations of least-squares coefficients of A, by scatter or by white noise.

    Args:
        A: columns without what parameters explain.
        left: what is left after p and A.
    """
    inverse = np.linalg.pinv(A.T @ A, hermitian=True)
    freedom = max(len(left) - span.rank - A.shape[1], 1)
    return np.sqrt(np.diag(scatter(A @ inverse, left, rows.groups, freedom)))
