"""Recordings with known truth, made by the oracle, and some rows made by another library."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import tabled, write
from oracle.delta import Body, DeltaOracle
from plants import bodies_of, rotors_of

# Two robots, and rows of a motion (100 Hz, every 25th) whose torques come from a rigid-body library
# that is neither this package nor the oracle: spanning tree, recursive Newton-Euler, projection.
DATA = Path(__file__).with_name("data")
CATALOGUE = {"delta3": "clavel-delta3", "delta4": "irb360-6-1600"}


def inertia_vector(body: Body) -> list[float]:
    """The ten parameters (4) of an oracle's body."""
    I = body.inertia
    return [body.m, *body.mc, I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2]]


def describe(oracle: DeltaOracle, share: float = 1.0) -> RobotDescription:
    """A description of an oracle's robot whose priors are a share of the truth.

    The catalogue robot gives the reduction tables, limits and everything that is not measured.
    """
    data = load_robot(CATALOGUE["delta4" if oracle.has_telescope else "delta3"]).model_dump(
        mode="json"
    )
    data["limbs"] |= {
        "base_radius": oracle.base_radius,
        "platform_radius": oracle.platform_radius,
        "upper_arm": oracle.upper_arm,
        "strut": oracle.strut,
    }
    for name, body in data["bodies"].items():
        p = share * np.array(inertia_vector(oracle.bodies[name]))
        keys = ("xx", "yy", "zz", "xy", "yz", "xz")
        body["prior"] = {
            "mass": p[0],
            "first_moment": p[1:4].tolist(),
            "inertia": dict(zip(keys, p[4:].tolist(), strict=True)),
        }
    joints = list(data["friction"])
    for joint, viscous, coulomb in zip(joints, oracle.viscous, oracle.coulomb, strict=True):
        data["friction"][joint] = {"viscous": share * viscous, "coulomb": share * coulomb}
    data["rotor_inertia"] = {
        f"drive{i + 1}": share * J for i, J in enumerate(oracle.rotor_inertia) if J > 0
    }
    return RobotDescription.model_validate(data)


def true_parameters(oracle: DeltaOracle) -> np.ndarray:
    """p of an oracle, in the order of its description."""
    names = ("U", "S", "P") + (("TU", "TL", "EE") if oracle.has_telescope else ())
    inertias = [value for name in names for value in inertia_vector(oracle.bodies[name])]
    rotors = [J for J in oracle.rotor_inertia if J > 0]
    return np.array([*inertias, *oracle.viscous, *oracle.coulomb, *rotors])


def stored_oracle(name: str) -> DeltaOracle:
    """A robot of tests/data: 'delta3' or 'delta4'."""
    files = (DATA / name / f"{kind}.json" for kind in ("robot", "truth"))
    return DeltaOracle.from_json(*(json.loads(file.read_text("utf-8")) for file in files))


def stored_rows(name: str) -> list[np.ndarray]:
    """q, q̇, q̈ and τ of a robot of tests/data, by the other library."""
    rows = np.loadtxt(DATA / name / "exact.csv", delimiter=",", skiprows=1)
    return np.split(rows[:, 1:], 4, axis=1)


def typical_oracle(rng: np.random.Generator, *, telescope: bool) -> DeltaOracle:
    """A robot of the usual build: tubes along the links, whatever the reductions assume.

    Sizes and masses are random; bodies are scaled from the catalogue's priors.
    """
    from deltaid.motion.surrogate import surrogate_parameters

    robot = load_robot(CATALOGUE["delta4" if telescope else "delta3"])
    dynamics = Dynamics(robot)
    p, layout, limbs = surrogate_parameters(robot, rng), dynamics.layout, robot.limbs
    return DeltaOracle(
        base_radius=limbs.base_radius * rng.uniform(0.95, 1.05),
        platform_radius=limbs.platform_radius * rng.uniform(0.95, 1.05),
        upper_arm=limbs.upper_arm * rng.uniform(0.98, 1.02),
        strut=limbs.strut * rng.uniform(0.98, 1.02),
        bodies=bodies_of(robot, p),
        has_telescope=telescope,
        viscous=p[layout.viscous],
        coulomb=p[layout.coulomb],
        rotor_inertia=rotors_of(robot, p),
    )


def record(
    oracle: DeltaOracle, path: Path, rng: np.random.Generator, *, samples: int = 600
) -> np.ndarray:
    """Write a noise-free recording whose torques come from the oracle; returns z along it."""
    kinematics = Dynamics(describe(oracle)).kinematics
    motion = random_motion(kinematics, rng)
    time = np.arange(samples) * (motion.period / samples)
    z, zd, zdd = motion.evaluate(time)
    q, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    tau = oracle.inverse_dynamics(q, qd, qdd)
    write(path, tabled(t=time, q=q, qd=qd, qdd=qdd, tau=tau))
    return z


# Resolution of an encoder of 18 bits behind a gear of ratio ten (rad).
_STEP = 2 * np.pi / 2**18 / 10


@dataclass(frozen=True)
class OracleMotion:
    """Ten seconds of a periodic motion, all of it by the oracle: nothing of the package is asked.

    Attributes:
        time: of the samples.
        z: task coordinates.
        q, qd, qdd: of the actuators; a periodic q is differentiated by its Fourier series.
        tau: torques.
    """

    time: np.ndarray
    z: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray

    def write_exact(self, path: Path) -> Path:
        """Everything, without noise."""
        return self._write(path, q=self.q, qd=self.qd, qdd=self.qdd, tau=self.tau)

    def write_noisy(self, path: Path, rng: np.random.Generator) -> Path:
        """As a drive logs it: encoder steps, 2 % of noise and a ripple of 0.5 % on the torques."""
        largest = np.abs(self.tau).max(axis=0)
        noise = 0.02 * rng.standard_normal(self.tau.shape)
        ripple = 0.005 * np.sin(60 * self.q + rng.uniform(0, 2 * np.pi, self.q.shape[1]))
        tau = self.tau + largest * (noise + ripple)
        return self._write(path, q=_STEP * np.round(self.q / _STEP), tau=tau)

    def _write(self, path: Path, **quantities: np.ndarray) -> Path:
        return write(path, tabled(t=self.time, **quantities))


def oracle_motion(oracle: DeltaOracle, rng: np.random.Generator, rate: float) -> OracleMotion:
    """Eight random harmonics about the middle of the workspace, at a rate (Hz)."""
    period, harmonics = 10.0, np.arange(1, 9)
    time = np.arange(round(period * rate)) / rate
    phase = 2 * np.pi / period * np.outer(time, harmonics)
    waves = np.hstack([np.sin(phase), np.cos(phase)])
    shape = waves @ rng.standard_normal((len(waves.T), oracle.dof))
    shape /= np.abs(shape).max(axis=0)
    z = np.array([0, 0, -0.95, 0])[: oracle.dof] + shape * [0.3, 0.3, 0.13, 2.0][: oracle.dof]
    q = oracle.positions(z)
    assert np.all(np.isfinite(q))
    frequency = 2j * np.pi * np.fft.rfftfreq(len(time), 1 / rate)[:, None]
    qd, qdd = (np.fft.irfft(frequency**k * np.fft.rfft(q, axis=0), axis=0) for k in (1, 2))
    return OracleMotion(time, z, q, qd, qdd, oracle.inverse_dynamics(q, qd, qdd))
