"""Where a robot of given lengths can work: a cylinder that it reaches all of."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.at_rest import AtRest
from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription

# Height of the cylinder over its radius; radii that are tried, as shares of the struts' length;
# directions and heights at which its rim is looked at.
_TALL, _SMALLEST, _STEP, _AROUND, _LEVELS = 0.7, 0.03, 0.96, 24, 5


@dataclass(frozen=True)
class Space:
    """A cylinder about world z [m]."""

    radius: float
    low: float
    high: float


def height(kind_is_linear: bool, lengths: dict[str, float]) -> float:
    """How far below the base the platform stands with arms 30° down, or carriages halfway [m].

    Raises:
        DeltaidError: the struts do not reach from there to the platform.
    """
    arm = lengths.get("arm", 0.0)
    if kind_is_linear:
        tilt, along = np.deg2rad(lengths["tilt"]), 0.5 * lengths["travel"]
        out, down = lengths["base_radius"] + along * np.sin(tilt), along * np.cos(tilt)
    else:
        angle = np.deg2rad(30.0)
        out, down = lengths["base_radius"] + arm * np.cos(angle), arm * np.sin(angle)
    wide = abs(out - lengths["platform_radius"])
    if lengths["strut"] <= 1.02 * wide:
        where = "with the carriages halfway" if kind_is_linear else "with the arms 30° down"
        raise DeltaidError(
            f"a strut of {1e3 * lengths['strut']:.4g} mm cannot reach the platform: {where} its "
            f"joints are {1e3 * wide:.4g} mm apart sideways alone",
            cure="a longer strut, a shorter arm, a smaller base or a larger platform",
        )
    return float(down + np.sqrt(lengths["strut"] ** 2 - wide**2))


def find_space(robot: RobotDescription, middle: float, strut: float) -> Space:
    """The widest cylinder about height −`middle` that lies within reach and limits at rest.

    Raises:
        DeltaidError: there is none.
    """
    from deltaid.dynamics.dynamics import compiled
    from deltaid.dynamics.prior import prior_parameters

    at_rest = AtRest(compiled(robot), prior_parameters(robot))
    radius = 0.8 * strut
    while radius > _SMALLEST * strut:
        for shift in (0.0, 0.1, -0.1, 0.2, -0.2):
            centre = -middle - shift * strut
            low = centre - 0.5 * _TALL * radius
            space = Space(radius, low, low + _TALL * radius)
            if space.high < 0 and _holds(at_rest, space):
                return _rounded(space)
        radius *= _STEP
    raise DeltaidError(
        "no place was found where the robot stands well: everywhere near the middle a limb is "
        "stretched, a joint is past its limit, or the robot is near a singularity",
        cure="check the four lengths; arms are mostly a third to a half of the struts",
    )


def _rounded(space: Space) -> Space:
    """To whole millimetres, inwards."""
    return Space(
        radius=float(np.floor(1e3 * space.radius)) / 1e3,
        low=float(np.ceil(1e3 * space.low)) / 1e3,
        high=float(np.floor(1e3 * space.high)) / 1e3,
    )


def _holds(robot: AtRest, space: Space) -> bool:
    """Whether the robot stands everywhere in the cylinder, within its own limits."""
    poses = robot(_points(robot, space))
    return bool(poses.stands.all() and (poses.shares[:, robot.of_workspace :] <= 1.0).all())


def _points(robot: AtRest, space: Space) -> Float[np.ndarray, "samples dof"]:
    """The cylinder's axis, rim and halfway between, with the tool's turn at its ends and middle."""
    angles = np.arange(_AROUND) * 2 * np.pi / _AROUND
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    flat = np.concatenate([np.zeros((1, 2)), 0.5 * circle, circle]) * space.radius
    levels = np.linspace(space.low, space.high, _LEVELS)
    points = np.array([[*xy, z] for xy in flat for z in levels])
    task = robot.robot.task
    if task.turn is None:
        return points
    turn = robot.robot.turn
    ends = (turn.low, 0.5 * (turn.low + turn.high), turn.high)
    if not robot.robot.platform_turns:
        ends = (0.0,)
    return np.concatenate([np.insert(points, 3, psi, axis=1) for psi in ends])
