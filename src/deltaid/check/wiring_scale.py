"""How large torques are beside those of the prior: the only yardstick for a scale that all share."""

import numpy as np
from jaxtyping import Float

from deltaid.check.wiring_residual import Residual
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters

# Below this share of the largest of a drive's torques a component is too small to be compared.
_SMALL = 0.1


def ratios(
    dynamics: Dynamics,
    found: Residual,
    p: Float[np.ndarray, " columns"],
    speeds: Float[np.ndarray, " drives"],
    accelerations: Float[np.ndarray, " drives"],
) -> list[list[float]]:
    """For each drive the torques of inertia, gravity and friction, estimated over expected.

    Args:
        p: least-squares values of the visible columns.
        speeds, accelerations: usual ones of each drive.
    """
    prior = prior_parameters(dynamics.robot)[found.columns]
    out = []
    for i in range(dynamics.dof):
        rows = _components(dynamics, i, found.columns, speeds[i], accelerations[i])
        told, expected = rows @ p, rows @ prior
        large = np.abs(expected) > _SMALL * np.abs(expected).max()
        out.append((told[large] / expected[large]).tolist())
    return out


def _components(
    dynamics: Dynamics, i: int, columns: np.ndarray, speed: float, acceleration: float
) -> Float[np.ndarray, "components columns"]:
    """Rows c with c p = torque of drive i at home for its inertia, gravity and friction."""
    zero, e = np.zeros(dynamics.dof), np.eye(dynamics.dof)[i]

    def row(qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        home = dynamics.kinematics.home[None]
        sparse = dynamics.sparse_regressor(home, qd[None], qdd[None], np.zeros_like(home))
        drives, entries = dynamics.regressor_pattern
        full, own = np.zeros(len(dynamics.layout.names)), drives == i
        full[entries[own]] = sparse.values[own, 0]
        return full[columns]

    still = row(zero, zero)
    inertia = row(zero, e) - still
    friction = 0.5 * (row(speed * e, zero) - row(-speed * e, zero))
    return np.stack([acceleration * inertia, still, friction])
