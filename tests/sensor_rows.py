"""Rows of sensors as dense matrices, and random robots whose sensors an oracle knows."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from composed import SPACING, Make, describe, parameters, random_composed, random_states
from deltaid.dynamics.dynamics import Dynamics
from deltaid.robot.sensors import BaseWrench, Sensor
from deltaid.sensors.robot_sensors import sensor_rows
from deltaid.sensors.rows import SensorRows
from oracle.sensors import SensorOracle, StrutOracle
from oracle.tree import Body, random_body

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
PLACE, TURN = (0.11, -0.23, 0.31), (20.0, -35.0, 130.0)
SUMS = [
    Make(kind="par4", unequal=True),
    Make(kind="i4", linear=True),
    Make(kind="i4", own=True),
    Make(telescope=True, struts=1),
]


@dataclass(frozen=True, eq=False)
class SensorTwin:
    """A robot twice, its parameters, and generic states: z, qd, qdd."""

    dynamics: Dynamics
    oracle: SensorOracle
    p: np.ndarray
    states: tuple[np.ndarray, np.ndarray, np.ndarray]

    def rows(self, sensor: Sensor, spread: float = 0.5) -> SensorRows:
        return sensor_rows(self.dynamics, "s", sensor, spread)


@cache
def sensor_twin(make: Make) -> SensorTwin:
    """A random robot with motors that turn either way; rods of a Par4 lie about its middle."""
    rng = np.random.default_rng(5)
    plain = random_composed(make, rng)
    corner = np.array([0.01, 0.06, 0.02])
    plain = replace(plain, corners=np.array([corner, -corner]))
    if make.kind == "h4":  # a tool that the middle bar can carry
        plain = replace(plain, tool=np.array([0.0, 0.0, -0.07]))
    cut = {name: _on_the_axis(rng) for name in {limb.strut_body for limb in plain.limbs}}
    bodies = plain.bodies | {name: _sum(plain.bodies[name], body) for name, body in cut.items()}
    plain = replace(plain, bodies=bodies)
    turns = rng.uniform(2, 9, plain.dof) * rng.choice([-1, 1], plain.dof)
    if make.linear:
        turns[: len(plain.limbs)] *= 2 * np.pi
    single = make.struts == 2 and make.kind in ("rigid", "h4")
    oracle = (StrutOracle if single else SensorOracle).with_sensors(plain, turns=turns, outer=cut)
    robot = describe(oracle, make)
    if single:
        robot = robot.changed(limbs=robot.limbs.changed(strut_spacing=SPACING))
    z, _, qd, qdd = random_states(oracle, rng, 4)
    return SensorTwin(Dynamics(robot), oracle, parameters(oracle), (z, qd, qdd))


def _on_the_axis(rng: np.random.Generator) -> Body:
    """A part of a strut with its centre of mass on the strut's axis."""
    body, place = random_body(rng, 0.2, 0.1), rng.uniform(0.4, 0.7)
    c = body.mc / body.m
    about_centre = body.inertia - body.m * (c @ c * np.eye(3) - np.outer(c, c))
    shift = body.m * place**2 * np.diag([0.0, 1.0, 1.0])
    return Body(body.m, np.array([body.m * place, 0.0, 0.0]), about_centre + shift)


def _sum(a: Body, b: Body) -> Body:
    return Body(a.m + b.m, a.mc + b.mc, a.inertia + b.inertia)


def dense(
    rows: SensorRows,
    states: tuple[np.ndarray, np.ndarray, np.ndarray],
    shown: np.ndarray | None = None,
) -> np.ndarray:
    """[C, D] at some states: samples × channels × (p, u)."""
    channels, columns = rows.pattern
    first = len(rows.dynamics.layout.parameters)
    if shown is None:
        shown = np.zeros((len(rows.channels), len(states[0])))
    found = np.zeros((len(states[0]), len(rows.channels), first + len(rows.parameters)))
    found[:, channels, columns] = rows.entries(*states, shown).T
    return found


def per_drive(twin: SensorTwin) -> dict[str, float]:
    """Turns of motors for a turn of their drives, or for a metre of a rail."""
    robot = twin.dynamics.robot
    return {
        drive: n / (2 * np.pi) if robot.is_linear(drive) else n
        for drive, n in zip(robot.drives, twin.oracle.turns.tolist(), strict=True)
    }


def plate(twin: SensorTwin | None = None, **more: Any) -> BaseWrench:
    """A sensor somewhere, turned, that knows the twin's motors and has no error of its own."""
    known = {"motor_turns": per_drive(twin)} if twin else {}
    own = {"position": PLACE, "rotation_deg": TURN, "force_bias": 0, "moment_bias": 0}
    return BaseWrench.model_validate({"kind": "base-wrench"} | own | known | more)


def axes() -> np.ndarray:
    """Of that sensor: intrinsic yaw, pitch, roll."""
    return Rotation.from_euler("ZYX", TURN[::-1], degrees=True).as_matrix()


def wrenches(twin: SensorTwin) -> np.ndarray:
    """What it shows, by the oracle."""
    states = zip(*twin.states, strict=True)
    return np.array([twin.oracle.base_wrench(*state, np.array(PLACE), axes()) for state in states])


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    scale = np.abs(expected).max()
    assert scale > 1.0
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)
