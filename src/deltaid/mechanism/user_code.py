"""A mechanism from a user's function in a Python file, which runs only when the user names it.

    def mechanism(z):                      # z: CasADi SX (x, y, z) or (x, y, z, ψ)
        …
        return deltaid.MechanismParts(drives=[q1, q2, q3], bodies=[…], joints={…})

Everything else, from Jacobians to the regressor, follows from what it returns.
"""

import hashlib
import pathlib
import runpy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from deltaid.errors import DescriptionError, quoted
from deltaid.files import readable
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.own_checks import Checker
from deltaid.mechanism.rotation import Path, Rotation, along
from deltaid.mechanism.speeds import Speed, Speeds
from deltaid.robot.description import RobotDescription
from deltaid.robot.own import NamedFile, OwnMechanism, file_of, name_file, named_file

# Values that depend on z are SX; constants may be numbers.
Expression = ca.SX | ca.DM | np.ndarray | float

# Body name of fixed segments.
BASE = "base"
# Name of the function in the user's file.
FUNCTION = "mechanism"


def use_mechanism(path: str | pathlib.Path) -> str:
    """Run a Python file that defines `mechanism(z)`, for descriptions with a mechanism of the user.

    Returns its SHA-256, by which descriptions and models identify the file.

    Raises:
        DescriptionError: the file cannot be read or run, or does not define the function.
    """
    path = pathlib.Path(path)
    with readable(path, DescriptionError):
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    try:
        function = runpy.run_path(str(path)).get(FUNCTION)
    except (Exception, SystemExit) as error:  # errors of the user's code
        raise DescriptionError(
            f"fails: {failure(error, path)}",
            where=str(path),
            cure="run it alone, as `python FILE.py`, to see the whole traceback",
        ) from None
    if not callable(function):
        raise DescriptionError(
            f"defines no function `{FUNCTION}`",
            where=str(path),
            cure=f"write `def {FUNCTION}(z):` that returns a deltaid.MechanismParts",
        )
    name_file(NamedFile(str(path), digest, function))
    return digest


def named_path() -> pathlib.Path | None:
    """Path of the Python file that the user has named, if any."""
    file = named_file()
    return pathlib.Path(file.path) if file else None


def failure(error: BaseException, path: str | pathlib.Path = "") -> str:
    """An exception of the user's code in one line: line number, kind and message."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if not path or trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}, "
        trace = trace.tb_next
    text = quoted(str(error).strip().split("\n", 1)[0])
    return f"{line}{type(error).__name__}: {text}"


@dataclass(frozen=True)
class BodyPose:
    """One moving body of a mechanism.

    Attributes:
        name: a body of the description; several poses may share its ten parameters.
        rotation: R_WB from its link frame to the world, 3×3, function of z.
        origin: of its link frame in the world, 3, function of z [m].
        count: number of bodies that share this motion.
    """

    name: str
    rotation: Expression
    origin: Expression
    count: int = 1


@dataclass(frozen=True)
class MechanismParts:
    """Result of a user's mechanism function; all CasADi expressions of z.

    Attributes:
        drives: drive coordinates q(z) [rad or m].
        bodies: poses of all moving bodies.
        joints: coordinates of the description's additional joints by name [rad or m].
        reach: for each limb a distance by which z is inside its reach [m]; positive where the
            expressions above are finite. None sets no limit.
        segments: (body, start, end) of lines to draw, world [m], "base" for fixed lines; without
            any, lines from bodies' frames to their centres of mass.
        turn_length: how far ψ moves the platform's parts [m/rad], to weigh ψ against lengths.
    """

    drives: Sequence[Expression]
    bodies: Sequence[BodyPose]
    joints: Mapping[str, Expression] = field(default_factory=dict)
    reach: Sequence[Expression] | None = None
    segments: Sequence[tuple[str, Expression, Expression]] = ()
    turn_length: float = 1.0


def build_own(robot: RobotDescription, own: OwnMechanism) -> Mechanism:
    """The mechanism of a description with a user's function.

    Raises:
        DescriptionError: the function fails; or its result does not fit the description, is not
            finite, is no rigid motion, or has drives that do not determine z in the middle of the
            workspace.
    """
    n = len(own.drives)
    z, q_symbols = ca.SX.sym("z", n), ca.SX.sym("q", n)
    file = file_of(own, "mechanism")
    check = Checker(f"{file.path}, {FUNCTION}(z)", z)
    parts = _called(file, z, check)
    _require(robot, own, parts, check)
    q = ca.vertcat(*(check.scalar(d, f"drive {i + 1}") for i, d in enumerate(parts.drives)))
    J, drives, task = ca.jacobian(q, z), Speed.named("qd", n), Speed.named("zd", n)
    # J ż = q̇ and J z̈ = q̈ − J̇ ż, with no speeds but those of drives and z
    change = -ca.jtimes(J @ task.u, z, task.u)
    speeds = Speeds(drives, task, Speed.named("w", 0), J, ca.SX.eye(n), change)
    motion = Path(z, speeds.z.u, speeds.z.ud)
    bodies = tuple(_body(body, motion, check) for body in parts.bodies)
    joints = {name: check.scalar(parts.joints[name], f"joint '{name}'") for name in own.joints}
    turn: Any = parts.turn_length  # whatever the user's function gives
    if not isinstance(turn, int | float | np.number) or not 0 < turn < np.inf:
        raise check.wrong(f"turn_length is {turn!r}; it must be a positive number")
    lengths = tuple(float(turn) if name == "psi" else 1.0 for name in own.task.names)
    mechanism = Mechanism(
        z=z,
        q=q,
        speeds=speeds,
        bodies=bodies,
        limbs=(),
        platform=(),
        telescope=(),
        joints={drive: q[i] for i, drive in enumerate(robot.drives)} | joints,
        reach=_reach(parts, check),
        q_symbols=q_symbols,
        middles=(None,) * n,
        closure=q - q_symbols,
        modes=ca.SX(1.0),
        forward=None,
        lengths=lengths,
        drawing=tuple(_segment(line, robot, check) for line in parts.segments),
    )
    check.motion(mechanism, robot)
    return mechanism


def _called(file: NamedFile, z: ca.SX, check: Checker) -> MechanismParts:
    try:
        parts = file.function(z)
    except DescriptionError:
        raise
    except (Exception, SystemExit) as error:  # errors of the user's code
        raise check.wrong(f"fails: {failure(error, file.path)}") from None
    if not isinstance(parts, MechanismParts):
        raise check.wrong(f"returns {type(parts).__name__}, not a deltaid.MechanismParts")
    return parts


def _require(
    robot: RobotDescription, own: OwnMechanism, parts: MechanismParts, check: Checker
) -> None:
    for name in ("drives", "bodies", "segments"):
        check.kind(getattr(parts, name), Sequence, name, "a list")
    check.kind(parts.joints, Mapping, "joints", "a dict")
    for i, body in enumerate(parts.bodies):
        check.kind(body, BodyPose, f"entry {i + 1} of bodies", "a deltaid.BodyPose")
    if len(parts.drives) != len(own.drives):
        raise check.wrong(
            f"returns {len(parts.drives)} drives, but the description has {len(own.drives)}"
        )
    check.names("body", [body.name for body in parts.bodies], robot.body_names)
    check.names("joint", list(parts.joints), tuple(own.joints))


def _body(body: BodyPose, z: Path, check: Checker) -> MovingBody:
    """Motion of a body by differentiating its pose: the skew matrix RᵀṘ holds ω."""
    what = f"body '{body.name}'"
    rotation = check.expression(body.rotation, f"the rotation of {what}")
    origin = check.expression(body.origin, f"the origin of {what}")
    if (rotation.shape, origin.shape) != ((3, 3), (3, 1)):
        raise check.wrong(
            f"{what} has a rotation of shape {rotation.shape} and an origin of shape "
            f"{origin.shape}; they must be (3, 3) and (3, 1)"
        )
    count: Any = body.count
    if not isinstance(count, int) or count < 1:
        raise check.wrong(f"{what} has the count {count!r}; it must be 1, 2, …")
    J_w = ca.horzcat(*(_turning(rotation, z.at[i]) for i in range(z.at.numel())))
    w = J_w @ z.rate
    spin = Rotation(rotation, w, J_w @ z.acceleration + ca.jtimes(w, z.at, z.rate))
    return MovingBody(body.name, body.count, np.eye(3), spin, along(origin, z))


def _turning(R: ca.SX, z: ca.SX) -> ca.SX:
    """Angular velocity of R in its own frame, for ż = 1."""
    W = R.T @ ca.reshape(ca.jacobian(ca.vec(R), z), 3, 3)
    return ca.sparsify(ca.vertcat(W[2, 1], W[0, 2], W[1, 0]))


def _reach(parts: MechanismParts, check: Checker) -> ca.SX:
    if parts.reach is None:
        return ca.SX(1.0)
    check.kind(parts.reach, Sequence, "reach", "a list")
    values = [check.scalar(x, f"entry {i + 1} of reach") for i, x in enumerate(parts.reach)]
    return ca.vertcat(*values) if values else ca.SX(1.0)


def _segment(line: object, robot: RobotDescription, check: Checker) -> tuple[str, ca.SX, ca.SX]:
    if not isinstance(line, tuple | list) or len(line) != 3:
        raise check.wrong("has an entry of segments that is not (body, start, end)")
    name, *ends = line
    if name not in (*robot.body_names, BASE):
        raise check.wrong(f"has a segment of '{name}', which is neither a body nor '{BASE}'")
    start, end = (check.expression(end, f"a segment of body '{name}'") for end in ends)
    if (start.shape, end.shape) != ((3, 1), (3, 1)):
        raise check.wrong(f"has a segment of body '{name}' whose ends are not points of shape 3")
    return name, start, end
