"""Free variables of a body in a fit: entries of its pseudo-inertia matrix, the map to its
parameters, and the blocks that keep it consistent."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.robot.inertia import (
    INERTIA_UNITS,
    PSEUDO_INERTIA_ENTRIES,
    entry_map,
    pseudo_inertia,
)
from deltaid.robot.parameter import Parameter, ParameterKind

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
        """The same where the variables that it counts from 0 begin at `first`."""
        return replace(self, index=np.where(self.index >= 0, self.index + first, -1))


@dataclass(frozen=True, eq=False)
class Free:
    """What a fit may change of some consecutive entries of p: p = A x + p_0, as of `Reduction`,
    blocks counting from 0."""

    variables: tuple[Parameter, ...]
    A: Float[np.ndarray, "entries n"]
    p_0: Float[np.ndarray, " entries"]
    blocks: tuple[Block, ...]


def free_coefficients(parameters: Sequence[Parameter]) -> Free:
    """Coefficients that are free one by one, positive unless they are signed."""
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
    """What is free of ten parameters, of which torques show the visible ones, and rows of M̄ to
    complete; entries of M̄ that are not free keep the values of the consistent prior p_reg."""
    M, to_p = pseudo_inertia(p_reg), entry_map()
    variables, columns, completed = list[Parameter](), list[np.ndarray](), list[int]()
    index, p_0 = np.full((4, 4), -1), np.zeros(10)
    for k, (entry, (i, j)) in enumerate(PSEUDO_INERTIA_ENTRIES.items()):
        if entry in free:
            index[i, j] = index[j, i] = len(variables)
            low, scale = 0.0 if i == j else -np.inf, float(np.sqrt(M[i, i] * M[j, j]))
            prior, unit = float(M[i, j]), INERTIA_UNITS[k]
            variables.append(Parameter(kind, body, entry, unit, low, np.inf, prior, scale))
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
    """Rows of a symmetric matrix that hang together, by the entries that link two of them."""
    steps = linked.astype(int) + np.eye(len(linked), dtype=int)
    together = np.linalg.matrix_power(steps, len(linked)) > 0
    return [np.flatnonzero(part) for part in np.unique(together, axis=0)[::-1]]
