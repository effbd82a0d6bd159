"""What is not known about a robot's parameters before any recording, as p = A u + p_0.

u has one variable for each number that nobody knows: u ~ N(0, 1) a priori, and the bodies must be
consistent. These are

- the entries of pseudo-inertia matrices that the description leaves free, around its prior, and
- the entries that it does not leave free and that *no torque shows*. Leaving these out costs a fit
  of torques nothing, so it says nothing about them; constraint forces do depend on some. They are
  around the prior before its reduction.

An entry that torques show and that is not free (products of inertia of a symmetric strut) is a
statement of the description and stays; so does a body with `free: []`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import (
    PSEUDO_INERTIA_ENTRIES,
    RigidBody,
    entry_map,
    inertia_parameters,
    pseudo_inertia,
)


@dataclass(frozen=True)
class ConsistencyBlock:
    """A symmetric matrix constant + Σ u_k slopes_k that must be positive semidefinite."""

    constant: Float[np.ndarray, "k k"]
    at: tuple[int, ...]
    slopes: Float[np.ndarray, "variables k k"]

    def matrix(self, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k k"]:
        """The matrix at u."""
        return self.constant + np.tensordot(u[list(self.at)], self.slopes, axes=1)


@dataclass(frozen=True)
class ForceUnknowns:
    """The unknown numbers of a robot.

    Attributes:
        names: of the variables, such as 'S.mcx' or 'EE.Szz'.
        A, p_0: p = A u + p_0.
        blocks: what must be positive semidefinite; every matrix has a unit diagonal at u = 0.
    """

    names: tuple[str, ...]
    A: Float[np.ndarray, "parameters n"]
    p_0: Float[np.ndarray, " parameters"]
    blocks: tuple[ConsistencyBlock, ...]


def unknowns(
    robot: RobotDescription, visible: Bool[np.ndarray, " parameters"], spread: float
) -> ForceUnknowns:
    """The unknowns of a described robot.

    Args:
        visible: parameters that torques show.
        spread: standard deviation of a diagonal entry M̄_ii or a coefficient as a share of its
            prior, and of an off-diagonal entry as a share of √(M̄_ii M̄_jj).
    """
    layout = parameter_layout(robot)
    p_0 = prior_parameters(robot)
    names: list[str] = []
    columns: list[np.ndarray] = []
    blocks: list[ConsistencyBlock] = []
    for body in layout.bodies:
        part = layout.body(body)
        M, vary = _entries(robot, body, p_0[part], visible[part])
        p_0[part] = inertia_parameters(M)
        d = np.sqrt(np.diag(M))
        slopes = []
        for entry in vary:
            i, j = PSEUDO_INERTIA_ENTRIES[entry]
            slope = np.zeros((4, 4))
            slope[i, j] = slope[j, i] = spread
            slopes.append(slope)
            column = np.zeros(len(p_0))
            column[part] = inertia_parameters(slope * np.outer(d, d))
            columns.append(column)
        if slopes:
            at = tuple(range(len(names), len(names) + len(slopes)))
            blocks.append(ConsistencyBlock(M / np.outer(d, d), at, np.array(slopes)))
        names += [f"{body}.{entry}" for entry in vary]
    for k in range(10 * len(layout.bodies), len(p_0)):
        size = layout.signed[k] if k in layout.signed else float(p_0[k])
        columns.append(spread * size * np.eye(len(p_0))[k])
        if k not in layout.signed:
            blocks.append(ConsistencyBlock(np.eye(1), (len(names),), np.full((1, 1, 1), spread)))
        names.append(layout.names[k])
    return ForceUnknowns(tuple(names), np.column_stack(columns), p_0, tuple(blocks))


def _entries(
    robot: RobotDescription,
    body: str,
    reduced: Float[np.ndarray, " 10"],
    visible: Bool[np.ndarray, " 10"],
) -> tuple[Float[np.ndarray, "4 4"], list[str]]:
    """A body's M̄ without knowledge from recordings, and which of its entries are unknown."""
    free, to_p = robot.bodies[body].free, entry_map()
    M = pseudo_inertia(reduced)
    if not free:
        return M, []
    whole = pseudo_inertia(RigidBody(robot.bodies[body].prior_parameters()).with_thickness().p)
    vary = []
    for k, (entry, (i, j)) in enumerate(PSEUDO_INERTIA_ENTRIES.items()):
        hidden = not np.any(visible & (to_p[:, k] != 0))
        if entry in free or hidden:
            vary.append(entry)
            if entry not in free:
                M[i, j] = M[j, i] = whole[i, j]
    return M, vary
