"""Parameters that are unknown before any recording, as p = A u + p_0.

u has one variable for each unknown number: u ~ N(0, 1) a priori, and the bodies must be
consistent. The unknowns are

- entries of pseudo-inertia matrices that the description leaves free, around its prior, and
- other entries that *no torque shows*, around the prior before its reduction. A fit of torques
  excludes them at no cost and so says nothing about them, but some constraint forces depend on
  them.

An entry that is not free but affects torques (products of inertia of a symmetric strut) is a
statement of the description and stays fixed; so does a body with `free: []`.

Ranges of forces are the largest values of linear functions of u over a ball and the cones of
physical consistency.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.reduction import Block, Free, free_body, free_coefficients, joined
from deltaid.robot.body import reduced_prior
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, entry_map


@dataclass(frozen=True)
class ForceUnknowns:
    """Unknown numbers of a robot.

    Attributes:
        names: of the variables, such as 'S.mcx' or 'EE.Szz'.
        A, p_0: of p = A u + p_0.
        prior, size: of the variables x = prior + size u.
        blocks: matrices of x that must be positive semidefinite.
    """

    names: tuple[str, ...]
    A: Float[np.ndarray, "parameters n"]
    p_0: Float[np.ndarray, " parameters"]
    prior: Float[np.ndarray, " n"]
    size: Float[np.ndarray, " n"]
    blocks: tuple[Block, ...]


def unknowns(
    robot: RobotDescription, visible: Bool[np.ndarray, " parameters"], spread: float
) -> ForceUnknowns:
    """The unknowns of a described robot.

    Args:
        visible: which parameters affect torques.
        spread: standard deviation of a diagonal entry M̄_ii or a coefficient relative to its prior,
            and of an off-diagonal entry relative to √(M̄_ii M̄_jj).
    """
    layout = parameter_layout(robot)
    parts = [_of_body(robot, body, visible[layout.body(body)]) for body in layout.bodies]
    free = joined([*parts, free_coefficients(layout.parameters[layout.coefficients])])
    prior = np.array([variable.prior for variable in free.variables])
    size = spread * np.array([variable.scale for variable in free.variables])
    return ForceUnknowns(
        names=tuple(variable.name for variable in free.variables),
        A=free.A * size,
        p_0=free.A @ prior + free.p_0,
        prior=prior,
        size=size,
        # Without the entries that are neither free nor hidden, a prior need not be consistent.
        blocks=tuple(replace(b, prior=np.diag(np.diag(b.prior))) for b in free.blocks),
    )


def _of_body(robot: RobotDescription, name: str, visible: Bool[np.ndarray, " 10"]) -> Free:
    """Free variables of a body; entries that no torque shows are free unless the body is known."""
    body, entries = robot.bodies[name], robot.bodies[name].free
    if entries:
        shown = (entry_map()[visible] != 0).any(axis=0)
        pairs = zip(PSEUDO_INERTIA_ENTRIES, shown, strict=True)
        hidden = [entry for entry, is_shown in pairs if not is_shown]
        entries = (*entries, *hidden)
    free, _ = free_body("inertia", name, reduced_prior(body.prior, entries), entries, visible)
    return free
