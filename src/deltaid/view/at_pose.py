"""A robot at a requested pose, with its readings as a small table, for any window."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.limits import AtRest
from deltaid.view import style
from deltaid.view.html import environment

# Share of a limit from which readings are coloured as near it.
_NEAR = 0.8
_COLORS = {"good": style.RESIDUAL, "near": "#b59400", "over": style.LIMIT}


@dataclass(frozen=True)
class DriveReading:
    """One drive: its position [deg or m], holding torque or force [N m or N], and their units."""

    name: str
    position: float
    position_unit: str
    torque: float
    torque_unit: str


@dataclass(frozen=True)
class View:
    """A displayed robot.

    Attributes:
        z: its pose [m; rad].
        drives, condition, limits: readings at this pose; `limits` is the used share of each limit
            by name, in the robot's order.
        message: why the requested pose is out of reach or beyond limits; empty otherwise.
    """

    z: Float[np.ndarray, " dof"]
    drives: tuple[DriveReading, ...]
    condition: float
    limits: Mapping[str, float]
    message: str = ""


def moved(robot: AtRest, view: View, wanted: Float[np.ndarray, " dof"]) -> View:
    """The view after a request for another pose.

    If the pose is out of reach, the robot keeps its pose and the message says why. If it is beyond
    a limit, the robot goes there nevertheless, and the message names the limits.
    """
    wanted = np.array(wanted, dtype=float)  # a copy, because views are immutable
    finite = bool(np.all(np.isfinite(wanted)))
    if finite and robot(wanted[None]).stands[0]:
        return standing(robot, wanted)
    why = robot.why_not(wanted) if finite else "the pose is no number"
    return replace(view, message=f"{why}; the robot stays where it was")


def standing(robot: AtRest, z: Float[np.ndarray, " dof"]) -> View:
    """The view of the robot at a pose where it stands, such as `robot.home`."""
    poses, units = robot(z[None]), robot.robot.drive_units
    drives = tuple(
        DriveReading(name, u.per_shown * q, u.shown, torque, u.force)
        for (name, u), q, torque in zip(
            units.items(), poses.q[0].tolist(), poses.torque[0].tolist(), strict=True
        )
    )
    limits = dict(zip(robot.limits, poses.shares[0].tolist(), strict=True))
    over = ", ".join(name for name, share in limits.items() if share > 1)
    return View(z, drives, float(poses.condition[0]), limits, f"beyond {over}" if over else "")


def panel(view: View) -> str:
    """HTML of a view's readings."""
    return (
        environment().get_template("panel.html.jinja").render(view=view, colors=_COLORS, near=_NEAR)
    )
