"""What the tests of exports share: subjects, random states, and files compiled by a C compiler."""

import json
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from composed import Make, twin
from deltaid.dynamics.parameters import prior_parameters
from deltaid.mechanism.tree_joints import tree_coordinates
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import inertia_parameters, pseudo_inertia
from deltaid.robot.load import load_robot

CC = shutil.which("gcc") or shutil.which("cc")
needs_compiler = pytest.mark.skipif(CC is None, reason="there is no C compiler")
# Operations of graphs that every language has.
OF_ONE = (
    ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.cosh, ca.tanh, ca.asinh,
    ca.atanh, ca.exp, ca.expm1, ca.log, ca.log1p, ca.erf, ca.sqrt, ca.fabs, ca.floor, ca.ceil,
    ca.sign, ca.logic_not,
)  # fmt: skip
OF_TWO = (
    ca.atan2, ca.power, ca.hypot, ca.fmod, ca.remainder, ca.fmin, ca.fmax, ca.copysign,
    ca.logic_and, ca.logic_or, ca.lt, ca.le, ca.eq, ca.ne,
)  # fmt: skip
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")


@cache
def subject(name: str) -> Model:
    """A catalogue robot whose bodies have no symmetry left: the prior, every entry disturbed.

    After a slash, what part of its platform carries the tool, which then stands beside it.
    """
    robot = load_robot(name.partition("/")[0])
    carrier = name.partition("/")[2]
    if carrier:
        changed = {"tool_on": carrier, "tool": (0.03, -0.02, 0.05)}
        robot = robot.changed(platform=robot.platform.changed(**changed))
    return disturbed(robot)


def disturbed(robot: RobotDescription) -> Model:
    """A robot with generic parameters near its prior."""
    rng, p = np.random.default_rng(7), prior_parameters(robot)
    p[10 * len(robot.body_names) :] *= rng.uniform(0.8, 1.25, p.size - 10 * len(robot.body_names))
    for i in range(len(robot.body_names)):
        body = p[10 * i : 10 * i + 10]
        M = pseudo_inertia(body) + body[0] * np.diag([9e-4, 1.2e-3, 1.5e-3, 0])
        M[:3, 3] += 0.01 * body[0] * rng.uniform(-1, 1, 3)
        M[3, :3] = M[:3, 3]
        A = np.eye(4)  # a body that is turned and stretched stays one
        A[:3, :3] += 0.1 * rng.uniform(-1, 1, (3, 3))
        body[:] = inertia_parameters(A @ M @ A.T)
    offsets = p == 0
    p[offsets] = rng.uniform(-1, 1, offsets.sum())  # of friction
    return Model(robot, p, robot.name)


def with_friction(drive: str, **more: object) -> Model:
    """Clavel's Delta with further terms of one drive's friction."""
    robot = load_robot("clavel-delta3")
    law = robot.friction[drive].changed(**more)
    return disturbed(robot.changed(friction=robot.friction | {drive: law}))


def every_friction_term() -> Model:
    """A linear Delta with all laws of friction, those that depend on load included."""
    data = load_robot("linear-delta").model_dump(mode="json", exclude_none=True)
    data["friction"]["drive1"] |= {"power": {"coefficient": 2.0, "exponent": 0.6}, "load": 0.1}
    data["friction"]["drive2"] |= {"viscous_back": 3.0, "coulomb_back": 4.0, "load": 0.05}
    data["friction"]["drive3"] |= {"stribeck": {"coefficient": 2.0, "speed": 2.0}, "offset": 1.0}
    return disturbed(RobotDescription.model_validate_json(json.dumps(data)))


def states(subject: Model, n: int, seed: int = 0, share: float = 0.7) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ of n random states in the workspace, one a row, all drives within their range."""
    kinematics, rng, rows = subject.dynamics.kinematics, np.random.default_rng(seed), []
    centre, half = subject.robot.workspace.inner_box
    turn = subject.robot.turn
    while len(rows) < n:
        r = centre + share * half * rng.uniform(-1, 1, 3)
        psi = share * rng.uniform(turn.low, turn.high, kinematics.dof - 3)
        z = np.append(r, psi)
        if kinematics.condition(z[None])[0] < 10 and _in_range(
            subject, kinematics.inverse(z[None])[0]
        ):
            rows.append(z)
    z = np.array(rows)
    q = kinematics.inverse(z)
    return z, q, 2.0 * rng.standard_normal(z.shape), 10.0 * rng.standard_normal(z.shape)


def floats(x: np.ndarray) -> np.ndarray:
    """Numbers of single precision."""
    return x.astype(np.float32).astype(float)


# Conditions of poses towards singularities, from one to another.
CONDITIONS = ((1, 10), (10, 30), (30, 100))


def of_home_branch(subject: Model, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Those of n poses z of the workspace and beyond on home's branch, and their conditions."""
    kinematics, rng, turn = (
        subject.dynamics.kinematics,
        np.random.default_rng(5),
        subject.robot.turn,
    )
    centre, half = subject.robot.workspace.inner_box
    r = centre + 2.5 * half * rng.uniform(-1, 1, (n, 3))
    psi = rng.uniform(turn.low, turn.high, (n, kinematics.dof - 3))
    z = floats(np.hstack([r, psi]))
    found, home = kinematics.regularity(z), kinematics.regularity(kinematics.home[None])
    side = np.sign(found.determinant) == np.sign(home.determinant)
    return z[side], found.condition[side]


def towards_singularities(subject: Model, each: int) -> np.ndarray:
    """Poses z of the workspace and beyond where the condition is 1 to 10, to 30 and to 100."""
    z, condition = of_home_branch(subject, 20_000)
    parts = [z[(low <= condition) & (condition < high)][: 2 * each] for low, high in CONDITIONS]
    return np.vstack([part[[_reached(subject, row) for row in part]][:each] for part in parts])


def _reached(subject: Model, z: np.ndarray) -> bool:
    """Whether z is the pose that Python finds, of its drives' coordinates as floats."""
    kinematics = subject.dynamics.kinematics
    again, good = kinematics.forward_unchecked(floats(kinematics.inverse(z[None])))
    return bool(good[0]) and np.abs(again[0] - z).max() < 1e-4


def _in_range(subject: Model, q: np.ndarray) -> bool:
    for drive, x in zip(subject.robot.drives, q, strict=True):
        limits = subject.robot.drive_limits.get(drive)
        if limits and limits.range and not limits.range[0] < x < limits.range[1]:
            return False
    return True


@dataclass(frozen=True)
class Evaluated:
    """τ and the terms of (1) at some samples, by CasADi's own evaluator."""

    tau: np.ndarray
    M: np.ndarray
    bias: np.ndarray
    g: np.ndarray

    @property
    def acceleration(self) -> np.ndarray:
        """q̈ that M q̈ + bias = τ has."""
        return np.linalg.solve(self.M, (self.tau - self.bias)[..., None])[..., 0]


def model(subject: Model, z: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Evaluated:
    """The package's answers, with friction in the bias C q̇ + g + f."""
    rows = [_terms(subject)(*row, subject.p) for row in zip(z, qd, qdd, strict=True)]
    tau, M, bias, g = (np.array([np.array(x) for x in part]) for part in zip(*rows, strict=True))
    return Evaluated(tau[..., 0], M, bias[..., 0], g[..., 0])


def at_home(subject: Model) -> Evaluated:
    """At rest in the home pose."""
    home = subject.home[None]
    return model(subject, home, np.zeros_like(home), np.zeros_like(home))


def dry_friction(subject: Model) -> np.ndarray:
    """Coulomb's coefficient of each drive."""
    return np.array([subject.value(f"coulomb.{drive}") for drive in subject.robot.drives])


def total_mass(subject: Model) -> float:
    """Of all that moves."""
    bodies = subject.dynamics.kinematics.mechanism.bodies
    return sum(body.count * subject.body(body.name)[0] for body in bodies)


@lru_cache(maxsize=2)
def _terms(subject: Model) -> ca.Function:
    e = subject.dynamics.equations
    out = [e.torque, e.M, e.C @ e.qd + e.g + e.f, e.g]
    return ca.Function("terms", [e.z, e.qd, e.qdd, e.p], out)


@dataclass(frozen=True)
class TreeMotion:
    """Coordinates, rates and accelerations of a tree's joints, and ∂(rates)/∂q̇."""

    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    partial: np.ndarray


def tree_motion(
    subject: Model, names: Sequence[str], state: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> TreeMotion:
    """How the closed robot moves the joints of its tree, in the order of `names`.

    `state` is one sample's z, q̇, q̈.
    """
    kinematics, (z, qd, qdd) = subject.dynamics.kinematics, state
    J = kinematics.jacobian(z[None])[0]
    zd = np.linalg.solve(J, qd)
    zdd = np.linalg.solve(J, qdd - kinematics.jacobian_rate(z[None], zd[None])[0] @ zd)
    values = _coordinates(subject, tuple(names))(z, zd)
    position, partial, bend = (np.array(value) for value in values)
    return TreeMotion(
        position.ravel(), partial @ zd, partial @ zdd + bend.ravel(), partial @ np.linalg.inv(J)
    )


@lru_cache(maxsize=2)
def _coordinates(subject: Model, names: tuple[str, ...]) -> ca.Function:
    """Joints' coordinates x(z), ∂x/∂z, and what is left of ẍ where z̈ is zero."""
    mechanism = subject.dynamics.kinematics.mechanism
    coordinates, z = tree_coordinates(subject.robot, mechanism), mechanism.z
    x, zd = ca.vertcat(*[coordinates[name] for name in names]), ca.SX.sym("zd", z.numel())
    slope = ca.jacobian(x, z)
    return ca.Function("x", [z, zd], [x, slope, ca.jtimes(slope @ zd, z, zd)])


def configuration(tree: Any, coordinates: dict[str, float]) -> np.ndarray:
    """Of a tree in Pinocchio, which writes joints without limits as cosine and sine."""
    q = np.zeros(tree.nq)
    for name, x in coordinates.items():
        joint = tree.joints[tree.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
    return q


def composed(make: Make) -> Model:
    """A composed robot of random geometry, bodies, springs and rotors."""
    found = twin(make)
    return Model(found.robot, found.p, "composed")


# Limbs of all sorts: unequal, tilted, upside-down working modes, bodies of their own.
COMPOSED = (
    Make(telescope=True, unequal=True, tilt=(-20, 20), own=True),
    Make(linear=True, unequal=True, tilt=(-40, 40), inwards=(1,), struts=1),
    Make("par4", linear=True, unequal=True, tilt=(-15, 15)),
    Make("i4", unequal=True, own=True),
)


TOOLS = ("h4/first", "h4-linear/second", "par4/middle", "i4/first", "i4-linear/second")


def the(case: str | Make) -> Model:
    """A catalogue robot with generic bodies, or a composed one."""
    return subject(case) if isinstance(case, str) else composed(case)


def title(case: str | Make) -> str:
    """Of a test of such a case."""
    return case if isinstance(case, str) else f"composed-{case.kind}"


def compiled(source: Path, library: Path, *options: str) -> Path:
    """A shared library from one C file, every warning an error."""
    assert CC is not None
    command = [CC, *STRICT, *options, "-shared", "-fPIC", "-o", library, source, "-lm"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return library
