"""The part of a fault that the model's parameters cannot explain."""

import numpy as np
from scipy.interpolate import make_interp_spline

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import KinematicsError
from faults.case import Case

# Number of rows at which the regressor is evaluated; the result is scaled to all rows.
_ROWS = 2500
# Share of its largest speed below which a joint is near its reversal.
_SLOW = 0.02


def shown(exact: Case, spoilt: Case) -> float:
    """‖(1 − Y Y⁺) τ‖ of a faulty recording without noise, each drive's torque in σ of its noise.

    This is the fault's size in standard deviations of its estimate, with all parameters unknown and
    white noise. Infinite if the recorded motion is impossible.
    """
    dynamics = compiled(exact.robot)
    t, q, tau = (exact.columns[name] for name in ("t", "q", "tau"))
    spline = make_interp_spline(t, q, k=5)
    every = np.unique(np.linspace(0, len(t) - 1, _ROWS).astype(int))
    rows = [x[every] for x in (q, spline(t, 1), spline(t, 2), tau)]
    # The time of a friction step is only known to a row or two, which would count as a fault.
    speeds = np.abs(spoilt.setting.truth.rates[every])
    moving = np.all(speeds > _SLOW * speeds.max(axis=0), axis=1)
    q, qd, qdd, tau = (x[moving] for x in rows)
    try:
        Y = dynamics.regressor(q, qd, qdd, tau)
    except KinematicsError:
        return np.inf
    sigma = spoilt.setting.noise * spoilt.setting.scale
    Y = (Y / sigma[:, None]).reshape(-1, Y.shape[-1])
    Y /= np.maximum(np.linalg.norm(Y, axis=0), 1e-300)
    left = tau / sigma
    p, *_ = np.linalg.lstsq(Y, left.ravel(), rcond=1e-10)
    return float(np.linalg.norm(left.ravel() - Y @ p) * np.sqrt(len(t) / len(every)))
