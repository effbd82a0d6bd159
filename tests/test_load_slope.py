"""Friction by load, linear about what gears carry: slopes and torques of the true law."""

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.measured_rows import LoadSlope
from deltaid.motion.random_motion import random_motion
from deltaid.recording.windows import Samples
from deltaid.robot.load import load_robot


def test_columns_are_slopes_of_the_torques_and_their_sum_is_these() -> None:
    """τ(p) of a robot whose drives lose 5 % and 8 % of what they carry, without differences."""
    robot = load_robot("irb360-6-1600")
    laws = {drive: robot.friction[drive].changed(load=share)
            for drive, share in (("drive1", 0.05), ("drive4", 0.08))}  # fmt: skip
    dynamics = compiled(robot.changed(friction=dict(robot.friction) | laws))
    p, n = prior_parameters(dynamics.robot), 40
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0.3, motion.period, n))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    x = dynamics.carried(z, qd, qdd, p)
    w = Samples(np.arange(n) / n, z, qd, qdd, 0 * qd, 1 + 0 * qd, np.zeros((n, 0)), 0 * qd)
    slope = LoadSlope.about(dynamics, p)
    np.testing.assert_array_equal(slope.shares, [0.05, 0, 0, 0.08])
    factor = slope.factor(w, x)
    sparse = dynamics.sparse_regressor(z, qd, qdd, x)
    Y = np.zeros((4, len(p), n))
    Y[sparse.rows, sparse.columns] = slope.scaled(sparse.values, factor)
    torque = dynamics.torque(z, qd, qdd, p).T
    np.testing.assert_allclose(np.einsum("dks,k->ds", Y, p), torque + factor * x.T, atol=1e-9)
    for name in (
        "EE.Izz",
        "rotor.drive4",
        "U.mcx",
        "coulomb.slide",
        "coulomb.drive1",
        "load.drive4",
    ):
        k = dynamics.layout.names.index(name)
        step = 1e-4 * max(abs(p[k]), 1e-3) * np.eye(len(p))[k]
        up, down = (dynamics.torque(z, qd, qdd, p + s).T for s in (step, -step))
        at = np.abs(x.T) > 1e-3  # |x| has no slope where nothing is carried
        slopes = (up - down) / (2 * step[k])
        np.testing.assert_allclose(Y[:, k][at], slopes[at], atol=1e-6 * np.abs(slopes).max())
