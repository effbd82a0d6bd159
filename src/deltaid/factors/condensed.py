"""What one recording says, condensed: triangular factors of its rows, whole and in groups."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

# Of a recording: consecutive stretches of time, and places of the platform, the last of which takes
# in what is seldom visited. Together no more than 40 groups.
STRETCHES, PLACES = 26, 14


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
    groups: tuple[Group, ...]
    geometry: Group | None = None

    def over(self, group: Group) -> Float[np.ndarray, "drives augmented augmented"]:
        """Factors of a group over all columns and τ."""
        n = len(self.names)
        wide = np.zeros((len(group.factors), n + 1, n + 1))
        for i, (R, at) in enumerate(zip(group.factors, self.felt, strict=True)):
            wide[i][: len(R), np.append(at, n)] = R
        return wide
