"""Measured values in kg with torques whose scale nothing determines.

Torque constants that are all off by a share ε make all base parameters of torques larger by it. By
torques alone that is a matter of units, for whoever gives the drives what they recorded; but a
weighing is in kg, and other bodies then take up the difference, more of it than ε.
"""

import numpy as np

from deltaid.dynamics.geometry import CONSTANTS
from deltaid.estimation.span import Span
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import uncertainty

# A change for one per cent counts beyond so many standard deviations; so many are named.
_MOVED, _NAMED = 0.5, 3


def torque_scale(problem: FittedProblem) -> tuple[str, ...]:
    """A sentence where measured values meet torques whose scale is assumed to be right."""
    known = any(CONSTANTS in addition.tells for addition in problem.additions)
    stated = problem.dynamics.robot.tolerances.torque_constants
    if problem.information.facts is None or known or stated:
        return ()
    errors, count = uncertainty(problem), len(problem.p)
    # Slopes of least-squares base parameters by ε; sensors and measured values stay.
    information = problem.information
    columns = [group.representative for group in problem.base.groups]
    places = np.searchsorted(information.columns, columns)
    torques = information.of_drives.weighted()
    inverse = Span.of(information.weighted()[:, places]).inverse
    slopes = inverse @ (inverse.T @ (torques[:, places].T @ torques[:, -1]))
    more = 0.01 * slopes @ errors.follows[:, :count]
    moved = np.abs(more) / np.where(errors.std[:count] > 0, errors.std[:count], np.inf)
    inertial = np.array([entry.kind == "inertia" for entry in problem.layout.parameters[:count]])
    order = [k for k in np.argsort(-moved) if inertial[k] and moved[k] > _MOVED][:_NAMED]
    if not order:
        return ()
    names = ", ".join(
        f"{problem.layout.names[k]} by {100 * abs(more[k] / problem.p[k]):.2g} %" for k in order
    )
    return (
        "values measured in kg stand beside torques that nothing tells the scale of: for each per "
        f"cent that all torque constants are off, {names}, and intervals take them for exact. "
        "State how good they are (`tolerances: {torque_constants: 0.03}` for 3 %), or record a "
        "known load, a plate or a torque sensor, which tell them",
    )
