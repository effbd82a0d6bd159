"""Errors of an identification.

All errors are shares. For the mass matrix: the largest |ΔM_ij| / √(M_ii M_jj) over 40 poses. For
friction: the largest error of a drive's curve between 5 and 100 % of its speed, as a share of the
curve's largest value; with warm-up the true curve is the mean over the recording. No recording
distinguishes a torque sensor's offset from a constant of friction, so the error of friction's shape
is the smallest error with a free constant for each drive.
"""

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from deltaid.checks.identify import Judged as Identified
from deltaid.dynamics.parameters import parameter_layout
from deltaid.kernel.batch import BatchKernel
from deltaid.model.record import IdentifiedModel
from deltaid.robot.description import RobotDescription
from drives.happening import Happening
from drives.rows import Case
from oracle.tree import Array
from support import largest_mass_error

SPEEDS = np.linspace(0.05, 1.0, 40)


def mass_matrix_error(case: Case, result: Identified, factor: float = 1.0) -> float:
    """Error of M over the machine's poses, in drive coordinates of the description."""
    dynamics, machine = result.problem.dynamics, case.machine
    q = dynamics.kinematics.inverse(machine.poses)
    return largest_mass_error(factor * dynamics.mass_matrix(q, result.model.p), machine.M)


def mass_matrix_shape_error(case: Case, result: Identified) -> float:
    """Smallest error of M with a free factor: without a known load torques have no scale."""
    best = minimize_scalar(lambda factor: mass_matrix_error(case, result, factor),
                           bounds=(0.5, 2.0), method="bounded")  # fmt: skip
    return float(best.fun)


def friction_curve(robot: RobotDescription, p: Array, drive: str, v: Array, link: float) -> Array:
    """A drive's friction over speed, with a torque `link` that its gear carries."""
    speed, total = ca.SX.sym("v"), ca.SX(0)
    coefficients = p[parameter_layout(robot).friction].tolist()
    for term, coefficient in zip(robot.friction_terms, coefficients, strict=True):
        if term.joint == drive:
            total += coefficient * term.h(speed, ca.sign(speed), ca.SX(link))
    return BatchKernel(speed, total)(v[None])[0]


def friction_error(
    happening: Happening,
    model: IdentifiedModel,
    link: Array,
    gain: Array | float,
    offset: Array | float,
) -> float:
    """Friction error of the worst drive, with recorded torque = gain × true + offset."""
    gaps = _friction_gaps(happening, model, link, gain, offset)
    return max(float(np.max(np.abs(gap))) for gap in gaps)


def friction_shape_error(happening: Happening, model: IdentifiedModel, link: Array) -> float:
    """Friction error of the worst drive with a free constant for each drive."""
    return max(half_range(gap) for gap in _friction_gaps(happening, model, link, 1.0, 0.0))


def half_range(gap: Array) -> float:
    """The least of max |gap − c| over constants c."""
    return 0.5 * float(np.ptp(gap))


def _friction_gaps(
    happening: Happening,
    model: IdentifiedModel,
    link: Array,
    gain: Array | float,
    offset: Array | float,
) -> list[Array]:
    """Each drive's curve less the true one, as a share of the true curve's largest value."""
    law = happening.friction
    warm = 1 + law.warm * np.mean(np.exp(-happening.time / law.constant))
    v = np.concatenate([-SPEEDS[::-1], SPEEDS])[:, None] * happening.machine.largest_speed
    true = gain * warm * law.curve(v, link) + offset
    found = [
        friction_curve(model.robot, model.p, drive, v[:, i], float(link[i]))
        for i, drive in enumerate(happening.machine.robot.drives)
    ]
    return [(f - t) / np.max(np.abs(t)) for f, t in zip(found, true.T, strict=True)]


def curves_held(happening: Happening, model: IdentifiedModel) -> list[float]:
    """Share of points of each drive's curve whose intervals contain the truth, without friction
    that depends on load."""
    law = happening.friction
    warm = 1 + law.warm * np.mean(np.exp(-happening.time / law.constant))
    v = np.concatenate([-SPEEDS[::-1], SPEEDS])[:, None] * happening.machine.largest_speed
    true = warm * law.curve(v)
    shares = []
    for curve in model.friction_curves:
        if curve.joint in happening.machine.robot.drives:
            i = happening.machine.robot.drives.index(curve.joint)
            seen = (v[:, i] >= curve.speed[0]) & (v[:, i] <= curve.speed[-1])
            low, high = curve.band(v[seen, i])
            shares.append(float(np.mean((low <= true[seen, i]) & (true[seen, i] <= high))))
    return shares
