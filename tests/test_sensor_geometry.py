"""What lengths, zeros and mounting that are off do to sensors: slopes, and intervals that hold."""

from typing import Any

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.geometry import across
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.model.parameter_record import Parameter
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.sensors.geometry import sensor_errors
from deltaid.sensors.robot_sensors import all_sensor_rows
from poor_priors import PLAIN
from sensed import recorded, sensed, weighed
from sensor_rows import dense
from test_tolerances import longer

STEP = 1e-5  # m or rad
PLATE = {"kind": "base-wrench", "position": [0.1, -0.2, 0.3], "rotation_deg": [10, 20, 30]}
QUICK: list[tuple[str, dict[str, Any]]] = [
    ("irb360-6-1600", PLATE),
    ("clavel-delta3", {"kind": "strut-force", "strut": "strut2", "at": "elbow"}),
]
SLOW: list[tuple[str, dict[str, Any]]] = [
    ("h4", {"kind": "strut-force", "strut": "strut1", "at": "platform"}),
    ("linear-delta", {"kind": "strut-force", "strut": "strut3", "at": "middle"}),
    ("par4", {"kind": "joint-torque", "drive": "drive2"}),
]


def shown(
    robot: RobotDescription, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the robot's only sensor shows at its prior, (samples, channels), and its columns."""
    dynamics = Dynamics(robot)
    (rows,) = all_sensor_rows(dynamics)
    values = np.append(prior_parameters(robot), [one.prior for one in rows.parameters])
    Y = dense(rows, (dynamics.kinematics.forward(q), qd, qdd))
    return Y @ values, values


@pytest.mark.parametrize(
    ("name", "sensor"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)],
    ids=[f"{n}-{s['kind']}" for n, s in (*QUICK, *SLOW)],
)
def test_slopes_are_those_of_changed_robots(name: str, sensor: dict[str, Any]) -> None:
    ones = {"lengths": 0.05, "homing": 0.2, "mounting": 0.2}
    robot = load_robot(name).changed(tolerances=ones, sensors={"s": sensor})
    dynamics, rng = compiled(robot), np.random.default_rng(4)
    motion = random_motion(dynamics.kinematics, rng)
    z, zd, zdd = motion.evaluate(np.linspace(0, 4, 20))
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    (rows,) = all_sensor_rows(dynamics)
    was, values = shown(robot, q, qd, qdd)
    found = {one.name: one.effect for one in sensor_errors(rows, z, qd, qdd, values)}

    def agree(name: str, expected: np.ndarray) -> None:
        mine = found.get(name, np.zeros_like(expected.T))
        np.testing.assert_allclose(mine, expected.T, atol=2e-3 * np.abs(expected).max() + 1e-9)

    for length, limb in (("strut", 2), ("platform_radius", None)):
        later, _ = shown(longer(robot, length, STEP, limb), q, qd, qdd)
        agree(length if limb is None else f"{length} of limb {limb}", 0.05 / STEP * (later - was))
    for i, drive in enumerate(robot.drives[:2]):
        moved = q + STEP * np.eye(dynamics.dof)[i]
        agree(f"zero of {drive}", 0.2 / STEP * (shown(robot, moved, qd, qdd)[0] - was))
    gravity = np.array(robot.gravity)
    axis = across(gravity)[1]
    turned = gravity + 0.2 * np.cross(axis, gravity)
    leaning = robot.changed(gravity=tuple(turned.tolist()))
    agree(f"tilt about {np.round(axis, 3).tolist()}", shown(leaning, q, qd, qdd)[0] - was)


def deviations(case: str, **tolerances: float) -> dict[str, Parameter]:
    """Parameters of a robot at its prior, identified with a case's sensors or scales."""
    of, rng = sensed("clavel-delta3", case, 0.5), np.random.default_rng(2)
    p, exact = of.reduction.p_reg, {"lengths": 0.0, "homing": 0.0, "mounting": 0.0}
    robot = weighed(of, p, rng).changed(tolerances=exact | tolerances)
    model = identify(robot, recorded("clavel-delta3", of, p, rng), settings=PLAIN).model
    return {one.name: one for one in model.parameters}


def test_geometry_is_in_what_only_a_plate_shows() -> None:
    exact, rough = deviations("wrench, tared"), deviations("wrench, tared", lengths=5e-4)
    assert rough["P.mcy"].std > 2 * exact["P.mcy"].std
    share = rough["P.mcy"].share
    assert share.geometry > 0.7


def test_what_a_scale_says_does_not_go_with_lengths() -> None:
    exact, rough = (deviations("strut and platform weighed", lengths=size) for size in (0.0, 2e-3))
    assert rough["U.mcx"].std > 1.1 * exact["U.mcx"].std
    for name in ("S.m", "P.m"):
        assert rough[name].std == pytest.approx(exact[name].std, rel=0.1)
