"""What lengths, zeros, mounting, offsets and gains that are off do to sensors: exact slopes."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composed import SINGLE
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.geometry import across
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.model.parameter_record import Parameter
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce
from deltaid.sensors.robot_sensors import all_sensor_rows, sensor_errors, sensor_rows
from poor_priors import PLAIN
from sensed import recorded, sensed, weighed
from sensor_rows import CHANNELS, dense, plate, sensor_twin, wrenches
from support import along
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
    values = np.append(prior_parameters(robot), [parameter.prior for parameter in rows.parameters])
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
    z, q, qd, qdd = along(dynamics.kinematics, rng, np.linspace(0, 4, 20))
    (rows,) = all_sensor_rows(dynamics)
    was, values = shown(robot, q, qd, qdd)
    found = {
        sensor_error.name: sensor_error.effect
        for sensor_error in sensor_errors(rows, z, qd, qdd, values)
    }

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
    return {parameter.name: parameter for parameter in model.parameters}


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


def test_offsets_that_nobody_knows_are_ten_times_what_the_robot_weighs() -> None:
    robot = load_robot("clavel-delta3")
    m = {name: body.prior_parameters()[0] for name, body in robot.bodies.items()}
    weight = 9.81 * (3 * m["U"] + 6 * m["S"] + m["P"])
    above = BaseWrench(kind="base-wrench", position=(0.0, 0.0, 10.0))
    rows = sensor_rows(Dynamics(robot), "s", above)
    force, moment = rows.parameters[0].std, rows.parameters[3].std
    assert force == pytest.approx(10 * weight)
    farthest = 10.0 - robot.home[2]  # the platform
    assert moment == pytest.approx(10 * weight * farthest, rel=1e-6)


def test_errors_of_pose_and_gain_are_slopes_of_what_is_shown() -> None:
    twin = sensor_twin(SINGLE[1])
    sensor = plate(
        twin, force_bias=2.0, moment_bias=None, position_tolerance=1e-3, rotation_tolerance=2e-3,
        gain_tolerance=0.01,
    )  # fmt: skip
    rows = twin.rows(sensor, spread=0.25)
    names = [f"{channel}_bias" for channel in CHANNELS]
    names += [f"{what}_{axis}" for what in ("position", "rotation") for axis in "xyz"]
    assert [parameter.name for parameter in rows.parameters] == [
        f"{name}.s" for name in (*names, "gain")
    ]
    stds = [2.0] * 3 + [None] * 3 + [1e-3] * 3 + [2e-3] * 3 + [0.01]
    for parameter, std in zip(rows.parameters, stds, strict=True):
        assert parameter.std == pytest.approx(0.25 * parameter.scale)
        assert parameter.kind == "sensor"
        assert parameter.signed
        if std is not None:
            assert parameter.std == pytest.approx(std)
        else:
            assert parameter.std > 10 * 9.81 * twin.oracle.bodies["U"].m

    nominal = wrenches(twin)

    def shown(u: np.ndarray) -> np.ndarray:
        """Exactly: a sensor at its origin + δ in its axes, then turned by θ, offset, amplified."""
        turn = Rotation.from_rotvec(u[9:12]).as_matrix()
        f = nominal[:, :3] @ turn
        m = (nominal[:, 3:] - np.cross(u[6:9], nominal[:, :3])) @ turn
        return (np.hstack([f, m]) + u[:6]) / (1 - u[12])

    D = dense(rows, twin.states, nominal.T)[:, :, len(twin.p) :]
    h = 1e-4
    for k, e in enumerate(np.eye(13)):
        slope = (8 * (shown(h * e) - shown(-h * e)) - shown(2 * h * e) + shown(-2 * h * e)) / 12 / h
        np.testing.assert_allclose(D[:, :, k], slope, rtol=0, atol=1e-8 * np.abs(slope).max())


def test_one_channel_has_a_bias_and_a_gain() -> None:
    twin = sensor_twin(SINGLE[2])
    for sensor in (
        JointTorque(kind="joint-torque", drive="drive1", gain_tolerance=0.02),
        StrutForce(kind="strut-force", strut="strut1a", at="elbow", gain_tolerance=0.02),
    ):
        rows = twin.rows(sensor)
        assert [parameter.name for parameter in rows.parameters] == ["bias.s", "gain.s"]
        weight = 9.81 * sum(body.m for body in twin.oracle.bodies.values())
        assert rows.parameters[0].std > 10 * weight
        assert rows.parameters[0].unit == "N"
        shown = np.arange(1.0, 5.0)
        D = dense(rows, twin.states, shown[None])[:, 0, len(twin.p) :]
        np.testing.assert_array_equal(D, np.column_stack([np.ones(4), shown]))


def test_a_gain_is_reported_without_bias_about_what_a_fit_expects() -> None:
    """As measured, y and the gain's column share their noise, and the gain runs off towards one."""
    dynamics = Dynamics(load_robot("clavel-delta3"))
    p, scale = (
        np.array([getattr(parameter, what) for parameter in dynamics.layout.parameters])
        for what in ("prior", "scale")
    )
    rng, n, gain = np.random.default_rng(3), 1000, 0.03
    z, q, qd, qdd = along(dynamics.kinematics, rng, n)
    truth = p + 0.1 * scale * rng.standard_normal(len(p))
    rows = sensor_rows(
        dynamics, "s", BaseWrench(kind="base-wrench", force_bias=3.0, gain_tolerance=0.05)
    )
    states, first = (z, qd, qdd), len(p)
    noise, u = np.repeat([1.0, 0.1], 3), np.zeros(len(rows.parameters))
    u[:6], u[-1] = rng.uniform(-3, 3, 6), gain
    exact = rows.shown(np.append(truth, u), *states)
    y = exact + noise[:, None] * rng.standard_normal(exact.shape)
    tau = dynamics.regressor(q, qd, qdd).reshape(3 * n, -1)
    sigma = 0.02 * np.abs(tau @ truth).max()
    torque = tau @ truth + sigma * rng.standard_normal(3 * n)
    prior = np.append(p, np.zeros(len(u)))
    stds = np.append(0.5 * scale, [parameter.std for parameter in rows.parameters])

    def fitted(seen: np.ndarray) -> tuple[np.ndarray, float]:
        A = (dense(rows, states, seen) / noise[:, None]).reshape(6 * n, -1)
        wide = np.hstack([tau / sigma, np.zeros((3 * n, len(u)))])
        M = np.vstack([wide, A, np.diag(1 / stds)])
        b = np.concatenate([torque / sigma, (y.T / noise).ravel(), prior / stds])
        found = np.linalg.lstsq(M, b)[0]
        return found, float(np.sqrt(np.linalg.inv(M.T @ M)[-1, -1]))

    plain, std = fitted(y)
    assert plain[-1] > gain + 20 * std
    found = prior
    for _ in range(6):
        found, std = fitted(rows.shown(found, *states))
    assert abs(found[-1] - gain) < 3 * std
    np.testing.assert_allclose(found[first : first + 2], u[:2], atol=0.2)  # fz: U.m as well
    same = rows.about(found)
    assert (same.name, same.channels, same.parameters) == ("s", rows.channels, rows.parameters)
    expected = dense(rows, states, rows.shown(found, *states))
    np.testing.assert_allclose(dense(same, states), expected, rtol=1e-12)
