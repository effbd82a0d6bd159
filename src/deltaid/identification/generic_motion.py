"""The base parameters of a robot as any generic motion determines them; no recording is needed."""

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.base_parameters import BaseParameters, base_parameters
from deltaid.identification.information import gather_samples
from deltaid.motion.random_motion import random_motion


def random_motion_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The base parameters that a generic motion within the robot's limits determines.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 2000))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau, load = np.zeros_like(z), None
    if dynamics.robot.load_drives:
        load = dynamics.carried(z, qd, qdd, prior_parameters(dynamics.robot))
    information = gather_samples(dynamics, z, qd, qdd, tau, load)
    return base_parameters(information, dynamics.layout)
