"""Drives whose torques work against their motion: the sign of a column is wrong, or their order.

Drive i's own rows of least squares, without prior and consistency, give the torque that it takes to
accelerate, M_ii at home, and to move at unit speed, f_i(1), both linear in p. In every machine both
are positive. A wrong sign of τ_i or q_i makes them negative, whatever the other drives do.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.information import Information
from deltaid.robot.description import RobotDescription

# A drive contradicts itself when the more certain of the two is negative by so many of its standard
# deviations. Right signs are some fifty on the other side.
_CERTAIN = 5.0

CURE = (
    "likeliest a column counts the other way: check the sign of these torques and positions, then "
    "the order of the columns; deltaid check finds which"
)


@dataclass(frozen=True)
class Negative:
    """A drive that contradicts itself: M_ii at home, f_i at unit speed (NaN without friction)."""

    drive: str
    inertia: float
    friction: float


def against_motion(dynamics: Dynamics, information: Information) -> tuple[Negative, ...]:
    """The drives whose torques work against their motion."""
    negatives = []
    for i, drive in enumerate(dynamics.robot.drives):
        e = np.eye(dynamics.dof)[i]
        at_rest, quick, forth, back = (
            row_at_home(dynamics, i, qd, qdd)
            for qd, qdd in ((0 * e, 0 * e), (0 * e, e), (e, 0 * e), (-e, 0 * e))
        )
        # Coriolis forces are the same both ways.
        probes = np.stack([quick - at_rest, 0.5 * (forth - back)])
        # Columns beside the robot come last, and are no part of either.
        added = max(0, int(information.columns[-1]) + 1 - probes.shape[1])
        probes = np.pad(probes, ((0, 0), (0, added)))[:, information.columns]
        problem = information.problem_of(i)
        values = probes @ problem.x
        stds = problem.noise * np.linalg.norm(probes @ problem.inverse, axis=1)
        certain = values / np.maximum(stds, np.finfo(float).tiny)
        if certain[np.argmax(np.abs(certain))] < -_CERTAIN:
            friction = float(values[1]) if np.any(probes[1]) else np.nan
            negatives.append(Negative(drive, float(values[0]), friction))
    return tuple(negatives)


def contradiction(negatives: tuple[Negative, ...], robot: RobotDescription) -> str:
    """What torques and motion of these drives say of each other, as a sentence."""
    first, names = negatives[0], ", ".join(negative.drive for negative in negatives)
    units = robot.units(first.drive)
    text = f"an inertia of {first.inertia:.2g} {units.inertia}"
    if np.isfinite(first.friction):
        text += f" and a friction of {first.friction:.2g} {units.force} at 1 {units.coordinate}/s"
    whose = f", for {first.drive}," if len(negatives) > 1 else ""
    return (
        f"torque and motion of {names} contradict each other: alone they give{whose} {text}, which "
        "no robot has"
    )


def row_at_home(
    dynamics: Dynamics, i: int, qd: Float[np.ndarray, " dof"], qdd: Float[np.ndarray, " dof"]
) -> Float[np.ndarray, " parameters"]:
    """The row c with c p = τ_i of a motion at home; without friction that depends on load."""
    home = dynamics.kinematics.home[None]
    return dynamics.regressor_at(home, qd[None], qdd[None], np.zeros_like(home))[0, i]
