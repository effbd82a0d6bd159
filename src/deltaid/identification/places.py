"""What a recording says, place by place: sums of [Y, τ]ᵀ[Y, τ] over all visits to a place.

An error that comes with the pose (torque ripple, a wrong length, friction that changes along the
way) repeats whenever the robot comes back, and a motion of several periods does so all the time.
Stretches of time then agree with one another although all of them are wrong alike. Samples of the
same place, whenever it was visited, keep such errors together.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from deltaid.recording.log import Log

# Each of the platform's three coordinates is cut into so many parts of its range. Finer places part
# errors that belong together, coarser ones are too few to see a scatter.
_PARTS = 3

# Columns of [Y, τ] and their samples in rows.
Chunk = tuple[Int[np.ndarray, " _"], Float[np.ndarray, "_ samples"]]


class Places:
    """Running sums by place; `add` all samples, then read `sums`.

    Attributes:
        sums: [Y_i, τ_i]ᵀ[Y_i, τ_i] of every place and drive i.
    """

    def __init__(self, logs: Iterable[Log], drives: int, augmented: int) -> None:
        reaches = np.array([log.reach for log in logs])
        self._low = reaches[:, 0].min(axis=0)
        self._size = np.maximum(reaches[:, 1].max(axis=0) - self._low, np.finfo(float).tiny)
        self.sums: Float[np.ndarray, "places drives augmented augmented"] = np.zeros(
            (_PARTS**3, drives, augmented, augmented)
        )

    def add(self, z: Float[np.ndarray, "samples dof"], drives: Iterable[Chunk]) -> None:
        """Take in some samples: where the robot was, and each drive's rows of [Y, τ]."""
        parts = ((z[:, :3] - self._low) / self._size * _PARTS).astype(int)
        place = np.clip(parts, 0, _PARTS - 1) @ _PARTS ** np.arange(3)
        order = np.argsort(place, kind="stable")
        ends = np.searchsorted(place[order], np.arange(_PARTS**3 + 1))
        visited = np.flatnonzero(np.diff(ends))
        for i, (columns, samples) in enumerate(drives):
            ordered, at = samples[:, order], np.ix_(columns, columns)
            for k in visited:
                visit = ordered[:, ends[k] : ends[k + 1]]
                self.sums[k, i][at] += visit @ visit.T
