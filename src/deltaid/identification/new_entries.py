"""Entries of bodies that a sensor or a measured value shows and no torque does: they become free.

What `free` leaves out of a body costs a fit of torques nothing where torques do not show it. A new
row that does show it would take it for known exactly, and all intervals would be too narrow. So it
varies around the prior as it was before the reduction. An entry that torques show and that is not
free is a statement of the description, and stays; so does a body with `free: []`.
"""

import numpy as np
from jaxtyping import Int

from deltaid.dynamics.parameters import parameter_layout
from deltaid.robot.body import Body
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, entry_map


def with_new_entries(
    robot: RobotDescription,
    shown: Int[np.ndarray, " shown"],
    by_torques: Int[np.ndarray, " visible"],
) -> RobotDescription:
    """A description in which all that is shown for the first time is free.

    Args:
        shown: parameters that sensors and measured values show.
        by_torques: those that torques do.
    """
    layout = parameter_layout(robot)
    new = np.setdiff1d(shown, by_torques)
    bodies = {
        name: _freed(robot.bodies[name], new[(new >= part.start) & (new < part.stop)] - part.start)
        for name in layout.bodies
        for part in (layout.body(name),)
    }
    return robot if bodies == robot.bodies else robot.changed(bodies=bodies)


def _freed(body: Body, new: Int[np.ndarray, " new"]) -> Body:
    """A body with entries of M̄ free that some of its ten parameters, newly seen, consist of."""
    if not body.free or not len(new):
        return body
    consists = np.any(entry_map()[new] != 0, axis=0)
    entries = tuple(
        entry for k, entry in enumerate(PSEUDO_INERTIA_ENTRIES) if entry in body.free or consists[k]
    )
    return body if set(entries) == set(body.free) else body.changed(free=entries)
