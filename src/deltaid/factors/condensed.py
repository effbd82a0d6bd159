"""One recording condensed: triangular factors of its rows, whole and in groups."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Group:
    """Some samples: for each drive R with RᵀR = [G_i, τ_i]ᵀ[G_i, τ_i] over the columns it feels."""

    name: str  # which samples: 'whole', 'geometry', 'time 3', 'place 2 0 1'
    factors: tuple[Float[np.ndarray, "_ _"], ...]  # upper triangular; τ is the last column
    samples: Float[np.ndarray, " drives"]  # number of samples behind each
    torque_max: Float[np.ndarray, " drives"]  # largest |τ| of each


@dataclass(frozen=True, eq=False)
class Groups:
    """Many groups, packed as a file holds them, unpacked on access."""

    names: tuple[str, ...]
    sizes: tuple[int, ...]  # of each drive's triangles
    # upper triangles row by row, one drive after the other
    packed: Float[np.ndarray, "groups packed"]
    samples: Float[np.ndarray, "groups drives"]
    torque_max: Float[np.ndarray, "groups drives"]

    @classmethod
    def of(cls, groups: Iterable[Group]) -> "Groups":
        """Packed."""
        groups = tuple(groups)
        return cls(
            tuple(group.name for group in groups),
            tuple(R.shape[1] for R in groups[0].factors),
            np.stack([np.concatenate([packed(R) for R in group.factors]) for group in groups]),
            np.stack([group.samples for group in groups]),
            np.stack([group.torque_max for group in groups]),
        )

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Group]:
        return self.named("")

    def named(self, first: str) -> Iterator[Group]:
        """Those whose names begin so."""
        ends = np.cumsum([n * (n + 1) // 2 for n in self.sizes])[:-1]
        for k, name in enumerate(self.names):
            if name.startswith(first):
                factors = tuple(np.zeros((n, n)) for n in self.sizes)
                for R, numbers in zip(factors, np.split(self.packed[k], ends), strict=True):
                    R[_upper(len(R))] = numbers
                yield Group(name, factors, self.samples[k], self.torque_max[k])


def packed(R: Float[np.ndarray, "rank n"]) -> Float[np.ndarray, " packed"]:
    """An upper triangle row by row; rows beyond the rank are zero."""
    return np.pad(R, ((0, R.shape[1] - len(R)), (0, 0)))[_upper(R.shape[1])]


@cache
def _upper(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.triu_indices(n)


@dataclass(frozen=True, eq=False)
class Condensed:
    """A recording's factors."""

    names: tuple[str, ...]  # of the columns that were gathered
    felt: tuple[Int[np.ndarray, " _"], ...]  # places of those that each drive feels among them
    whole: Group  # all samples
    groups: Groups  # the same in stretches of time, then by place
    # some samples, with what tolerances of the description do to them before τ, if there are any
    geometry: Group | None = None
