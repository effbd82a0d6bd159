"""Offers of sensors and scales, a plan made from them, and what they tell by one dense matrix."""

from functools import cache

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia
from deltaid.robot.sensors import BaseWrench, StrutForce
from deltaid.sensors.planning.offers import Offers
from deltaid.sensors.planning.plan import PlanSettings, SensorPlan, sensor_plan
from deltaid.sensors.planning.rows import generic_motion
from deltaid.sensors.robot_sensors import sensor_rows

DELTA = "clavel-delta3"
SETTINGS = PlanSettings(torque_noise=0.03, rate=50.0, duration=8.0, steps=4, seed=3)
PLATE = {
    "kind": "base-wrench", "force_noise": 0.7, "moment_noise": 0.2, "force_bias": 3.0,
    "position_tolerance": 2e-3, "rotation_tolerance": 0.01, "gain_tolerance": 0.02,
}  # fmt: skip


def offers(**more: dict) -> Offers:
    """A scale, an edge, a pendulum, a plate and a gauge."""
    given = {
        "scale": {
            "title": "scale", "price": 20, "hours": 0.5,
            "weigh": [{"quantity": "mass", "share": 0.003, "std": 0.001},
                      {"quantity": "mass", "of": "limb", "std": 0.002}],
        },
        "edge": {
            "title": "edge", "price": 5, "hours": 0.2,
            "weigh": {"quantity": "centre", "of": "S", "axis": "x", "std": 2e-3},
        },
        "pendulum": {
            "title": "pendulum", "price": 40, "hours": 1,
            "weigh": {"quantity": "inertia", "of": "U", "axis": "y", "about": [0.1, 0, 0],
                      "share": 0.01},
        },
        "plate": {"title": "plate", "price": 3000, "sensors": {"plate": PLATE}},
        "gauges": {
            "title": "gauges", "price": 300, "hours": 2,
            "sensors": {"g": {"kind": "strut-force", "strut": "each", "at": "platform",
                              "noise": 0.4}},
        },
    }  # fmt: skip
    return Offers.model_validate({"hourly": 30, "offers": given | more})


@cache
def planned() -> SensorPlan:
    both = ("plate", "scale:U+2S")
    return sensor_plan(DELTA, offers=offers(), combinations=[both], settings=SETTINGS)


def dense(robot: RobotDescription, names: tuple[str, ...]) -> dict[str, float]:
    """Standard deviations of all entries of bodies with torques and some uses, as shares.

    One covariance of everything at once: entries of M̄, coefficients, unknowns of sensors.
    """
    dynamics = compiled(robot)
    layout, p = dynamics.layout, prior_parameters(robot)
    motion = generic_motion(dynamics, SETTINGS.duration, SETTINGS.seed)
    q = dynamics.kinematics.drive_motion(motion.z, motion.qd * 0, motion.qdd * 0)[0]
    count = SETTINGS.rate * SETTINGS.duration / len(q)
    # Variables: names, derivative of p by each, prior deviation.
    variables, columns, stds, sizes = [], [], [], []
    for body in robot.body_names:
        at = layout.body(body)
        M = pseudo_inertia(p[at])
        for name, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = 1.0
            column = np.zeros(len(p))
            column[at] = inertia_parameters(unit)
            largest = np.sqrt(M[i, i] * M[j, j])
            size = abs(M[i, j]) if abs(M[i, j]) > 1e-3 * largest else largest
            variables.append(f"{body}.{name}")
            columns.append(column)
            sizes.append(size)
            stds.append(0.5 * size)
    for k in range(10 * len(robot.body_names), len(p)):
        variables.append(layout.names[k])
        columns.append(np.eye(len(p))[k])
        sizes.append(p[k])
        stds.append(0.5 * p[k])
    J = np.column_stack(columns)
    Y = dynamics.regressor(q, motion.qd, motion.qdd)
    noise = SETTINGS.torque_noise * np.abs(Y @ p).max(axis=0)
    information = np.diag(1.0 / np.array(stds) ** 2)
    for i in range(dynamics.dof):
        A = Y[:, i] @ J / noise[i]
        information += count * A.T @ A

    def value(c: np.ndarray, std: float) -> None:
        nonlocal information
        row = np.zeros(len(information))
        row[: len(columns)] = c @ J / std
        information = information + np.outer(row, row)

    def sensor(name: str, described: BaseWrench | StrutForce) -> None:
        nonlocal information
        rows = sensor_rows(dynamics, name, described)
        at, column = rows.pattern
        shape = len(rows.channels), len(p) + len(rows.parameters)
        C = np.zeros((len(q), *shape))
        entries = rows.entries(motion.z, motion.qd, motion.qdd, np.zeros((shape[0], len(q))))
        C[:, at, column] = entries.T
        shown = (C[:, :, : len(p)] @ p).T
        C[:, at, column] = rows.entries(motion.z, motion.qd, motion.qdd, shown).T
        own = len(rows.parameters)
        larger = np.zeros((len(information) + own,) * 2)
        larger[:-own, :-own] = information
        larger[-own:, -own:] = np.diag([parameter.std**-2.0 for parameter in rows.parameters])
        for c, channel in enumerate(rows.channels):
            A = np.zeros((len(q), len(larger)))
            A[:, : len(columns)] = C[:, c, : len(p)] @ J
            A[:, -own:] = C[:, c, len(p) :]
            larger += count * A.T @ A / channel.noise**2
        information = larger

    def entry(body: str, k: int) -> np.ndarray:
        return np.eye(len(p))[layout.body(body).start + k]

    for name in names:
        match name.split(":"):
            case "scale", "U+2S":
                value(entry("U", 0) + 2 * entry("S", 0), 0.002)
            case "scale", body:
                m = entry(body, 0)
                value(m, float(np.hypot(0.001, 0.003 * (m @ p))))
            case "edge", _:
                m, mx = entry("S", 0), entry("S", 1)
                value(mx - (mx @ p) / (m @ p) * m, 2e-3 * (m @ p))
            case "pendulum", _:
                # About a point a on x: Iyy − 2 a mcx + a² m.
                c = entry("U", 5) - 0.2 * entry("U", 1) + 0.01 * entry("U", 0)
                value(c, 0.01 * abs(c @ p))
            case ("plate",):
                sensor("plate", BaseWrench.model_validate(PLATE))
            case _:
                for i in (1, 2, 3):
                    gauge = StrutForce(
                        kind="strut-force", strut=f"strut{i}", at="platform", noise=0.4
                    )
                    sensor(f"g{i}", gauge)
    # Scaled, so that a direct inverse keeps its digits.
    d = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(d, d)) * np.outer(d, d)
    return {
        name: float(np.sqrt(covariance[k, k]) / size)
        for k, (name, size) in enumerate(zip(variables, sizes, strict=True))
    }
