"""Robots drawn from their own priors, and recordings of them with sensors and weighings."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import compiled
from deltaid.estimation.objective import prior_scale
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.identification.column_stages import with_new_entries
from deltaid.identification.fit import FittedProblem, fit, with_geometry
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.measured_rows import SensorAddition
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import ExcitationSettings
from deltaid.recording.recording import open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.sensors.robot_sensors import all_sensor_rows
from deltaid.sensors.rows import SensorRows
from deltaid.sensors.weighings import weighings
from drives.motions import excited

RATE = 500.0
# Torques' noise as a share of the largest, and steps of the chain that draws a robot.
NOISE, _STEPS = 0.01, 60

# What is measured, by the name of a row of the study. Values are filled in.
CASES: dict[str, dict[str, Any]] = {
    "torque": {},
    "platform weighed": {"measured": [("P", 0.002)]},
    "strut and platform weighed": {"measured": [("S", 0.005), ("P", 0.005)]},
    "wrench": {"sensors": {"plate": {"kind": "base-wrench", "force_noise": 1.0}}},
    "wrench, tared": {
        "sensors": {
            "plate": {
                "kind": "base-wrench",
                "force_noise": 1.0,
                "force_bias": 0.0,
                "moment_bias": 0.0,
            }
        }
    },
    "gauges": {
        "sensors": {
            f"gauge{i}": {"kind": "strut-force", "strut": f"strut{i}", "at": "platform"}
            for i in (1, 2, 3)
        }
    },
}


@dataclass(frozen=True)
class Sensed:
    """A robot of a case, and what a fit may change of it.

    Attributes:
        robot: with all that the case shows free, exact geometry, and measured values to be filled.
        sensors: its rows.
        reduction: of all that is shown.
    """

    robot: RobotDescription
    sensors: tuple[SensorRows, ...]
    reduction: Reduction


@cache
def sensed(name: str, case: str, spread: float) -> Sensed:
    """A catalogue robot with what a case measures."""
    robot, given = load_robot(name), CASES[case]
    masses = {body: float(robot.bodies[body].prior_parameters()[0]) for body in robot.body_names}
    robot = robot.changed(
        tolerances={"lengths": 0.0, "homing": 0.0, "mounting": 0.0},
        sensors=given.get("sensors", {}),
        measured=[
            {"of": body, "mass": masses[body], "std": share * masses[body]}
            for body, share in given.get("measured", [])
        ],
    )
    dynamics = compiled(robot)
    known = [np.flatnonzero(weighing.coefficients) for weighing in weighings(robot)]
    seen = [group.pattern[1] for group in all_sensor_rows(dynamics, spread)]
    shown = np.unique(np.concatenate([np.zeros(0, dtype=int), *known, *seen]))
    shown = shown[shown < len(dynamics.layout.names)]
    torques = np.unique(dynamics.regressor_pattern[1])
    freed = with_new_entries(robot, shown, torques)
    rows = all_sensor_rows(compiled(freed), spread)
    reduction = build_reduction(freed, np.union1d(shown, torques), spread=spread)
    return Sensed(freed, rows, reduction)


def drawn(reduction: Reduction, spread: float, rng: np.random.Generator) -> np.ndarray:
    """p of a robot from the prior that is Gaussian in p and consistent, by slices of ellipses."""
    changed = np.any(reduction.A != 0, axis=1)
    D = reduction.A[changed] / (spread * prior_scale(reduction)[changed])[:, None]
    scale = np.sqrt(np.diag(D.T @ D))
    root = np.linalg.inv(np.linalg.cholesky(D.T @ D / np.outer(scale, scale)).T) / scale[:, None]
    off = np.zeros(reduction.size)
    for _ in range(_STEPS):
        other = root @ rng.standard_normal(reduction.size)
        angle = rng.uniform(0, 2 * np.pi)
        low, high = angle - 2 * np.pi, angle
        while not consistent(reduction, new := off * np.cos(angle) + other * np.sin(angle)):
            low, high = (angle, high) if angle < 0 else (low, angle)
            angle = rng.uniform(low, high)
        off = new
    return reduction.parameters(reduction.prior + off)


def consistent(reduction: Reduction, off: np.ndarray) -> bool:
    """Whether a point that far from the prior is a possible robot."""
    for block in reduction.blocks:
        size = np.sqrt(np.diag(block.prior))
        M = block.matrix(reduction.prior + off) / np.outer(size, size)
        if np.linalg.eigvalsh(M)[0] <= 1e-6:
            return False
    return True


@cache
def motion(name: str, rate: float = RATE) -> tuple[np.ndarray, ...]:
    """t, z, q, q̇, q̈ of the run that `deltaid excite` gives: several periods, from rest to rest."""
    dynamics = compiled(load_robot(name))
    run = excited(name, dynamics.robot, ExcitationSettings(starts=1))
    time = np.arange(int(run.duration * rate)) / rate
    z, zd, zdd = run.evaluate(time)
    return time, z, *dynamics.kinematics.drive_motion(z, zd, zdd)


def shown_by(
    rows: SensorRows,
    p: np.ndarray,
    u: np.ndarray,
    states: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """What a sensor shows without noise, (channels, samples): its unknowns are u."""
    shown = np.zeros((len(rows.channels), len(states[0])))
    values, (channels, columns) = np.concatenate([p, u]), rows.pattern
    for _ in range(8):  # pose and gain go by what it shows
        entries = rows.entries(*states, shown)
        new = np.zeros_like(shown)
        np.add.at(new, channels, entries * values[columns][:, None])
        if np.allclose(new, shown, rtol=1e-12, atol=0):
            break
        shown = new
    return shown


def recorded(
    name: str,
    of: Sensed,
    p: np.ndarray,
    rng: np.random.Generator,
    gains: Mapping[int, float] | None = None,
    unknowns: np.ndarray | None = None,
) -> pl.DataFrame:
    """A recording of a robot with parameters p, its sensors' unknowns drawn from their priors."""
    time, z, q, qd, qdd = motion(name)
    dynamics = compiled(of.robot)
    tau = dynamics.torque(z, qd, qdd, p)
    tau += NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    columns = {"t": time} | {f"q{i + 1}": x for i, x in enumerate(q.T)}
    columns |= {f"tau{i + 1}": x / (gains or {}).get(i, 1.0) for i, x in enumerate(tau.T)}
    for rows in of.sensors:
        u = np.array(
            [parameter.scale * 0.1 * rng.standard_normal() for parameter in rows.parameters]
        )
        u = u if unknowns is None else unknowns
        shown = shown_by(rows, p, u, (z, qd, qdd))
        for channel, x in zip(rows.channels, shown, strict=True):
            columns[channel.name] = x + channel.noise * rng.standard_normal(len(x))
    return pl.DataFrame(columns)


def weighed(of: Sensed, p: np.ndarray, rng: np.random.Generator) -> RobotDescription:
    """The robot with what scales say of one whose parameters are p."""
    return of.robot.changed(measured=[
        {"of": part.of, "mass": float(row.coefficients @ p + row.std * rng.standard_normal()),
         "std": row.std}
        for part, row in zip(of.robot.measured, weighings(of.robot), strict=True)
    ])  # fmt: skip


def identified(
    name: str, of: Sensed, p: np.ndarray, spread: float, rng: np.random.Generator
) -> tuple[FittedProblem, tuple[Parameter, ...]]:
    """The fit of one recording, and the robot's parameters with intervals."""
    robot = weighed(of, p, rng)
    dynamics = compiled(robot)
    recordings = open_recordings([recorded(name, of, p, rng)], dynamics.kinematics)
    sensors = [SensorAddition.for_sensor(dynamics, each, spread) for each in robot.sensors]
    settings = Settings(prior_spread=spread)
    problem = fit(dynamics, recordings, settings, additions=sensors)
    problem = with_geometry(problem, recordings)
    return problem, judged_parameters(problem)[: len(problem.p)]
