"""A recording place by place: sums of [Y, τ]ᵀ[Y, τ] over all visits to a place.

An error that comes with the pose (torque ripple, a wrong length, friction that changes along the
way) repeats whenever the robot comes back, so stretches of time agree although all are wrong alike.
Samples of the same place, whenever it was visited, keep such errors together.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from deltaid.estimation.information import Chunk
from deltaid.recording.recording import Recording

# Each coordinate of the platform point is cut into so many parts of its range. Finer places part
# errors that belong together, coarser ones are too few to see a scatter.
_PARTS = 3

# Columns of a chunk, and its product with itself at each place.
Visits = tuple[Int[np.ndarray, " _"], Float[np.ndarray, "places _ _"]]


class Places:
    """Running sums by place; `add` the `visits` of all samples, then read `sums`.

    Places are parts of a box [m], lowest and highest corner, along each axis. A sample has a row
    for each drive (or channel), and [Y, τ] so many augmented columns.
    """

    def __init__(
        self,
        box: Float[np.ndarray, "2 3"],
        drives: int,
        augmented: int,
        parts: tuple[int, int, int] = (_PARTS, _PARTS, _PARTS),
    ) -> None:
        self._low, self._parts = box[0], np.array(parts)
        self._size = np.maximum(box[1] - box[0], np.finfo(float).tiny)
        self._shape = int(np.prod(parts)), drives, augmented, augmented
        self._totals: list[Visits] = []

    @classmethod
    def over(cls, recordings: Iterable[Recording], drives: int, augmented: int) -> "Places":
        """Empty places over the range that recordings cover together."""
        reaches = np.array([recording.log.reach for recording in recordings])
        box = np.stack([reaches[:, 0].min(axis=0), reaches[:, 1].max(axis=0)])
        return cls(box, drives, augmented)

    def visits(self, r: Float[np.ndarray, "samples 3"], drives: Iterable[Chunk]) -> list[Visits]:
        """Some samples by place: the platform point r there, and each drive's rows of [Y, τ]."""
        parts = ((r - self._low) / self._size * self._parts).astype(int)
        place = np.clip(parts, 0, self._parts - 1) @ np.cumprod([1, *self._parts[:-1]])
        order, count = np.argsort(place, kind="stable"), self._shape[0]
        ends = np.searchsorted(place[order], np.arange(count + 1))
        visits = []
        for columns, samples in drives:
            products = np.zeros((count, len(columns), len(columns)))
            ordered = samples[:, order]
            for k in np.flatnonzero(np.diff(ends)):
                inside = ordered[:, ends[k] : ends[k + 1]]
                np.matmul(inside, inside.T, out=products[k])
            visits.append((columns, products))
        return visits

    def add(self, visits: list[Visits]) -> None:
        if not self._totals:
            self._totals = [(columns, np.zeros_like(products)) for columns, products in visits]
        for (_, total), (_, products) in zip(self._totals, visits, strict=True):
            total += products

    @property
    def sums(self) -> Float[np.ndarray, "places drives augmented augmented"]:
        """[Y_i, τ_i]ᵀ[Y_i, τ_i] of every place and drive i."""
        sums = np.zeros(self._shape)
        for i, (columns, total) in enumerate(self._totals):
            sums[:, i, columns[:, None], columns] = total
        return sums
