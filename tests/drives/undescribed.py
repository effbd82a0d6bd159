"""Forces that a description lacks, and robots that differ from their description."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.robot.inertia import inertia_parameters, pseudo_inertia
from drives.made import Made
from drives.pulls import Balancer, BallJoints, Cable, Hose
from drives.robots import Machine
from drives.rows import unit
from oracle.tree import Array, Body
from plants import bodies_of, log_uniform

# Strut length of the IRB 360 class (m); standard deviation of a mass from the line of an arm (m).
_STRUT, _ASIDE = 1.18, 0.02
# Distance of a body's centre from its axis, for arms and tools, and for all others (m); least and
# largest rotation of its axes of inertia (degrees).
_HEAVY, _SLENDER, _TURNED = 4e-3, 1e-3, (0.2, 2.0)


def _way(rng: np.random.Generator) -> Array:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def force(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A constant force at the platform (N), in a random direction."""
    way = _way(rng)
    pull = Hose(size * unit(made.machine) * way, 0.0, 0.0, np.zeros(3))
    return made.but(f"{size:.2g} N along {np.round(way, 2).tolist()}",
                    pulls=(*made.happening.pulls, pull))  # fmt: skip


def _stiffness(m: Machine, size: float) -> float:
    """Stiffness of a spring at the platform, in proportion to the robot (N/m)."""
    return size * unit(m) / (m.robot.limbs.geometry()[0].strut / _STRUT)


def spring(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A spring at the platform (N/m), relaxed at a random place above the motion's middle."""
    m = made.machine
    path = m.plant.path[:, :3]
    middle, half = path.mean(axis=0), 0.5 * np.ptp(path, axis=0)
    rest = middle + half * rng.uniform(-1, 1, 3)
    rest[2] = middle[2] * (1 - 0.5 * rng.uniform())
    pull = Hose(np.zeros(3), 0.0, _stiffness(m, size), rest)
    return made.but(f"spring {size:.2g} N/m", pulls=(*made.happening.pulls, pull))


def hose(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A constant force (N), a drag of 20 to 60 % of it, and a spring with ten times its number in
    N/m."""
    m, way, drag = made.machine, _way(rng), float(rng.uniform(0.2, 0.6) * size)
    pull = Hose(size * unit(m) * way, drag * unit(m), _stiffness(m, 10 * size),
                m.plant.path[:, :3].mean(axis=0))  # fmt: skip
    words = (f"hose {size:.2g} N along {np.round(way, 2).tolist()}, drag {drag:.2g} N, "
             f"{10 * size:.2g} N/m")  # fmt: skip
    return made.but(words, pulls=(*made.happening.pulls, pull))


def cable(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A cable that pulls with a force (N) in the motion's middle, from one to two lengths of a
    strut above; its stiffness has six times this number in N/m."""
    m, way = made.machine, _way(rng)
    way[2] = abs(way[2])
    length = float(rng.uniform(1.0, 2.0)) * m.robot.limbs.geometry()[0].strut
    stiffness = _stiffness(m, 6 * size)
    pull = Cable(m.plant.path[:, :3].mean(axis=0) + length * way, stiffness,
                 length - size * unit(m) / stiffness)  # fmt: skip
    return made.but(f"cable of {length:.2g} m along {np.round(way, 2).tolist()}",
                    pulls=(*made.happening.pulls, pull))  # fmt: skip


def ball_joints(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Dry friction of the ball joints at both ends of the struts (N m at each end of a limb of the
    IRB 360 class); at the platform it is 0.7 to 1.4 times that on the arm."""
    m, other = made.machine, log_uniform(rng, 0.7, 1.4)
    moment = size * unit(m) * m.robot.limbs.geometry()[0].strut / _STRUT
    pulls = (*made.happening.pulls, BallJoints(m.plant.oracle, moment, other * moment))
    return made.but(f"ball joints of {moment:.2g} and {other * moment:.2g} N m", pulls=pulls)


def balancer(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A spring at every drive, with at most a share of its largest torque."""
    m = made.machine
    q = m.plant.oracle.positions(m.plant.path[::8])
    middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
    rest = middle + half * rng.uniform(-1, 1, m.dof)
    stiffness = size * m.largest_torque / np.abs(q - rest).max(axis=0)
    pulls = (*made.happening.pulls, Balancer(stiffness, rest))
    return made.but(f"balancers of {size:.1%} of the torque", pulls=pulls)


def long_limb(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The arm or the strut of one limb is longer than described (m)."""
    oracle = made.machine.plant.oracle
    limbs, k = list(oracle.limbs), int(rng.integers(len(oracle.limbs)))
    arm = limbs[k].arm
    if arm is not None and rng.uniform() < 0.5:
        limbs[k], part = replace(limbs[k], arm=arm + size), "arm"
    else:
        limbs[k], part = replace(limbs[k], strut=limbs[k].strut + size), "strut"
    words = f"{part} of limb {k + 1} {1e3 * size:.2g} mm longer"
    return made.with_oracle(words, replace(oracle, limbs=tuple(limbs)))


def mounting(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The base point of one limb is off by a length (m) in any direction, and its axis or rail is
    turned about the vertical by four milliradians a millimetre."""
    oracle = made.machine.plant.oracle
    limbs, k = list(oracle.limbs), int(rng.integers(len(oracle.limbs)))
    way, turn = rng.standard_normal(3), 4.0 * size * rng.choice([-1.0, 1.0])
    base = limbs[k].base + size * way / np.linalg.norm(way)
    limbs[k] = replace(limbs[k], base=base, azimuth=limbs[k].azimuth + turn)
    words = f"base of limb {k + 1} {1e3 * size:.2g} mm off, turned by {1e3 * turn:.2g} mrad"
    return made.with_oracle(words, replace(oracle, limbs=tuple(limbs)))


def heavy_limb(made: Made, rng: np.random.Generator, size: float) -> Made:
    """One limb's arm or carriage carries a point mass, a share of its own mass."""
    oracle = made.machine.plant.oracle
    limbs, k = list(oracle.limbs), int(rng.integers(len(oracle.limbs)))
    body, reach = oracle.bodies[limbs[k].driven], rng.uniform(0.3, 1.0) * (limbs[k].arm or 0.0)
    mass, r = size * body.m, np.array([reach, 0.0, 0.0]) + _ASIDE * rng.standard_normal(3)
    more = Body(body.m + mass, body.mc + mass * r,
                body.inertia + mass * (r @ r * np.eye(3) - np.outer(r, r)))  # fmt: skip
    limbs[k] = replace(limbs[k], driven="heavier")
    bodies = oracle.bodies | {"heavier": more}
    words = f"{size:.0%} of its mass more on the driven body of limb {k + 1}"
    return made.with_oracle(words, replace(oracle, bodies=bodies, limbs=tuple(limbs)))


def tilt(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The base is tilted about a random horizontal axis (degrees)."""
    oracle, about = made.machine.plant.oracle, rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    gravity = Rotation.from_rotvec(np.deg2rad(size) * axis).apply(oracle.gravity)
    return made.with_oracle(f"tilt {size:.2g}°", replace(oracle, gravity=gravity))


def lengths(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Normal errors of all limbs' arms and struts, with this standard deviation (m)."""
    oracle = made.machine.plant.oracle
    limbs = tuple(
        replace(
            limb,
            arm=None if limb.arm is None else limb.arm + size * rng.standard_normal(),
            strut=limb.strut + size * rng.standard_normal(),
        )
        for limb in oracle.limbs
    )
    return made.with_oracle(f"lengths {1e3 * size:.2g} mm off", replace(oracle, limbs=limbs))


def asymmetric(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Bodies that deviate from the symmetry in `free`, by `size` times usual amounts.

    Centres are off the bodies' long axes, and axes of inertia are turned about the centre.
    """
    return _off_shape(made, rng, size, about_centre=True)


def askew(made: Made, rng: np.random.Generator, size: float) -> Made:
    """As `asymmetric`, but bodies are turned about their joints, so centres move with the axes."""
    return _off_shape(made, rng, size, about_centre=False)


def _off_shape(made: Made, rng: np.random.Generator, size: float, about_centre: bool) -> Made:
    m = made.machine
    layout, prior, p = parameter_layout(m.robot), prior_parameters(m.robot), m.plant.p.copy()
    turned = list[str]()
    for body in layout.bodies:
        part = layout.body(body)
        axis = int(np.argmax(np.diag(pseudo_inertia(prior[part]))[:3]))
        across = np.delete(np.eye(3), axis, axis=0).T @ _around(rng)
        shift = size * (_HEAVY if body in ("U", "C", "EE") else _SLENDER) * across
        angle = size * float(rng.uniform(*_TURNED))
        pivot = p[part][1:4] / p[part][0] if about_centre else np.zeros(3)
        turn = Rotation.from_rotvec(np.deg2rad(angle) * _way(rng)).as_matrix()
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turn, pivot + shift - turn @ pivot
        p[part] = inertia_parameters(T @ pseudo_inertia(p[part]) @ T.T)
        turned.append(f"{body} {angle:.1f}°")
    oracle = replace(m.plant.oracle, bodies=bodies_of(m.robot, p))
    about = "centre" if about_centre else "joint"
    return made.with_oracle(f"bodies turned about their {about}: {', '.join(turned)}", oracle, p)


def _around(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])
