"""What one recording says, condensed: triangular factors of its rows, whole and in groups."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

# Of a recording: consecutive stretches of time, and places of the platform, the last of which takes
# in what is seldom visited. Together no more than 40 groups.
_STRETCHES, _PLACES, _FEWEST_PLACES = 26, 14, 6
# A file has no more bytes, of which so many are for what stands beside its factors; numbers of the
# whole take twice those of a group, and the rows with tolerances about one and a half.
_BYTES, _BESIDE, _GROUP, _WHOLES = 950_000, 90_000, 4, 3.5


def counts(sizes: Sequence[int]) -> tuple[int, int]:
    """How many stretches of time and places a file has room for.

    Args:
        sizes: columns of each drive's factors, τ among them.
    """
    entries = sum(n * (n + 1) // 2 for n in sizes)
    room = int((_BYTES - _BESIDE) / (_GROUP * entries) - _WHOLES)
    places = min(max(room - _STRETCHES, _FEWEST_PLACES), _PLACES)
    return max(min(_STRETCHES, room - places), 2), places


@dataclass(frozen=True, eq=False)
class Group:
    """Some samples: for each drive R with RᵀR = [G_i, τ_i]ᵀ[G_i, τ_i] over the columns it feels.

    Attributes:
        name: which samples: 'whole', 'time 3', 'place 2 0 1'.
        factors: upper triangular, one a drive; τ is the last column.
        samples: number of samples behind each.
        torque_max: largest |τ| of each.
    """

    name: str
    factors: tuple[Float[np.ndarray, "_ _"], ...]
    samples: Float[np.ndarray, " drives"]
    torque_max: Float[np.ndarray, " drives"]


@dataclass(frozen=True, eq=False)
class Groups:
    """Many groups, packed as a file holds them; each is unpacked as it is looked at.

    Attributes:
        names: of the groups.
        sizes: of each drive's triangles.
        packed: upper triangles row by row, one group after the other.
        samples, torque_max: as of `Group`.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    packed: Float[np.ndarray, "groups packed"]
    samples: Float[np.ndarray, "groups drives"]
    torque_max: Float[np.ndarray, "groups drives"]

    @classmethod
    def of(cls, groups: Iterable[Group]) -> "Groups":
        """Packed."""
        groups = tuple(groups)
        return cls(
            tuple(one.name for one in groups),
            tuple(R.shape[1] for R in groups[0].factors),
            np.stack([np.concatenate([packed(R) for R in one.factors]) for one in groups]),
            np.stack([one.samples for one in groups]),
            np.stack([one.torque_max for one in groups]),
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
                pieces = zip(np.split(self.packed[k], ends), self.sizes, strict=True)
                factors = tuple(unpacked(piece, n) for piece, n in pieces)
                yield Group(name, factors, self.samples[k], self.torque_max[k])


def packed(R: Float[np.ndarray, "rank n"]) -> Float[np.ndarray, " packed"]:
    """An upper triangle row by row; rows beyond the rank are zero."""
    n = R.shape[1]
    square = np.zeros((n, n))
    square[: len(R)] = R
    return square[_upper(n)]


def unpacked(row: Float[np.ndarray, " packed"], n: int) -> Float[np.ndarray, "n n"]:
    """The triangle again."""
    square = np.zeros((n, n))
    square[_upper(n)] = row
    return square


@cache
def _upper(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.triu_indices(n)


@dataclass(frozen=True, eq=False)
class Condensed:
    """A recording's factors.

    Attributes:
        names: of the columns that were gathered.
        felt: places of those that each drive feels among them.
        whole: all samples.
        groups: the same in stretches of time, then by place.
        geometry: some samples, with what tolerances of the description do to them before τ; None
            where there are none.
    """

    names: tuple[str, ...]
    felt: tuple[Int[np.ndarray, " _"], ...]
    whole: Group
    groups: Groups
    geometry: Group | None = None
