"""Zeros and tilt once more, beside all that a fit has put right and explains.

Before a fit, rows are as recorded and friction as described: clipped torques, a lag or another law
may look like a zero that is off. Their columns are compared with what is left of corrected and
masked torques beside all columns of the fit, on the rows that the fit took.
"""

from itertools import pairwise

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.wiring.homing import BLOCKS, Shifts
from deltaid.check.wiring.zeros import seen
from deltaid.identification.additions import extended
from deltaid.identification.fit import FittedProblem
from deltaid.identification.geometry import GeometricRows, geometric_rows
from deltaid.recording.recording import Recording
from deltaid.robot.tolerances import Tolerances

# What columns are made of [rad or m; rad], and singular values that count.
_SIZE, _DEPENDENT = 1e-3, 1e-9


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def still_seen(problem: FittedProblem, recording: Recording) -> bool:
    """Whether a zero or a tilt still explains what a fit leaves of a recording."""
    dynamics = problem.dynamics
    rows = geometric_rows(
        extended(dynamics, problem.additions),
        dynamics,
        recording,
        problem.p,
        np.sqrt(problem.information.drive_weights),
        Tolerances(lengths=0.0, homing=_SIZE, mounting=_SIZE),
    )
    return seen(_shifts(problem, rows))


def _shifts(problem: FittedProblem, rows: GeometricRows) -> Shifts:
    """What rows say of zeros and gravity; columns that torques do not show are zero."""
    robot = problem.dynamics.robot
    zeros = [f"zero of {drive}" for drive in robot.drives]
    tilts = [name for name in rows.names if name.startswith("tilt")]
    none = np.zeros(len(rows.tau))
    columns = dict(zip(rows.names, rows.D.T / _SIZE, strict=True))
    D = np.stack([columns.get(name, none) for name in (*zeros, *tilts)], axis=1)
    norms = np.linalg.norm(rows.Y, axis=0)
    U, s, _ = np.linalg.svd(rows.Y / np.where(norms > 0, norms, 1.0), full_matrices=False)
    Q = U[:, s > _DEPENDENT * s[0]]
    D, e = D - Q @ (Q.T @ D), rows.tau - Q @ (Q.T @ rows.tau)
    dof = len(zeros)
    count = len(e) // dof
    edges = np.linspace(0, count, BLOCKS + 1).astype(int)
    products = (D * e[:, None]).reshape(dof, count, -1).sum(axis=0)
    scores = np.stack([products[a:b].sum(axis=0) for a, b in pairwise(edges)])
    return Shifts(D.T @ D, scores, float(e @ e), len(e), dof, len(tilts))
