"""Machines built off their drawing, recorded as they are and identified with a calibrated robot."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import deltaid
import plants
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from logs import tabled
from measured_poses import real, spans, touched, tracked
from oracle.composed import ComposedOracle
from oracle.limb import LimbShape
from oracle.measured_delta import DRAWINGS, BuiltDelta, BuiltLimb, built
from oracle.tree import Array
from plants import GRID, Plant, even_pace, friction_of, true_parameters

# Of a path [s]; its share of the largest motion; encoder step [rad]; of the recording [Hz].
PERIOD, SIZE, STEP, RATE = 4.0, 0.8, 1e-6, 500.0
# Intervals that are to hold: of parameters of bodies that data determines, of friction, of sums.
KINDS = ("data", "friction", "base")


@dataclass(frozen=True, eq=False)
class BuiltShape(LimbShape):
    """A limb whose motor axis or rail points where it was mounted."""

    limb: BuiltLimb

    @property
    def axes(self) -> Array:
        out, along = self.limb.out, self.limb.along
        if self.arm is None:
            return super().axes
        return np.column_stack([out, along, np.cross(out, along)])

    @property
    def rail(self) -> Array:
        return self.limb.along


def oracle_of(machine: BuiltDelta, robot: RobotDescription, p: Array) -> ComposedOracle:
    """MuJoCo's tree of a machine as it was built."""
    shapes = tuple(
        BuiltShape(
            azimuth=float(np.deg2rad(azimuth)),
            tilt=0.0,
            base=limb.base,
            seat=limb.seat,
            arm=limb.arm,
            strut=limb.struts[0][0],
            outwards=robot.limb_geometry[i].outwards,
            driven=robot.limb_bodies(i)[0],
            strut_body=robot.limb_bodies(i)[1],
            limb=limb,
        )
        for i, (limb, azimuth) in enumerate(
            zip(machine.limbs, machine.drawing.azimuths, strict=True)
        )
    )
    described = plants.oracle_of(robot, p)
    half = described.half if machine.half is None else machine.half
    return replace(described, limbs=shapes, half=half)


def poses_at(oracle: ComposedOracle, q: Array, start: Array) -> Array:
    """Task coordinates of drive coordinates, by Newton's method from near by."""
    z = start.copy()
    for _ in range(8):
        gap = oracle.positions(z) - q
        z = z - np.linalg.solve(oracle.jacobian(z), gap[..., None])[..., 0]
    assert np.abs(gap).max() < 1e-10
    return z


def as_read(machine: BuiltDelta, drives: int) -> tuple[Array, Array]:
    """Zeros and scales of all drives, a telescope's too, which is right."""
    more = drives - len(machine.limbs)
    zeros, scales = (
        np.pad([getattr(limb, key) for limb in machine.limbs], (0, more), constant_values=right)
        for key, right in (("zero", 0.0), ("scale", 1.0))
    )
    return zeros, scales


@dataclass(frozen=True)
class Held:
    """How many intervals hold the truth, and of how many, by `KINDS` and other origins."""

    hold: Counter[str]
    every: Counter[str]


@dataclass(frozen=True, eq=False)
class Machine:
    """One machine: what it is described as, how it was built, its parameters and a recording."""

    robot: RobotDescription
    built: BuiltDelta
    p: Array
    recording: pl.DataFrame
    rng: np.random.Generator

    def measured(self, *instruments: str) -> dict[str, dict[str, Array]]:
        """60 points of a tracker, 60 touches at two heights, or 18 distances at each."""
        name, rng, drawing = self.robot.name, self.rng, DRAWINGS[self.robot.name]
        x = drawing.poses(rng, 60)
        low, block = drawing.low[2] + 0.01, 0.1
        heights = np.repeat([low, low + block], 30)
        given = {}
        if "points" in instruments:
            given["points"] = tracked(name, x, real(self.built, name, x), rng)
        if "probe" in instruments:
            places = np.column_stack([x[:, :2], heights])
            given["probe"] = touched(self.built, name, places, 1e-5, rng)
        if "distances" in instruments:
            a, b = (drawing.poses(rng, 36) for _ in "ab")
            a[:, 2] = b[:, 2] = np.repeat([low, low + block], 18)
            given["distances"] = spans(self.built, name, a, b, rng)
        return given

    def calibrated(
        self, file: Path, *instruments: str, length: float, angle: float, **settings: Any
    ) -> Held:
        """As `held`, with the robot file that `calibrate` writes of some instruments."""
        given = self.measured(*instruments)
        found = deltaid.calibrate(self.robot, lengths=length, angles=angle, **given)
        found.save(file)
        return self.held(file, found.zeros, deltaid.Settings(**settings))

    def held(
        self, robot: RobotDescription | Path, zeros: dict[str, float], settings: deltaid.Settings
    ) -> Held:
        """What an identification with a robot file comes to, zeros in its mapping."""
        drives = range(len(self.built.limbs))
        mapping = {
            "position": {
                "columns": [f"q{i + 1}" for i in drives],
                "unit": "rad",
                "zero": [-zero for zero in zeros.values()],
            },
            "torque": {"columns": [f"tau{i + 1}" for i in drives], "unit": "N*m"},
        }
        found = deltaid.identify(
            robot, self.recording, columns=mapping if zeros else None, settings=settings
        )
        added = np.zeros(len(found.base.layout.names) - len(self.p))
        base = found.base.values(np.append(self.p, added))
        own = [k for k, group in enumerate(found.base.groups) if group.representative < len(self.p)]
        entries = [
            *zip(found.model.parameters, self.p, strict=False),
            *((found.model.base_parameters[k], base[k]) for k in own),
        ]
        hold, every = Counter[str](), Counter[str]()
        for entry, truth in entries:
            of_friction = getattr(entry, "name", "").startswith(("viscous", "coulomb"))
            kind = "friction" if of_friction else getattr(entry, "determined_by", "base")
            every[kind] += 1
            hold[kind] += int(entry.low <= truth <= entry.high)
        return Held(hold, every)


def machine(
    name: str,
    seed: int,
    *,
    length: float,
    angle: float,
    noise: float,
    duration: float = 8.0,
    scale: float = 0.0,
    lean: float = 0.0,
    colour: float = 0.0,
) -> Machine:
    """A machine that is off its drawing by normal errors, on a random motion.

    Its base leans by `lean` about both axes [rad]; `colour` is the correlation of the torques'
    noise from row to row.
    """
    rng, robot = np.random.default_rng(seed), deltaid.load_robot(name)
    drawing = replace(DRAWINGS[name], spacing=None)  # whose platform does not tilt
    delta = built(rng, drawing, length=length, angle=angle, scale=scale)
    p = true_parameters(robot, rng)
    oracle = oracle_of(delta, robot, p)
    if lean:
        turn = Rotation.from_rotvec([*rng.normal(0, lean, 2), 0.0])
        oracle = replace(oracle, gravity=turn.apply(oracle.gravity))
    motion = random_motion(deltaid.Kinematics(robot), rng, period=PERIOD)
    z, _, _ = motion.evaluate(np.arange(GRID) * (PERIOD / GRID))
    plant = Plant(oracle, friction_of(robot, p), motion.centre + SIZE * (z - motion.centre), p)
    truth = plant.move(even_pace(np.arange(round(duration * RATE)) / RATE, PERIOD), rng)
    zeros, scales = as_read(delta, truth.q.shape[1])
    q = STEP * np.round((truth.q - zeros) / scales / STEP)
    white = rng.standard_normal(truth.tau.shape)
    white[1:] *= np.sqrt(1 - colour**2)
    error = lfilter([1.0], [1.0, -colour], white, axis=0)
    tau = truth.tau + noise * np.abs(truth.tau).max(axis=0) * error
    return Machine(robot, delta, p, tabled(t=truth.time, q=q, tau=tau), rng)
