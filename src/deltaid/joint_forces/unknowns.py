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
from functools import cached_property

import clarabel
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import definite, interior_point, svec
from deltaid.estimation.information import triangle
from deltaid.estimation.reduction import Block, Free, free_body, free_coefficients, joined
from deltaid.estimation.scatter import NORMAL
from deltaid.robot.body import reduced_prior
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, entry_map


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
    """Unknown numbers of a robot.

    Attributes:
        names: of the variables, such as 'S.mcx' or 'EE.Szz'.
        A, p_0: of p = A u + p_0.
        blocks: matrices that must be positive semidefinite; each has a unit diagonal at u = 0.
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
        blocks=tuple(_in_deviations(block, prior, size) for block in free.blocks),
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


def _in_deviations(
    block: Block, prior: Float[np.ndarray, " n"], size: Float[np.ndarray, " n"]
) -> ConsistencyBlock:
    """The block as a function of u, x = prior + size u.

    It is scaled by its diagonal alone: without the entries that are neither free nor hidden, a
    prior need not be consistent.
    """
    scaled = replace(block, prior=np.diag(np.diag(block.prior)))
    at, _, slopes = scaled.normalised
    return ConsistencyBlock(
        scaled.normalised_at(prior), tuple(at.tolist()), slopes * size[at, None, None]
    )


# Solver tolerance, relative to values in standard deviations: half of the digits.
_TOLERANCE = float(np.sqrt(np.finfo(float).eps))


class ConsistentBall:
    """Consistent unknowns u for which ‖R u − b‖² is within the 95 % bound of its optimum."""

    def __init__(self, data: Float[np.ndarray, "rows augmented"], unknown: ForceUnknowns) -> None:
        n, self._blocks = len(unknown.names), unknown.blocks
        factor = triangle(np.vstack([data, np.eye(n, n + 1)]))
        self._R = factor[:n, :n]
        self._u = solve_triangular(self._R, factor[:n, n])

    def largest(self, c: Float[np.ndarray, " n"]) -> float:
        """The largest value of c·u."""
        g = solve_triangular(self._R, c, trans="T")
        if (length := float(np.linalg.norm(g))) == 0:
            return 0.0
        u = self._u + solve_triangular(self._R, NORMAL * g / length)
        if self._consistent(self._u) and self._consistent(u):
            return float(c @ u)
        return float(c @ self._u + g @ self._solve(-g / length, self._radius))

    @cached_property
    def _radius(self) -> float:  # √(m² + 1.96²) of the ball
        if self._consistent(self._u):
            return NORMAL
        return float(np.hypot(np.linalg.norm(self._solve(None, None)), NORMAL))

    def _consistent(self, u: Float[np.ndarray, " n"]) -> bool:
        return all(np.linalg.eigvalsh(block.matrix(u))[0] >= 0 for block in self._blocks)

    def _solve(
        self, cost: Float[np.ndarray, " n"] | None, radius: float | None
    ) -> Float[np.ndarray, " n"]:
        """The consistent v of least cost with ‖v‖ ≤ radius, or of least norm without a radius.

        The last variable, t, bounds the norm.
        """
        n = len(self._u)
        S = solve_triangular(self._R, np.eye(n))
        rows, right, cones = [np.zeros((n + 1, n + 1))], [np.zeros(n + 1)], []
        rows[0][0, n], rows[0][1:, :n] = -1.0, -np.eye(n)
        cones.append(clarabel.SecondOrderConeT(n + 1))
        if radius is not None:
            rows.append(np.eye(1, n + 1, n))
            right.append(np.array([radius]))
            cones.append(clarabel.ZeroConeT(1))
        for block in self._blocks:
            slopes = svec(block.slopes).T
            rows.append(np.hstack([-slopes @ S[list(block.at)], np.zeros((len(slopes), 1))]))
            right.append(svec(block.matrix(self._u)))
            cones.append(definite(len(block.constant)))
        q = np.append(np.zeros(n), 1.0) if cost is None else np.append(cost, 0.0)
        solution = interior_point(q, np.vstack(rows), np.concatenate(right), cones, _TOLERANCE)
        if str(solution.status) not in ("Solved", "AlmostSolved"):
            raise IdentificationError(
                f"the range of a force was not found: the solver ended with {solution.status}",
                where="--logs",
                cure="check that these are the recordings that the model was identified from",
            )
        return np.array(solution.x)[:n]
