"""A robot at a pose that is asked for, and its readings as a small table; no window in here."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, Template

from deltaid.dynamics.at_rest import AtRest
from deltaid.view import style

State = Literal["good", "near", "over"]

# Share of a limit from which on it counts as near.
_NEAR = 0.8
_COLORS = {"good": style.RESIDUAL, "near": "#b59400", "over": style.LIMIT}
_DECIMALS = {"deg": 1, "m": 4, "N": 1}


@dataclass(frozen=True)
class DriveReading:
    """One drive: position [deg or m], torque or force that holds it [N m or N], and their units."""

    name: str
    position: float
    position_unit: str
    torque: float
    torque_unit: str


@dataclass(frozen=True)
class LimitReading:
    """Use of one limit, 1 at the limit, and what to think of it."""

    name: str
    share: float
    state: State


@dataclass(frozen=True)
class View:
    """The robot as it is shown.

    Attributes:
        z: where it stands [m; rad].
        wanted: the pose that was asked for; the same as z when the robot can stand there.
        drives, condition, limits: readings where it stands; limits in the order of the robot's.
        message: what is wrong: out of reach, or beyond limits; empty if nothing is.
    """

    z: Float[np.ndarray, " dof"]
    wanted: Float[np.ndarray, " dof"]
    drives: tuple[DriveReading, ...]
    condition: float
    limits: tuple[LimitReading, ...]
    message: str = ""

    @property
    def arrived(self) -> bool:
        """Whether the robot stands where it was asked to."""
        return bool(np.array_equal(self.z, self.wanted))


def home_view(robot: AtRest) -> View:
    """The robot at home."""
    return _standing(robot, robot.home)


def moved(robot: AtRest, view: View, wanted: Float[np.ndarray, " dof"]) -> View:
    """The view after asking for another pose.

    Out of reach the robot stays where it stood and the message says why. Beyond a limit it goes
    there all the same, and the message names the limits.
    """
    wanted = np.array(wanted, dtype=float)  # a copy: views do not change
    if not np.all(np.isfinite(wanted)):
        return _staying(view, wanted, "the pose is no number")
    if not robot(wanted[None]).stands[0]:
        return _staying(view, wanted, robot.why_not(wanted))
    return _standing(robot, wanted)


def _staying(view: View, wanted: Float[np.ndarray, " dof"], why: str) -> View:
    return replace(view, wanted=wanted, message=f"{why}; the robot stays where it was")


def _standing(robot: AtRest, z: Float[np.ndarray, " dof"]) -> View:
    poses, described = robot(z[None]), robot.robot
    drives = [
        DriveReading(
            name=name,
            position=units.per_shown * float(poses.q[0, i]),
            position_unit=units.shown,
            torque=float(poses.torque[0, i]),
            torque_unit=units.force,
        )
        for i, (name, units) in enumerate(described.drive_units.items())
    ]
    uses = [_limit(n, float(s)) for n, s in zip(robot.limits, poses.shares[0], strict=True)]
    over = [use.name for use in uses if use.state == "over"]
    return View(
        z=z,
        wanted=z,
        drives=tuple(drives),
        condition=float(poses.condition[0]),
        limits=tuple(uses),
        message=f"beyond {', '.join(over)}" if over else "",
    )


def _limit(name: str, share: float) -> LimitReading:
    state: State = "over" if share > 1 else "near" if share > _NEAR else "good"
    return LimitReading(name, share, state)


def panel(view: View) -> str:
    """HTML of a view's readings."""
    return _template().render(view=view, colors=_COLORS)


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("deltaid", "view"), autoescape=True, trim_blocks=True
    )
    environment.filters["reading"] = _reading
    return environment.get_template("panel.html.jinja")


def _reading(value: float, unit: str = "") -> str:
    """A number that does not jump: as many decimals whatever its size, and no zero with a sign."""
    digits = _DECIMALS.get(unit, 2)
    return f"{round(value, digits) + 0.0:.{digits}f} {unit}".rstrip()
