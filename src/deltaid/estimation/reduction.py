"""The free variables of a fit (Sec. VI a–g), as an affine map and a product of cones.

The free variables x are entries of the bodies' pseudo-inertia matrices (12), friction coefficients
and rotor inertias, p = A x + p_0. x is physically consistent if every block M_b(x), affine in x, is
positive definite. A block is a principal submatrix of a body's M̄ with connected entries, or a
coefficient that must be positive. Diagonal entries that are neither free nor in any torque belong
to no block: they can be as large as needed, and are completed afterwards.

All solvers search {M̄ ≻ ε M̄_prior}, so that results are strictly consistent; ε is `levels.FAINT`.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.parameters import (
    ParameterLayout,
    least_margin,
    parameter_layout,
    stated_spreads,
)
from deltaid.errors import IdentificationError
from deltaid.robot.body import Entry, Prior, reduced_prior
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import (
    INERTIA_UNITS,
    PSEUDO_INERTIA_ENTRIES,
    consistency,
    entry_map,
    inertia_parameters,
    pseudo_inertia,
)
from deltaid.robot.parameter import PRIOR_SPREAD, ParameterKind, PriorParameter

# Share by which a completed mass or moment exceeds the least that keeps its body consistent.
_COMPLETION_MARGIN = 0.05

# Variables of a block, its constant part, and its slope along each variable.
Affine = tuple[Int[np.ndarray, " own"], Float[np.ndarray, "k k"], Float[np.ndarray, "own k k"]]


@dataclass(frozen=True)
class Block:
    """A symmetric matrix, affine in x, that must be positive definite."""

    index: Int[np.ndarray, "k k"]  # position in x of each entry, or −1 where the entry is constant
    constant: Float[np.ndarray, "k k"]  # values of the constant entries, 0 elsewhere
    prior: Float[np.ndarray, "k k"]  # the matrix at the prior, positive definite

    def matrix(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k k"]:
        return self.constant + np.where(self.index >= 0, x[self.index], 0.0)

    @cached_property
    def normalised(self) -> Affine:
        """Constant and slopes of L⁻¹ M L⁻ᵀ with a prior of L Lᵀ, which becomes the identity."""
        variables = np.unique(self.index[self.index >= 0])
        root = np.linalg.solve(np.linalg.cholesky(self.prior), np.eye(len(self.prior)))
        slopes = root @ (self.index == variables[:, None, None]) @ root.T
        return variables, root @ self.constant @ root.T, slopes

    def normalised_at(self, x: Float[np.ndarray, "*points n"]) -> Float[np.ndarray, "*points k k"]:
        """The matrix L⁻¹ M(x) L⁻ᵀ."""
        variables, constant, slopes = self.normalised
        return constant + np.tensordot(x[..., variables], slopes, axes=1)

    def moved(self, first: int) -> "Block":
        return replace(self, index=np.where(self.index >= 0, self.index + first, -1))


@dataclass(frozen=True, eq=False)
class Free:
    """Free variables of some consecutive entries of p, p = A x + p_0, with their blocks."""

    variables: tuple[PriorParameter, ...]
    A: Float[np.ndarray, "entries n"]
    p_0: Float[np.ndarray, " entries"]
    blocks: tuple[Block, ...]


def joined(parts: Sequence[Free]) -> Free:
    """Free variables of parts of p that follow one another."""
    firsts = np.cumsum([0, *(part.A.shape[1] for part in parts)]).tolist()
    p_0 = np.concatenate([part.p_0 for part in parts])
    # SciPy's block_diag would take longer to load than all that `deltaid base` computes.
    A, row = np.zeros((len(p_0), firsts[-1])), 0
    for part, first in zip(parts, firsts, strict=False):
        height, width = part.A.shape
        A[row : row + height, first : first + width] = part.A
        row += height
    blocks = tuple(
        block.moved(first)
        for part, first in zip(parts, firsts, strict=False)
        for block in part.blocks
    )
    return Free(tuple(variable for part in parts for variable in part.variables), A, p_0, blocks)


def free_coefficients(parameters: Sequence[PriorParameter]) -> Free:
    """Independent free coefficients, positive unless signed."""
    blocks = tuple(
        Block(np.array([[k]]), np.zeros((1, 1)), entry.prior * np.eye(1))
        for k, entry in enumerate(parameters)
        if not entry.signed
    )
    return Free(tuple(parameters), np.eye(len(parameters)), np.zeros(len(parameters)), blocks)


def free_body(
    kind: ParameterKind,
    body: str,
    p_reg: Float[np.ndarray, " 10"],
    free: Collection[str],
    is_visible: Bool[np.ndarray, " 10"],
) -> tuple[Free, tuple[int, ...]]:
    """Free variables of a body's ten parameters, and rows of M̄ to complete.

    Torques depend on the visible parameters. Entries of M̄ that are not free keep the values of the
    consistent prior p_reg.
    """
    M, to_p = pseudo_inertia(p_reg), entry_map()
    variables, columns, completed = list[PriorParameter](), list[np.ndarray](), list[int]()
    index, p_0 = np.full((4, 4), -1), np.zeros(10)
    for k, (entry, (i, j)) in enumerate(PSEUDO_INERTIA_ENTRIES.items()):
        if entry in free:
            index[i, j] = index[j, i] = len(variables)
            low, scale = 0.0 if i == j else -np.inf, float(np.sqrt(M[i, i] * M[j, j]))
            prior, unit = float(M[i, j]), INERTIA_UNITS[k]
            variables.append(PriorParameter(kind, body, entry, unit, low, np.inf, prior, scale))
            columns.append(to_p[:, k])
        else:
            p_0 += to_p[:, k] * M[i, j]
            if i == j and not is_visible[np.abs(to_p[:, k]) > 0].any():
                completed.append(i)
    A = np.reshape(columns, (len(columns), 10)).T
    blocks = tuple(_blocks(index, M, np.setdiff1d(range(4), completed)))
    return Free(tuple(variables), A, p_0, blocks), tuple(sorted(completed))


def _blocks(
    index: Int[np.ndarray, "4 4"], M: Float[np.ndarray, "4 4"], rows: Int[np.ndarray, " rows"]
) -> Iterator[Block]:
    """The smallest independent blocks of some rows of a body's M̄."""
    inner = np.ix_(rows, rows)
    for part in connected((index[inner] >= 0) | (M[inner] != 0)):
        ix = np.ix_(rows[part], rows[part])
        if np.any(index[ix] >= 0):  # others are constant and consistent, since the prior is
            yield Block(index[ix], np.where(index[ix] < 0, M[ix], 0.0), M[ix])


def connected(linked: Bool[np.ndarray, "n n"]) -> list[Int[np.ndarray, " _"]]:
    """Connected rows of a symmetric matrix, by the entries that link two rows."""
    steps = linked.astype(int) + np.eye(len(linked), dtype=int)
    together = np.linalg.matrix_power(steps, len(linked)) > 0
    return [np.flatnonzero(part) for part in np.unique(together, axis=0)[::-1]]


@dataclass(frozen=True)
class Reduction:
    """The free variables of a robot."""

    layout: ParameterLayout
    # entries of a body's M̄, whose scale is √(M̄_ii M̄_jj), or coefficients of a joint
    variables: tuple[PriorParameter, ...]
    A: Float[np.ndarray, "parameters n"]  # p = A x + p_0
    p_0: Float[np.ndarray, " parameters"]
    blocks: tuple[Block, ...]  # what must be positive definite
    p_reg: Float[np.ndarray, " parameters"]  # p at the prior, reduced
    completed: dict[str, tuple[int, ...]]  # rows of each body's M̄ whose diagonal is completed
    # stated prior spread over that of the fit, of entries of p where it is stated
    stated: Mapping[str, float] = field(default_factory=dict[str, float])
    # factor by which a prior is widened, of entries that the recording contradicts (`widening`)
    widened: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def size(self) -> int:
        return len(self.variables)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free variables, such as 'S.mcx', 'EE.Sxx', 'viscous.drive1'."""
        return tuple(variable.name for variable in self.variables)

    @property
    def wider(self) -> Float[np.ndarray, " parameters"]:
        """Width of the prior of each entry of p over that by the spread of the fit."""
        return self.factors(self.stated) * self.factors(self.widened)

    def factors(self, named: Mapping[str, float]) -> Float[np.ndarray, " parameters"]:
        """`stated` or `widened` of each entry of p."""
        return np.array([named.get(name, 1.0) for name in self.layout.names])

    @cached_property
    def prior(self) -> Float[np.ndarray, " n"]:
        return np.array([variable.prior for variable in self.variables])

    @cached_property
    def scale(self) -> Float[np.ndarray, " n"]:
        """A typical size of each variable."""
        return np.array([variable.scale for variable in self.variables])

    def parameters(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " parameters"]:
        """p for free variables x, with completed entries.

        Raises:
            IdentificationError: x is not consistent.
        """
        p = self.A @ x + self.p_0
        for body in self.layout.bodies:
            part = self.layout.body(body)
            p[part] = _complete(p[part], self.completed[body])
        worst, margin = least_margin(self.layout, p)
        if margin <= 0:
            raise IdentificationError(
                f"the result for {worst} is not physically consistent",
                where=f"bodies.{worst}" if worst in self.layout.bodies else worst,
                cure="check sign and unit of torques and positions, the robot's lengths and its "
                "prior; where these are right, set a larger --gamma",
            )
        return p


def build_reduction(
    robot: RobotDescription,
    visible: Int[np.ndarray, " columns"],
    additions: Sequence[tuple[Sequence[PriorParameter], Free]] = (),
    spread: float = PRIOR_SPREAD,
) -> Reduction:
    """The reduction of a described robot.

    Args:
        visible: numbers of the parameters that torques depend on.
        additions: parameters of each addition, with their free variables.
        spread: of the prior, where the description states none.

    Raises:
        IdentificationError: the prior is not consistent after the reduction.
    """
    layout = parameter_layout(robot)
    is_visible = np.isin(np.arange(len(layout.names)), visible)
    parts, completed = list[Free](), dict[str, tuple[int, ...]]()
    for body in layout.bodies:
        own, seen = robot.bodies[body], tuple(is_visible[layout.body(body)].tolist())
        part, completed[body] = _of_body(body, own.prior, own.free, seen)  # pyright: ignore[reportArgumentType]
        parts.append(part)
    parts.append(free_coefficients(layout.parameters[layout.coefficients]))
    parts += [free for _, free in additions]
    added = (parameter for group, _ in additions for parameter in group)
    layout = ParameterLayout((*layout.parameters, *added), layout.bodies)
    free = joined(parts)
    return Reduction(
        layout=layout,
        variables=free.variables,
        A=free.A,
        p_0=free.p_0,
        blocks=free.blocks,
        p_reg=np.array([parameter.prior for parameter in layout.parameters]),
        completed=completed,
        stated={name: stated / spread for name, stated in stated_spreads(robot).items()},
    )


@lru_cache(maxsize=256)  # fits of other columns have the same bodies
def _of_body(
    body: str, prior: Prior, free: tuple[Entry, ...], is_visible: tuple[bool, ...]
) -> tuple[Free, tuple[int, ...]]:
    p_reg = reduced_prior(prior, free)
    if consistency(p_reg) <= 0:
        raise IdentificationError(
            f"with the entries that 'free' excludes set to zero, the prior of body {body} is "
            "not consistent",
            where=f"bodies.{body}",
            cure="free the first moments of its centre of mass, or change the prior",
        )
    return free_body("inertia", body, p_reg, free, np.array(is_visible))


def _complete(p: Float[np.ndarray, " 10"], completed: tuple[int, ...]) -> Float[np.ndarray, " 10"]:
    """Raise completed diagonal entries of M̄ where the rest of the body needs it (Schur)."""
    M = pseudo_inertia(p)
    known = [i for i in range(4) if i not in completed]
    for i in completed:
        coupling = M[known, i]
        if np.any(coupling):
            lowest = coupling @ np.linalg.solve(M[np.ix_(known, known)], coupling)
            M[i, i] = max(M[i, i], (1 + _COMPLETION_MARGIN) * lowest)
        known.append(i)
    return inertia_parameters(M)
