"""Catalogue robots with random true bodies, moved along a path at any pace; torques by the oracle.

The package gives the description, the size of a motion that its limits allow, and names of p.
Everything else, q(z) and all torques, comes from MuJoCo's tree and from Fourier series.

Along a path z(φ) of period 2π, a pace φ(t) makes

    q̇ = q' φ̇,   q̈ = q'' φ̇² + q' φ̈,   τ = a(φ) φ̇² + b(φ) φ̈ + g(φ) + friction

with a, b and g from three calls of the oracle for each point of a grid: a = τ(q', q'') − g,
b = τ(0, q') − g, g = τ(0, 0). They are smooth and periodic, so a few hundred points give all rows.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia
from oracle.composed import ComposedOracle
from oracle.limb import LimbShape
from oracle.tree import Array, Body

# Points of a path, of which the oracle gets as many as it takes, and points that the Fourier series
# of what it gives is made dense with.
GRID, _DENSE = 1024, 1 << 14
# How long a robot takes to stop or to start, s.
_RAMP = 0.4
# By how much robots of a type differ, as shares.
BODY, FRICTION = 0.03, 0.15


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A random number of log-uniform density."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def true_parameters(robot: RobotDescription, rng: np.random.Generator) -> Array:
    """p away from the prior by up to a factor of two: bodies stay consistent, M̄ = G M̄_prior G."""
    p, layout, spread = prior_parameters(robot), parameter_layout(robot), np.log(2.0)
    for body in layout.bodies:
        part = layout.body(body)
        G = np.diag(np.exp(0.5 * spread * rng.uniform(-1, 1, 4)))
        p[part] = inertia_parameters(G @ pseudo_inertia(p[part]) @ G)
    rest = layout.coefficients
    p[rest] *= np.exp(spread * rng.uniform(-1, 1, rest.stop - rest.start))
    return p


def made_alike(
    robot: RobotDescription, p: Array, rng: np.random.Generator, body: float = BODY
) -> Array:
    """One robot of a type with parameters p in the mean.

    Free entries of each body's pseudo-inertia matrix are off by a share of √(M_ii M_jj),
    coefficients of joints by a share FRICTION of themselves, all independently.
    """
    found, layout = p.copy(), parameter_layout(robot)
    for name in layout.bodies:
        part = layout.body(name)
        M = pseudo_inertia(p[part])
        size, off = np.sqrt(np.outer(np.diag(M), np.diag(M))), np.zeros((4, 4))
        for entry in robot.bodies[name].free:
            i, j = PSEUDO_INERTIA_ENTRIES[entry]
            off[i, j] = off[j, i] = rng.standard_normal()
        found[part] = inertia_parameters(M + body * size * off)
    at = layout.coefficients
    found[at] *= 1.0 + FRICTION * rng.standard_normal(at.stop - at.start)
    return found


def bodies_of(robot: RobotDescription, p: Array) -> dict[str, Body]:
    """The oracle's bodies of parameters p."""
    layout, bodies = parameter_layout(robot), dict[str, Body]()
    for name in layout.bodies:
        m, mcx, mcy, mcz, xx, yy, zz, xy, yz, xz = p[layout.body(name)]
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        bodies[name] = Body(m, np.array([mcx, mcy, mcz]), tensor)
    return bodies


def rotors_of(robot: RobotDescription, p: Array) -> Array:
    """Rotor inertia of every drive, zero where none is described."""
    rotors = np.zeros(len(robot.drives))
    rotors[[robot.drives.index(drive) for drive in robot.rotor_drives]] = p[
        parameter_layout(robot).rotor
    ]
    return rotors


def oracle_of(robot: RobotDescription, p: Array) -> ComposedOracle:
    """The oracle of a catalogue robot with parameters p; friction is left to `Plant`."""
    platform, limbs = robot.platform, robot.limbs
    angles = np.deg2rad(limbs.azimuth_deg)
    tilts = np.deg2rad(np.broadcast_to(limbs.tilt_deg, limbs.count))
    shapes = tuple(
        LimbShape(
            azimuth=float(azimuth),
            tilt=float(tilt),
            base=limb.base,
            seat=limb.attachment,
            arm=limb.upper_arm if limb.drive == "rotary" else None,
            strut=limb.strut,
            outwards=limb.outwards,
            driven=robot.limb_bodies(i)[0],
            strut_body=robot.limb_bodies(i)[1],
        )
        for i, (limb, azimuth, tilt) in enumerate(zip(limbs.geometry(), angles, tilts, strict=True))
    )
    more = {}
    if platform.kind != "rigid":
        more = {"first": tuple(k - 1 for k in platform.first), "ratio": platform.ratio}
        more["tool"] = np.array(platform.tool)
    if platform.kind == "h4":
        more["half"] = platform.half_length
    if platform.kind == "par4":
        more["half"] = 0.5 * platform.length
    if platform.kind == "i4":
        more["direction"] = np.deg2rad(platform.direction_deg)
    if robot.telescope is not None:
        bar = robot.telescope
        more["telescope"] = (np.array(bar.base_joint), np.array(bar.platform_joint))
    return ComposedOracle(
        limbs=shapes,
        kind=platform.kind,
        bodies=bodies_of(robot, p),
        struts_per_limb=limbs.struts_per_limb,
        gravity=np.array(robot.gravity),
        rotor_inertia=rotors_of(robot, p),
        **more,
    )


def friction_of(robot: RobotDescription, p: Array) -> Array:
    """Viscous and Coulomb coefficients (2, joints) in the oracle's order of joints."""
    layout, joints = parameter_layout(robot), robot.joints
    found = np.zeros((2, len(joints)))
    at = [joints.index(joint) for joint in robot.friction_joints]
    found[:, at] = p[layout.viscous], p[layout.coulomb]
    return found


@dataclass(frozen=True, eq=False)
class Pace:
    """The phase of a path over time, and its two derivatives (samples,)."""

    time: Array
    phase: Array
    rate: Array
    rise: Array


def even_pace(time: Array, period: float, rest: tuple[tuple[float, float], ...] = ()) -> Pace:
    """φ̇ = 2π / period but in spans of rest, into and out of which it goes smoothly in 0.4 s.

    The phase is one of time, whatever the first sample is: φ = 2π t / period before any rest.
    """
    edges = [(edge, sign, _RAMP) for span in rest for edge, sign in zip(span, (-1, 1), strict=True)]
    return paced(time, period, edges)


def paced(time: Array, period: float, edges: Iterable[tuple[float, int, float]]) -> Pace:
    """φ̇ = 2π / period that stops (−1) or starts (+1) at times, with ramps of so long (s)."""
    gone, share, rise = time.copy(), np.ones_like(time), np.zeros_like(time)
    for edge, sign, ramp in edges:
        x = np.clip((time - edge) / ramp, 0.0, 1.0)
        gone += sign * (ramp * x**4 * (2.5 - 3 * x + x**2) + np.maximum(time - edge - ramp, 0))
        share += sign * x**3 * (10 - 15 * x + 6 * x**2)
        rise += sign * 30 * x**2 * (1 - x) ** 2 / ramp
    share[np.abs(share) < 1e-12] = 0.0
    rate = 2 * np.pi / period
    return Pace(time, rate * gone, rate * share, rate * rise)


@dataclass(frozen=True, eq=False)
class Truth:
    """What happens, sample by sample, before any sensor.

    Attributes:
        time, q, qd, qdd: of the drives.
        tau: all torques, friction included.
        rates: q̇ of the joints with friction (samples, joints): drives first.
        shares: torque at the drives for one of a joint's (samples, joints - drives, drives).
        z, zd, zdd: task coordinates.
        hand: ∂z/∂q (samples, task coordinates, drives).
    """

    time: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    rates: Array
    shares: Array
    z: Array
    zd: Array
    zdd: Array
    hand: Array

    def of_joints(self, efforts: Array) -> Array:
        """Torques at the drives of efforts in all joints (samples, joints)."""
        dof = self.q.shape[1]
        passive = np.einsum("sj,sjd->sd", efforts[:, dof:], self.shares)
        return efforts[:, :dof] + passive


@dataclass(frozen=True, eq=False)
class Plant:
    """A true robot and a path z(φ), as its points at φ = 2π k / GRID, (GRID, dof).

    Attributes:
        oracle: without friction.
        friction: viscous and Coulomb coefficients of all joints, (2, joints).
        path: task coordinates.
        p: all of this as parameters of the description.
    """

    oracle: ComposedOracle
    friction: Array
    path: Array
    p: Array

    @cached_property
    def _curves(self) -> CubicSpline:
        """q, q', q'', a, b, g, z, z', z'', passive joints' and the hand's rates a drive rate."""
        for every in (8, 4, 2, 1):
            values = self._values(self.path[::every])
            spectrum = np.fft.rfft(values, axis=0)
            if self._resolved(np.abs(spectrum)):
                break
        else:
            raise AssertionError("GRID is too coarse")
        dense = np.fft.irfft(spectrum, _DENSE, axis=0) * (_DENSE / len(values))
        phase = np.linspace(0, 2 * np.pi, _DENSE + 1)
        return CubicSpline(phase, np.vstack([dense, dense[:1]]), bc_type="periodic")

    def _values(self, path: Array) -> Array:
        """The same at the points of a path."""
        oracle, dof = self.oracle, self.oracle.dof
        q = oracle.positions(path)
        assert np.all(np.isfinite(q)), "the path leaves the workspace"
        order = 1j * np.fft.rfftfreq(len(q), 1 / len(q))[:, None]
        waves = np.fft.rfft(np.hstack([q, path]), axis=0)
        slopes, bends = (np.fft.irfft(order**k * waves, len(q), axis=0) for k in (1, 2))
        slope, bend = slopes[:, :dof], bends[:, :dof]
        joints = [oracle._index[name] for name in (*oracle._lossy[dof:], *_hand(oracle))]
        rows = []
        for z, first, second in zip(path, slope, bend, strict=True):
            g = oracle.inverse_dynamics(z, 0 * first, 0 * first)
            b = oracle.inverse_dynamics(z, 0 * first, first) - g
            a = oracle.inverse_dynamics(z, first, second) - g
            proj, _ = oracle._set(z, first)
            rows.append(np.concatenate([a, b, g, proj[joints].ravel()]))
        rows = np.array(rows)
        more = [path, slopes[:, dof:], bends[:, dof:], rows[:, 3 * dof :]]
        return np.hstack([q, slope, bend, rows[:, : 3 * dof], *more])

    def _resolved(self, spectrum: Array) -> bool:
        """Whether the highest waves of all quantities are small; a drive of it may rest."""
        tail, largest = spectrum[-len(spectrum) // 8 :].max(axis=0), spectrum.max(axis=0)
        dof = self.oracle.dof
        return all(
            tail[k : k + dof].max() <= 1e-5 * largest[k : k + dof].max()
            for k in range(0, 6 * dof, dof)
        )

    def move(self, pace: Pace, rng: np.random.Generator) -> Truth:
        """Go along the path; friction of a joint at rest is random within its Coulomb friction."""
        dof = self.oracle.dof
        values = self._curves(np.mod(pace.phase, 2 * np.pi))
        parts = np.split(values[:, : 9 * dof], 9, axis=1)
        q, slope, bend, a, b, g, z, hand_slope, hand_bend = parts
        rate, rise = pace.rate[:, None], pace.rise[:, None]
        qd = slope * rate
        shares, hand = np.split(values[:, 9 * dof :].reshape(len(q), -1, dof), [-dof], axis=1)
        rates = np.hstack([qd, np.einsum("sjd,sd->sj", shares, qd)])
        truth = Truth(
            pace.time,
            q,
            qd,
            bend * rate**2 + slope * rise,
            a * rate**2 + b * rise + g,
            rates,
            shares,
            z,
            hand_slope * rate,
            hand_bend * rate**2 + hand_slope * rise,
            hand,
        )
        viscous, coulomb = self.friction
        sign = np.where(rates == 0, rng.uniform(-0.8, 0.8, rates.shape[1]), np.sign(rates))
        return replace(truth, tau=truth.tau + truth.of_joints(viscous * rates + coulomb * sign))


def _hand(oracle: ComposedOracle) -> tuple[str, ...]:
    """The tree's joints whose rates are those of the task coordinates."""
    first = "p" if oracle.kind == "rigid" else "t"
    return tuple(f"{first}{axis}" for axis in "xyz") + (("ee",) if oracle.dof == 4 else ())


def random_plant(
    robot: RobotDescription, rng: np.random.Generator, period: float, harmonics: int, size: float
) -> Plant:
    """A robot with true bodies and a random path of a share of the size that its limits allow."""
    p = true_parameters(robot, rng)
    kinematics = Kinematics(robot)
    for _ in range(20):
        motion = random_motion(kinematics, rng, period=period, harmonics=harmonics)
        z, _, _ = motion.evaluate(np.arange(GRID) * (period / GRID))
        path = motion.centre + size * (z - motion.centre)
        plant = Plant(oracle_of(robot, p), friction_of(robot, p), path, p)
        if np.all(np.isfinite(plant.oracle.positions(path))):
            return plant
    raise AssertionError("no path within reach")
