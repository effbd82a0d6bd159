"""Measured values in kg beside torques that nothing tells the scale of.

Torque constants that are all off by a share ε make all base parameters of torques larger by it. By
torques alone that is a matter of units, for whoever gives the drives what they recorded; but what a
scale says is in kg, and other bodies then take up the difference, more of it than ε.
"""

import numpy as np

from deltaid.dynamics.geometry import CONSTANTS
from deltaid.estimation.span import Span
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import uncertainty

# A change for one per cent counts beyond so many standard deviations; so many are named.
_MOVED, _NAMED = 0.5, 3


def torque_scale(problem: FittedProblem) -> tuple[str, ...]:
    """A sentence where measured values stand beside torques whose scale is taken for right."""
    known = any(CONSTANTS in one.tells for one in problem.additions)
    stated = problem.dynamics.robot.tolerances.torque_constants
    if problem.information.facts is None or known or stated:
        return ()
    found, own = uncertainty(problem), len(problem.p)
    # Slopes of least-squares base parameters by ε; sensors and measured values stay.
    information = problem.information
    columns = [group.representative for group in problem.base.groups]
    at = np.searchsorted(information.columns, columns)
    torques = information.of_drives.weighted()
    inverse = Span.of(information.weighted()[:, at]).inverse
    slopes = inverse @ (inverse.T @ (torques[:, at].T @ torques[:, -1]))
    more = 0.01 * slopes @ found.follows[:, :own]
    moved = np.abs(more) / np.where(found.std[:own] > 0, found.std[:own], np.inf)
    inertial = np.array([one.kind == "inertia" for one in problem.layout.parameters[:own]])
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
