"""Unknowns of the sensors themselves: offsets, gains and errors of pose, against exact formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composed import SINGLE
from deltaid.dynamics.dynamics import Dynamics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce
from deltaid.sensors.about import about
from deltaid.sensors.robot_sensors import sensor_rows
from sensor_rows import CHANNELS, dense, plate, sensor_twin, wrenches


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
    names = [f"{one}_bias" for one in CHANNELS]
    names += [f"{what}_{axis}" for what in ("position", "rotation") for axis in "xyz"]
    assert [one.name for one in rows.parameters] == [f"{one}.s" for one in (*names, "gain")]
    stds = [2.0] * 3 + [None] * 3 + [1e-3] * 3 + [2e-3] * 3 + [0.01]
    for one, std in zip(rows.parameters, stds, strict=True):
        assert one.std == pytest.approx(0.25 * one.scale)
        assert one.kind == "sensor"
        assert one.signed
        if std is not None:
            assert one.std == pytest.approx(std)
        else:
            assert one.std > 10 * 9.81 * twin.oracle.bodies["U"].m

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
        assert [one.name for one in rows.parameters] == ["bias.s", "gain.s"]
        weight = 9.81 * sum(body.m for body in twin.oracle.bodies.values())
        assert rows.parameters[0].std > 10 * weight
        assert rows.parameters[0].unit == "N"
        shown = np.arange(1.0, 5.0)
        D = dense(rows, twin.states, shown[None])[:, 0, len(twin.p) :]
        np.testing.assert_array_equal(D, np.column_stack([np.ones(4), shown]))


def test_a_gain_is_told_without_bias_about_what_a_fit_expects() -> None:
    """As measured, y and the gain's column share their noise, and the gain runs off towards one."""
    dynamics = Dynamics(load_robot("clavel-delta3"))
    p, scale = (
        np.array([getattr(one, what) for one in dynamics.layout.parameters])
        for what in ("prior", "scale")
    )
    rng, n, gain = np.random.default_rng(3), 1000, 0.03
    motion = random_motion(dynamics.kinematics, rng)
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, n, endpoint=False))
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    truth = p + 0.1 * scale * rng.standard_normal(len(p))
    rows = sensor_rows(
        dynamics, "s", BaseWrench(kind="base-wrench", force_bias=3.0, gain_tolerance=0.05)
    )
    states, first = (z, qd, qdd), len(p)
    noise, u = np.repeat([1.0, 0.1], 3), np.zeros(len(rows.parameters))
    u[:6], u[-1] = rng.uniform(-3, 3, 6), gain
    exact = about(rows, np.append(truth, u)).expected(*states)
    y = exact + noise[:, None] * rng.standard_normal(exact.shape)
    tau = dynamics.regressor(q, qd, qdd).reshape(3 * n, -1)
    sigma = 0.02 * np.abs(tau @ truth).max()
    torque = tau @ truth + sigma * rng.standard_normal(3 * n)
    prior = np.append(p, np.zeros(len(u)))
    stds = np.append(0.5 * scale, [one.std for one in rows.parameters])

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
        found, std = fitted(about(rows, found).expected(*states))
    assert abs(found[-1] - gain) < 3 * std
    np.testing.assert_allclose(found[first : first + 2], u[:2], atol=0.2)  # fz: U.m as well
    same = about(rows, found)
    assert (same.name, same.channels, same.parameters) == ("s", rows.channels, rows.parameters)
    expected = dense(rows, states, same.expected(*states))
    np.testing.assert_array_equal(dense(same, states), expected)
