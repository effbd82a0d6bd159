"""A mechanism from a function of the user's own.

    def mechanism(z):                      # z: CasADi SX (x, y, z) or (x, y, z, ψ)
        …
        return deltaid.MechanismParts(drives=[q1, q2, q3], bodies=[…], joints={…})

Everything else, from Jacobians to the regressor, follows from what it returns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from deltaid.errors import DescriptionError
from deltaid.mechanism.mechanism_type import Mechanism, MovingBody
from deltaid.robot.description import RobotDescription
from deltaid.robot.own import FUNCTION, OwnMechanism, failure, function_of

# What depends on z is an SX; what does not may be a number.
Expression = ca.SX | ca.DM | np.ndarray | float


@dataclass(frozen=True)
class BodyPose:
    """One moving body of a mechanism.

    Attributes:
        name: a body of the description; several poses may share its ten parameters.
        rotation: R_WB from its link frame to the world, 3×3, function of z.
        origin: of its link frame in the world, 3, function of z [m].
        count: how many bodies share this very motion.
    """

    name: str
    rotation: Expression
    origin: Expression
    count: int = 1


@dataclass(frozen=True)
class MechanismParts:
    """What a function of the user's own returns; all CasADi expressions of z.

    Attributes:
        drives: drive coordinates q(z) [rad or m].
        bodies: poses of all moving bodies.
        joints: coordinates of the description's further joints by name [rad or m].
        reach: for each limb a distance by which z is inside its reach [m]; positive where the
            expressions above are finite. None says nothing about it.
        segments: (body, start, end) of lines to draw, world [m]; bodies' frames if there are none.
        turn_length: how far ψ moves the platform's parts [m/rad], to weigh ψ against lengths.
    """

    drives: Sequence[Expression]
    bodies: Sequence[BodyPose]
    joints: Mapping[str, Expression] = field(default_factory=dict)
    reach: Sequence[Expression] | None = None
    segments: Sequence[tuple[str, Expression, Expression]] = ()
    turn_length: float = 1.0


def build_own(robot: RobotDescription, own: OwnMechanism) -> Mechanism:
    """The mechanism of a description with a function of its own.

    Raises:
        DescriptionError: the function fails, or does not return what the description says.
    """
    n = len(own.drives)
    z, q_symbols = ca.SX.sym("z", n), ca.SX.sym("q", n)
    parts = _called(own, z)
    _require(robot, own, parts)
    q = ca.vertcat(*(ca.SX(drive) for drive in parts.drives))
    drives = {drive: q[i] for i, drive in enumerate(robot.drives)}
    bodies = tuple(
        MovingBody(b.name, b.count, np.eye(3), ca.SX(b.rotation), ca.SX(b.origin))
        for b in parts.bodies
    )
    free = ca.symvar(ca.vertcat(q, *[ca.vec(e) for b in bodies for e in (b.R_LB, b.r_LB)]))
    foreign = [s.name() for s in free if not any(ca.is_equal(s, z[i]) for i in range(n))]
    if foreign:
        raise _wrong(f"uses a symbol '{foreign[0]}' that is not an entry of z")
    return Mechanism(
        z=z,
        q=q,
        bodies=bodies,
        limbs=(),
        joints=drives | {name: ca.SX(parts.joints[name]) for name in own.joints},
        reach=ca.vertcat(*(ca.SX(x) for x in parts.reach)) if parts.reach else ca.SX(1.0),
        q_symbols=q_symbols,
        closure=q - q_symbols,
        modes=ca.SX(1.0),
        forward=None,
        lengths=(1.0, 1.0, 1.0, *([parts.turn_length] if n > 3 else [])),
        drawing=tuple((name, ca.SX(a), ca.SX(b)) for name, a, b in parts.segments),
    )


def _called(own: OwnMechanism, z: ca.SX) -> MechanismParts:
    function = function_of(own)
    try:
        parts = function(z)
    except DescriptionError:
        raise
    except Exception as error:  # whatever the user's code raises is told, not shown as our fault
        raise _wrong(f"fails: {failure(error, function.__code__.co_filename)}") from None
    if not isinstance(parts, MechanismParts):
        raise _wrong(f"returns {type(parts).__name__}, not a deltaid.MechanismParts")
    return parts


def _require(robot: RobotDescription, own: OwnMechanism, parts: MechanismParts) -> None:
    """Refuse what does not fit the description."""
    if len(parts.drives) != len(own.drives):
        raise _wrong(
            f"returns {len(parts.drives)} drives, but the description has {len(own.drives)}"
        )
    names = {body.name for body in parts.bodies}
    for kind, found, wanted in (
        ("body", names, set(robot.body_names)),
        ("joint", set(parts.joints), set(own.joints)),
    ):
        for name in sorted(wanted - found):
            raise _wrong(f"returns no {kind} '{name}', which the description has")
        for name in sorted(found - wanted):
            raise _wrong(f"returns a {kind} '{name}', which the description does not have")
    for body in parts.bodies:
        shapes = (ca.SX(body.rotation).shape, ca.SX(body.origin).shape)
        if shapes != ((3, 3), (3, 1)):
            raise _wrong(
                f"body '{body.name}' has a rotation of shape {shapes[0]} and an origin of shape "
                f"{shapes[1]}; they must be (3, 3) and (3, 1)"
            )


def _wrong(what: str) -> DescriptionError:
    return DescriptionError(what, where=f"{FUNCTION}(z)", cure="mend the Python file")
