"""How large a robot and its forces are: what unknown offsets of sensors are compared with."""

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics

# An offset that nobody knows is a priori so many times what the sensor shows at rest.
_WIDE = 10.0
_G = 9.81


def wide_force(dynamics: Dynamics) -> float:
    """Standard deviation of an unknown offset of a force [N]: ten times the robot's weight."""
    robot = dynamics.robot
    masses = (
        body.count * robot.bodies[body.name].prior_parameters()[0]
        for body in dynamics.kinematics.mechanism.bodies
    )
    return float(_WIDE * _G * sum(masses))


def wide_moment(dynamics: Dynamics, about: Float[np.ndarray, " 3"]) -> float:
    """The same of a moment [N m]: ten times the weight at the body farthest from a point."""
    mechanism = dynamics.kinematics.mechanism
    origins = [ca.DM(body.R_WL) @ body.origin.at for body in mechanism.bodies]
    places = ca.Function("origins", [mechanism.z], [ca.horzcat(*origins)])
    ways = np.array(places(dynamics.kinematics.home)).T - about
    return wide_force(dynamics) * float(np.linalg.norm(ways, axis=1).max())
