"""Recordings with known truth, made by the oracle, and some rows made by another library."""

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from composed import body_parameters
from deltaid.dynamics.parameters import parameter_layout, prior_parameters, with_prior
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import tabled, write
from oracle.composed import ComposedOracle
from oracle.tree import Body
from plants import friction_of, oracle_of

# Two robots, and rows of a motion (100 Hz, every 25th) whose torques come from a rigid-body library
# that is neither this package nor the oracle: spanning tree, recursive Newton-Euler, projection.
DATA = Path(__file__).with_name("data")
CATALOGUE = {"delta3": "clavel-delta3", "delta4": "irb360-6-1600"}
LENGTHS = ("base_radius", "platform_radius", "upper_arm", "strut")


@dataclass(frozen=True, eq=False)
class KnownRobot:
    """A catalogue robot of other lengths with known parameters p, and the oracle's robot."""

    robot: RobotDescription
    p: np.ndarray

    def described(self, share: float) -> RobotDescription:
        """A description whose priors are a share of the truth."""
        return with_prior(self.robot, share * self.p)

    @cached_property
    def oracle(self) -> ComposedOracle:
        viscous, coulomb = friction_of(self.robot, self.p)
        return replace(oracle_of(self.robot, self.p), viscous=viscous, coulomb=coulomb)


def stored_robot(name: str) -> KnownRobot:
    """A robot of tests/data: 'delta3' or 'delta4'."""
    lengths, truth = (
        json.loads((DATA / name / f"{kind}.json").read_text("utf-8")) for kind in ("robot", "truth")
    )
    robot = load_robot(CATALOGUE[name]).changed(rotor_inertia={})
    limbs = robot.limbs.changed(**{key: lengths[key] for key in LENGTHS})
    p, layout = prior_parameters(robot), parameter_layout(robot)
    for body, numbers in truth["bodies"].items():
        tensor = np.array(numbers["inertia_about_link_frame"])
        known = Body(numbers["m"], np.array(numbers["mc"]), tensor)
        p[layout.body(body)] = body_parameters(known)
    for coefficients in ("viscous", "coulomb"):  # surplus ones are of other robots' joints
        p[getattr(layout, coefficients)] = truth[coefficients][: len(robot.joints)]
    return KnownRobot(robot.changed(limbs=limbs), p)


def stored_rows(name: str) -> list[np.ndarray]:
    """q, q̇, q̈ and τ of a robot of tests/data, by the other library."""
    rows = np.loadtxt(DATA / name / "exact.csv", delimiter=",", skiprows=1)
    return np.split(rows[:, 1:], 4, axis=1)


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


def oracle_motion(oracle: ComposedOracle, rng: np.random.Generator, rate: float) -> OracleMotion:
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
    return OracleMotion(time, z, q, qd, qdd, oracle.inverse_dynamics(z, qd, qdd))
