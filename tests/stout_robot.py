"""A robot with stout bodies, whose posterior can be drawn by rejection, too."""

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from posteriors import ten

ROBOT = "clavel-delta3"


def stout() -> RobotDescription:
    """The robot with bodies that are about as thick as long: of thin ones hardly any draw of a
    normal distribution can exist, and rejection would take for ever."""
    robot = load_robot(ROBOT)
    shapes = {
        "U": (1.0, (0.2, 0.0, 0.02), (0.15, 0.12, 0.1)),
        "S": (0.2, (0.5, 0.0, 0.0), (0.3, 0.25, 0.2)),
        "P": (1.0, (0.0, 0.0, 0.0), (0.06, 0.05, 0.04)),
    }
    bodies = {}
    for name, (m, centre, radii) in shapes.items():
        M = m * np.outer([*centre, 1.0], [*centre, 1.0]) + np.diag([*(m * np.square(radii)), 0.0])
        bodies[name] = robot.bodies[name].changed(prior=ExplicitInertia.of(ten(M)))
    return robot.changed(bodies=bodies)


def truth(robot: RobotDescription) -> np.ndarray:
    """Friction above the prior's, and hardly any in one drive."""
    layout, p = compiled(robot).layout, prior_parameters(robot)
    p[layout.friction] *= 1.5
    p[layout.coulomb.start] = 5e-3
    return p
