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
from deltaid.identification.information import active_columns
from deltaid.identification.rows_with_prior import BLOCKS, stretches
from deltaid.identification.scatter import quantile
from deltaid.identification.traces import Delay, Trace
from deltaid.recording.windows import Samples

# Lags that are looked for [s], and the grid on which the search for a common one begins.
REACH = 0.02
_GRID = np.linspace(-REACH, REACH, 21)
# Sweeps at most, and the step [s] below which a lag has settled.
_SWEEPS, _SETTLED = 12, 1e-6
_DEPENDENT = 1e-9  # singular values below this share of the largest are zero

Rows = Float[np.ndarray, " rows"]
Columns = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, eq=False)
class Basis:
    """Filtered rows of all drives under each other, and what columns can explain of them.

    Attributes:
        Q: orthonormal columns that span those of Y.
        solution: takes coefficients of Q to p, columns of Y at unit length and p the least.
        scale: what each drive's rows are divided by [N m or N].
    """

    Q: Columns
    solution: Float[np.ndarray, "parameters rank"]
    scale: Float[np.ndarray, " dof"]

    def stack(self, x: Float[np.ndarray, "dof samples *k"]) -> np.ndarray:
        """Something of every drive as rows."""
        scaled = x / self.scale.reshape(-1, *[1] * (x.ndim - 1))
        return scaled.reshape(-1, *x.shape[2:])

    def own(self, x: Float[np.ndarray, "dof samples"]) -> Float[np.ndarray, "rows dof"]:
        """Something of every drive, one column a drive that is zero for all others."""
        dof, samples = x.shape
        out = np.zeros((dof, samples, dof))
        out[np.arange(dof), :, np.arange(dof)] = x
        return self.stack(out)

    def without(self, A: np.ndarray) -> np.ndarray:
        """What the columns cannot explain of A."""
        return A - self.Q @ (self.Q.T @ A)

    def extended(self, U: Columns) -> "Basis":
        """The same with further columns, orthonormal to those, that belong to no parameter."""
        nothing = np.zeros((len(self.solution), U.shape[1]))
        solution = np.hstack([self.solution, nothing])
        return Basis(np.hstack([self.Q, U]), solution, self.scale)

    def parameters(self, rows: Rows) -> Parameters:
        """p of least squares for some right-hand side."""
        return self.solution @ (self.Q.T @ rows)


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
        return quantile(np.full(len(self.deviation), BLOCKS - 1.0)) * self.deviation


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def basis_of(
    dynamics: Dynamics,
    Y: Float[np.ndarray, "dof samples columns"],
    scale: Float[np.ndarray, " dof"],
) -> Basis:
    """What parameters explain of a recording's torques.

    Args:
        dynamics: of the robot.
        Y: the active columns of its regressor, filtered (`Trace.regressor`).
        scale: what each drive's rows are divided by, such as its noise or largest torque.
    """
    dof, samples, width = Y.shape
    rows = (Y / scale[:, None, None]).reshape(dof * samples, width)
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0] = 1.0
    Q, R = np.linalg.qr(rows / norms)
    U, s, Vt = np.linalg.svd(R)
    kept = s > _DEPENDENT * s[0]
    solution = np.zeros((len(dynamics.layout.names), int(kept.sum())))
    solution[active_columns(dynamics)] = Vt[kept].T / s[kept] / norms[:, None]
    return Basis(Q @ U[:, kept], solution, scale)


def widened_by(basis: Basis, columns: Columns) -> Basis:
    """A basis with further columns, as far as these are not explained yet."""
    U, s, _ = np.linalg.svd(basis.without(columns), full_matrices=False)
    return basis.extended(U[:, s > _DEPENDENT * np.linalg.norm(columns)])


@threadpool_limits.wrap(limits=1, user_api="blas")
def coarse_lag(trace: Trace, basis: Basis) -> float:
    """The common lag on a grid with which parameters explain the torques best [s]."""
    left = []
    for delay in _GRID:
        tau = basis.stack(trace.torques(np.full(len(basis.scale), delay)))
        left.append(np.linalg.norm(basis.without(tau)) / np.linalg.norm(tau))
    return float(_GRID[int(np.argmin(left))])


@threadpool_limits.wrap(limits=1, user_api="blas")
def estimate_lag(trace: Trace, basis: Basis, start: Delay, *, common: bool) -> Lag:
    """The lag of every drive, or the one that all have in common.

    Intervals come from the scatter of the estimating equation between stretches of time, or from
    the white noise of what is left if that is wider.

    Args:
        trace: the recording.
        basis: what parameters explain of it, steps of friction between samples.
        start: lags to begin with [s], within half a period of the motion's fastest part.
        common: whether all drives have the same.
    """
    share = np.ones((len(start), 1)) if common else np.eye(len(start))
    delay, slopes = np.array(start, dtype=float), np.zeros((0, 0))
    tau = basis.stack(trace.torques(delay))
    for _ in range(_SWEEPS):
        p, left = basis.parameters(tau), basis.without(tau)
        slopes = basis.without(basis.own(model_slope(trace, p)) @ share)
        step, *_ = np.linalg.lstsq(slopes, -left, rcond=_DEPENDENT)
        moved = np.clip(delay + share @ step, -REACH, REACH)
        settled = np.abs(moved - delay).max() < _SETTLED
        delay = moved
        tau = basis.stack(trace.torques(delay))
        if settled:
            break
    left = basis.without(tau)
    spread = share @ deviations(slopes, left, basis)
    return Lag(delay, spread, basis.parameters(tau), tau, left)


def model_slope(trace: Trace, p: Parameters) -> Float[np.ndarray, "dof thinned"]:
    """τ̇ of the model, filtered."""

    def slope(w: Samples) -> np.ndarray:
        return np.gradient(trace.dynamics.torque(w.z, w.qd, w.qdd, p), axis=0).T

    return trace.low_pass.rate * trace.filtered(slope, np.arange(trace.dynamics.dof), 1)


def deviations(A: Columns, left: Rows, basis: Basis) -> Float[np.ndarray, " columns"]:
    """Standard deviations of least-squares coefficients of A, by scatter or by white noise.

    Args:
        A: columns without what parameters explain.
        left: what is left after p and A.
    """
    inverse = np.linalg.pinv(A.T @ A, hermitian=True)
    scores = block_sums(A * left[:, None], basis)
    scatter = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - 1)
    freedom = max(len(left) - basis.Q.shape[1] - A.shape[1], 1)
    white = inverse * float(left @ left) / freedom
    return np.sqrt(np.maximum(np.diag(scatter), np.diag(white)))


def block_sums(A: Columns, basis: Basis) -> Float[np.ndarray, "blocks columns"]:
    """Sums over stretches of time, of all drives together."""
    dof = len(basis.scale)
    samples = len(A) // dof
    sums = np.add.reduceat(A.reshape(dof, samples, -1), stretches(samples), axis=1)
    return sums.sum(axis=0)
