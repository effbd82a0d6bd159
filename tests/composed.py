"""Composed robots of random geometry and bodies, for the package and for the MuJoCo oracle."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from oracle.composed import ComposedOracle, Kind
from oracle.limb import LimbShape
from oracle.tree import Body, random_body

# Where a body's mass lies on average, in its link frame (m).
_CENTRES = {"U": (0.2, 0, 0), "S": (0.4, 0, 0), "TU": (0, 0, -0.3), "TL": (0, 0, 0.3)}
_PARTS: dict[Kind, tuple[str, ...]] = {
    "rigid": ("P",), "h4": ("SB", "MB", "EE"), "par4": ("MP", "R", "EE"), "i4": ("HP", "EE"),
}  # fmt: skip
_SQUARE, _STAR = np.deg2rad([45, -45, 135, -135]), np.deg2rad([0, 120, 240])


@dataclass(frozen=True)
class Make:
    """What a random robot is made of.

    Attributes:
        kind: its platform.
        linear: rails instead of motors and arms.
        tilt: range of the tilts, degrees.
        telescope: whether it has one.
        unequal: every limb with lengths and points of its own, in height too.
        own: every limb with bodies of its own.
        struts: per limb.
        inwards: the limbs that are in that working mode.
        springs: whether joints have one.
        clockwise: limbs follow one another clockwise, the first of them anywhere.
    """

    kind: Kind = "rigid"
    linear: bool = False
    tilt: tuple[float, float] = (0.0, 0.0)
    telescope: bool = False
    unequal: bool = False
    own: bool = False
    struts: int = 2
    inwards: tuple[int, ...] = ()
    springs: bool = True
    clockwise: bool = False


@dataclass(frozen=True, eq=False)
class ComposedTwin:
    """The same robot twice, its parameters p, and how it was made."""

    make: Make
    robot: RobotDescription
    oracle: ComposedOracle
    p: np.ndarray


@cache
def twin(make: Make, seed: int = 0) -> ComposedTwin:
    """A robot of the given make: generic geometry, bodies, friction, springs, rotors, gravity."""
    oracle = random_composed(make, np.random.default_rng(seed))
    return ComposedTwin(make, describe(oracle, make), oracle, parameters(oracle))


@cache
def dynamics(make: Make, seed: int = 0) -> Dynamics:
    """The package's dynamics of `twin(make, seed)`, compiled once."""
    return Dynamics(twin(make, seed).robot)


# Between the struts of a limb, where an oracle tells them apart [m].
SPACING = 0.6
# Robots in which the force of each single strut is told by the motion.
SINGLE = [
    Make(unequal=True, own=True),
    Make(telescope=True, unequal=True, tilt=(-10, 20)),
    Make(linear=True, tilt=(10, 30), inwards=(1,)),
    Make(kind="h4", own=True),
    Make(kind="h4", linear=True, unequal=True),
]


def label(make: Make) -> str:
    """For the name of a test."""
    drive = "linear" if make.linear else "rotary"
    return f"{make.kind}-{drive}{'-telescope' if make.telescope else ''}"


def random_composed(make: Make, rng: np.random.Generator) -> ComposedOracle:
    """An oracle of a metre-sized robot."""
    limbs = _random_limbs(make, rng)
    dof = 3 if make.kind == "rigid" and not make.telescope else 4
    joints = dof + (dof == 4)
    ratio = {"h4": 1.7, "par4": -3.0, "i4": 12.0}.get(make.kind, 1.0) * rng.uniform(0.9, 1.1)
    oracle = ComposedOracle(
        limbs=limbs,
        kind=make.kind,
        bodies={},
        struts_per_limb=make.struts,
        gravity=rng.uniform(-6, 6, 3) - [0, 0, 6],
        first=() if make.kind == "rigid" else (0, 1),
        half=0.0 if make.kind in ("rigid", "i4") else rng.uniform(0.07, 0.1),
        ratio=ratio,
        direction=np.deg2rad(90) + rng.uniform(-0.2, 0.2),
        tool=_tool(make, rng),
        telescope=(rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.03, 0.03, 3))
        if make.telescope
        else None,
        viscous=rng.uniform(0.5, 2, joints),
        coulomb=rng.uniform(1, 5, joints),
        stiffness=make.springs * rng.uniform(1, 20, joints),
        rest=rng.uniform(-0.3, 0.3, joints),
        rotor_inertia=rng.uniform(0.01, 0.1, dof),
    )
    return replace(oracle, bodies=random_bodies(oracle, rng))


def _tool(make: Make, rng: np.random.Generator) -> np.ndarray:
    """Tool axis from the platform point (m); on an H4 it lies on the axis of the middle bar."""
    place = rng.uniform(-0.1, 0.1, 3)
    return {"rigid": 0.0, "h4": np.array([0.0, 0.0, 1.0])}.get(make.kind, 1.0) * place


def _random_limbs(make: Make, rng: np.random.Generator) -> tuple[LimbShape, ...]:
    azimuths = _STAR if make.kind == "rigid" else _SQUARE
    azimuths = azimuths + rng.uniform(-0.25, 0.25, len(azimuths))
    if make.clockwise:
        azimuths = rng.uniform(-np.pi, np.pi) - azimuths
    radius, seat, arm, strut = rng.uniform((0.2, 0.05, 0.33, 0.75), (0.28, 0.08, 0.37, 0.85))
    if make.linear:  # so that struts on rails lean as much as those on arms
        radius += 0.05 if max(make.tilt) > 0 else 0.25
    limbs = []
    for i, azimuth in enumerate(azimuths):
        share, height = np.ones(4), np.zeros((2, 3))
        if make.unequal:
            share, height = rng.uniform(0.92, 1.08, 4), rng.uniform(-0.03, 0.03, (2, 3))
        outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        own = str(i + 1) if make.own else ""
        limbs.append(
            LimbShape(
                azimuth=azimuth,
                tilt=np.deg2rad(rng.uniform(*make.tilt)),
                base=share[0] * radius * outward + height[0],
                seat=share[1] * seat * outward + height[1],
                arm=None if make.linear else share[2] * arm,
                strut=share[3] * strut,
                outwards=i not in make.inwards,
                driven=("C" if make.linear else "U") + own,
                strut_body="S" + own,
            )
        )
    return tuple(limbs)


def body_names(oracle: ComposedOracle) -> tuple[str, ...]:
    """All bodies of a robot, in the order of p."""
    limbs = [name for limb in oracle.limbs for name in (limb.driven, limb.strut_body)]
    bar = ("TU", "TL", "EE") if oracle.telescope else ()
    return (*dict.fromkeys(limbs), *_PARTS[oracle.kind], *bar)


def random_bodies(oracle: ComposedOracle, rng: np.random.Generator) -> dict[str, Body]:
    """Generic bodies for all names of a robot."""
    bodies = {}
    for name in body_names(oracle):
        centre = _CENTRES.get(name if name in _CENTRES else name[:1], (0, 0, 0))
        bodies[name] = random_body(rng, rng.uniform(0.3, 1.5), 0.2, centre)
    return bodies


def joint_names(oracle: ComposedOracle) -> tuple[str, ...]:
    """The package's names of the joints with friction and springs, in the oracle's order."""
    drives = tuple(f"drive{i + 1}" for i in range(oracle.dof))
    own = {"rigid": ("slide",) if oracle.telescope else ()}.get(oracle.kind, ("platform",))
    return drives + own


def parameters(oracle: ComposedOracle) -> np.ndarray:
    """p: bodies, viscous, Coulomb, springs, rotors."""
    bodies = [body_parameters(oracle.bodies[name]) for name in body_names(oracle)]
    springs = oracle.stiffness[oracle.stiffness > 0]
    joints = (oracle.viscous, oracle.coulomb, springs, oracle.rotor_inertia)
    return np.concatenate([*bodies, *joints])


def body_parameters(body: Body) -> np.ndarray:
    """m, first moment, and the inertia tensor's entries xx yy zz xy yz xz."""
    I = np.asarray(body.inertia)
    return np.array([body.m, *body.mc, *np.diag(I), I[0, 1], I[1, 2], I[0, 2]])


def describe(oracle: ComposedOracle, make: Make) -> RobotDescription:
    """What a user would write about the oracle's robot."""
    joints = joint_names(oracle)
    springs = {}
    for joint, stiffness, rest in zip(joints, oracle.stiffness, oracle.rest, strict=True):
        if stiffness == 0:
            continue
        slides = joint == "slide" or (make.linear and joint in joints[: len(oracle.limbs)])
        slides |= joint == "platform" and make.kind == "i4"
        where = {"rest": rest} if slides else {"rest_deg": np.rad2deg(rest)}
        springs[joint] = {"stiffness": stiffness, **where}
    friction = zip(joints, oracle.viscous, oracle.coulomb, strict=True)
    data: dict[str, Any] = {
        "name": "composed",
        "gravity": tuple(oracle.gravity),
        "limbs": _describe_limbs(oracle, make),
        "platform": _describe_platform(oracle),
        "bodies": {
            name: {"prior": ExplicitInertia.from_parameters(body_parameters(body))}
            for name, body in oracle.bodies.items()
        },
        "friction": {j: {"viscous": v, "coulomb": c} for j, v, c in friction},
        "springs": springs,
        "rotor_inertia": dict(zip(joints, oracle.rotor_inertia, strict=False)),
        "workspace": {"shape": "box", "x": (-0.15, 0.15), "y": (-0.15, 0.15), "z": (-0.9, -0.7)},
    }
    if oracle.telescope:
        top, bottom = (tuple(point) for point in oracle.telescope)
        data["telescope"] = {"base_joint": top, "platform_joint": bottom}
    return RobotDescription.model_validate(data)


def _describe_limbs(oracle: ComposedOracle, make: Make) -> dict[str, Any]:
    limbs = oracle.limbs
    data: dict[str, Any] = {
        "drive": "linear" if make.linear else "rotary",
        "azimuth_deg": tuple(np.rad2deg(limb.azimuth) for limb in limbs),
        "tilt_deg": tuple(np.rad2deg(limb.tilt) for limb in limbs),
        "struts_per_limb": make.struts,
        "identical": not make.own,
        "working_mode": tuple("outwards" if limb.outwards else "inwards" for limb in limbs),
    }
    if make.unequal:
        data["base_points"] = tuple(tuple(limb.base) for limb in limbs)
        data["platform_points"] = tuple(tuple(limb.seat) for limb in limbs)
        data["strut"] = tuple(limb.strut for limb in limbs)
        arms = tuple(limb.arm for limb in limbs)
    else:
        data["base_radius"] = float(np.linalg.norm(limbs[0].base))
        data["platform_radius"] = float(np.linalg.norm(limbs[0].seat))
        data["strut"] = limbs[0].strut
        arms = limbs[0].arm
    return data if make.linear else data | {"upper_arm": arms}


def _describe_platform(oracle: ComposedOracle) -> dict[str, Any]:
    if oracle.kind == "rigid":
        return {"kind": "rigid"}
    middle, reach = turn(oracle)
    ends = np.rad2deg([middle - reach, middle + reach])
    data: dict[str, Any] = {
        "kind": oracle.kind,
        "first": tuple(limb + 1 for limb in oracle.first),
        "ratio": oracle.ratio,
        "tool": tuple(oracle.tool),
        "angle_deg": tuple(ends),
    }
    if oracle.kind == "h4":
        return data | {"half_length": oracle.half}
    if oracle.kind == "par4":
        return data | {"length": 2 * oracle.half}
    return data | {"direction_deg": float(np.rad2deg(oracle.direction))}


def turn(oracle: ComposedOracle) -> tuple[float, float]:
    """Middle and half range of the tool's angle (rad)."""
    if oracle.kind == "rigid":
        return 0.3, 3.0
    k = abs(oracle.ratio)
    return (k * 0.05, k * 0.1) if oracle.kind == "i4" else (k * 0.15, k * 0.4)


def random_states(
    oracle: ComposedOracle, rng: np.random.Generator, n: int
) -> tuple[np.ndarray, ...]:
    """z, q, qd, qdd of n random states, one a row, away from singularities of any sort."""
    middle, reach = turn(oracle)
    z = np.zeros((n, oracle.dof))
    for row in z:
        for _ in range(1000):
            row[:3] = rng.uniform((-0.2, -0.2, -0.95), (0.2, 0.2, -0.65))
            row[3:] = middle + reach * rng.uniform(-1, 1, oracle.dof - 3)
            reachable = np.isfinite(oracle.positions(row)).all()
            if reachable and oracle.well_posed(row) > 3e-3 and oracle.gain(row) < 4:
                break
        else:
            raise RuntimeError("no feasible state found for this geometry")
    qd, qdd = 2.0 * rng.standard_normal(z.shape), 10.0 * rng.standard_normal(z.shape)
    return z, oracle.positions(z), qd, qdd
