"""Filtered torques by way of momentum: equal to inverse dynamics, and to what a load takes."""

import casadi as ca
import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.random_motion import random_motion
from deltaid.online.momentum import Lowpass, build_momentum, filtered_torque
from deltaid.robot.load import load_robot

CORNER = 80.0


def along(name: str, rate: float, load: np.ndarray) -> np.ndarray:
    """The largest residual with a load, and what is left of it without the load's columns."""
    dynamics = compiled(load_robot(name))
    rest = dict.fromkeys(dynamics.robot.friction_joints, 1e-6)
    m = build_momentum(dynamics.robot, dynamics.kinematics.mechanism, rest)
    body = dynamics.layout.body("EE" if "EE" in dynamics.layout.bodies else "P")
    p, loaded = dynamics.p.copy(), dynamics.p.copy()
    p[dynamics.layout.friction] = loaded[dynamics.layout.friction] = 0.0
    loaded[body] += load
    motion = random_motion(dynamics.kinematics, np.random.default_rng(3), period=4.0)
    z, zd, zdd = motion.evaluate(np.arange(round(0.4 * rate)) / rate)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, loaded)

    directions = np.column_stack([p, np.eye(p.size)[:, body] @ load])
    kept, torque, kept_torque = (
        ca.SX.sym("k", m.qd.numel(), 2),
        ca.SX.sym("t", m.qd.numel()),
        m.load,
    )
    lines = Lowpass.lines(CORNER, 1 / rate)
    f = filtered_torque(m.H @ directions, m.W @ directions, kept, lines, CORNER)
    filtered = lines.output(kept_torque, torque)
    state = ca.veccat(f.kept, lines.keep(filtered, torque))
    outputs = ca.veccat(filtered - f.output[:, 0], f.output[:, 1])
    cycle = ca.Function(
        "f", [ca.veccat(kept, kept_torque), ca.vertcat(m.z, m.qd, torque)], [state, outputs]
    )
    begin = ca.Function("f", [m.z, m.qd, torque], [ca.veccat(f.resting, lines.before * torque)])
    first = begin(z[0], qd[0], tau[0])
    inputs = np.hstack([z, qd, tau])[1:].T
    out = np.array(cycle.mapaccum(inputs.shape[1])(first, inputs)[1])
    residual, taken = np.split(out, 2)
    return np.array([np.abs(residual).max(), np.abs(residual - taken).max()])


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "linear-delta", "h4"])
def test_a_residual_is_what_the_load_takes(name: str) -> None:
    load = np.array([1.2, 0.06, -0.03, 0.02, 0.01, 0.012, 0.014, 0.001, -0.001, 0.0015])
    coarse, fine = (along(name, rate, load) for rate in (1000.0, 2000.0))
    assert coarse[0] > 1.0
    assert coarse[1] < 2e-3 * coarse[0]
    assert fine[1] < 0.3 * coarse[1]  # of second order in the period
