"""From the rows of a segment to windows of samples (z, q̇, q̈, τ), filtered where needed.

A segment is a run of rows without a gap. No filter reaches beyond its ends.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.columns import Columns
from deltaid.recording.filter import LowPass, apply, convolve
from deltaid.recording.table import recut

# Samples of a window: long against the filter's length, short against memory, and no power of two,
# because rows of an array that lie a power of two apart fight for the same lines of the cache.
WINDOW = 8000

# Rows that the first stage of a filter takes at a time; few samples remain of them.
_LEAD_ROWS = 1 << 16

Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive samples in rows, evenly spaced.

    Attributes:
        time [s], z, qd, qdd: the motion; filtered if there is a filter.
        tau: drive torques, not filtered by the low-pass; no columns if none are recorded.
    """

    time: Float[np.ndarray, " samples"]
    z: Float[np.ndarray, "samples dof"]
    qd: Float[np.ndarray, "samples dof"]
    qdd: Float[np.ndarray, "samples dof"]
    tau: Float[np.ndarray, "samples torques"]

    def part(self, which: slice) -> "Samples":
        """Some of them."""
        return Samples(*(x[which] for x in (self.time, self.z, self.qd, self.qdd, self.tau)))


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a recording, ready to use.

    Attributes:
        start: number of samples of the recording's other windows before it.
        own: its samples, with torques as recorded; those of all windows are the recording.
        wide: the same and half a filter more at either end: where to evaluate what is to be
            filtered. Torques there have passed the first stage of the filter.
        low_pass: the filter, if there is one.
    """

    start: int
    own: Samples
    wide: Samples
    low_pass: LowPass | None

    def smoothed(
        self, x: Float[np.ndarray, "channels wide"], thinned: int = 1
    ) -> Float[np.ndarray, "channels kept"]:
        """The low-pass over something computed from `wide`, at every `thinned`-th own sample."""
        if self.low_pass is None:
            return x[:, ::thinned]
        return apply(self.low_pass.smooth, x, thinned)

    def filtered(self, x: Float[np.ndarray, "channels wide"]) -> Float[np.ndarray, "channels kept"]:
        """The same, thinned to the rate that the cut-off allows."""
        return self.smoothed(x, self.decimation)

    def trimmed(self, x: Float[np.ndarray, "wide ..."]) -> Float[np.ndarray, "own ..."]:
        """Something computed from `wide`, unfiltered, at the own samples."""
        half = self.low_pass.half if self.low_pass else 0
        return x[half : len(x) - half]

    @property
    def decimation(self) -> int:
        """Every how many own samples `filtered` keeps, beginning with the first."""
        return self.low_pass.decimation if self.low_pass else 1


def cut(
    rows: Iterable[Rows], columns: Columns, kinematics: Kinematics, low_pass: LowPass | None
) -> Iterator["Uncut"]:
    """The samples of one segment as blocks from which windows can be made apart from each other."""
    if low_pass is None:
        size, overlap = WINDOW, 0
    else:
        overlap = 2 * (low_pass.margin + low_pass.half)
        size = -(-max(WINDOW, overlap) // low_pass.decimation) * low_pass.decimation
        if low_pass.stride > 1:
            rows = _led(rows, len(columns.torque), low_pass)
    for k, block in enumerate(recut(rows, size, overlap)):
        yield Uncut(k * size, block, columns, kinematics, low_pass)


@dataclass(frozen=True, eq=False)
class Uncut:
    """Rows of one window: columns as in `Columns.all`, then torques as recorded if they differ."""

    start: int
    rows: Rows
    columns: Columns
    kinematics: Kinematics
    low_pass: LowPass | None

    def window(self) -> Window:
        """Their motion, differentiated where it is not recorded.

        Velocities and accelerations that are not recorded come from differentiating the highest
        derivative that is, through the filter. Without a filter both must be recorded.
        """
        c = self.columns
        counts = [len(part) for part in (c.position, c.velocity, c.acceleration, c.torque)]
        q, qd, qdd, tau, recorded = np.split(self.rows[:, 1:], np.cumsum(counts), axis=1)
        if self.low_pass is None:
            samples = self._samples(self.rows[:, 0], q, qd, qdd, tau)
            return Window(self.start, samples, samples, None)
        margin, half = self.low_pass.margin, self.low_pass.half
        inside = slice(margin, len(self.rows) - margin)
        motion = _motion(self.low_pass, q, qd, qdd)
        wide = self._samples(self.rows[inside, 0], *motion, tau[inside])
        own = wide.part(slice(half, len(wide.time) - half))
        if recorded.size:
            as_recorded = recorded[margin + half : len(self.rows) - margin - half]
            own = Samples(own.time, own.z, own.qd, own.qdd, as_recorded)
        return Window(self.start, own, wide, self.low_pass)

    def _samples(
        self, time: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, tau: np.ndarray
    ) -> Samples:
        z, _ = self.kinematics.forward_unchecked(q)
        return Samples(time, z, qd, qdd, tau)


def _motion(
    low_pass: LowPass, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered q, q̇ and q̈ in rows, from those that are recorded; the others have no columns."""
    longer = low_pass.margin - low_pass.half
    orders = np.stack([np.pad(low_pass.smooth, longer), low_pass.first, low_pass.second])

    def derivatives(x: np.ndarray, count: int) -> list[np.ndarray]:
        return [values.T for values in convolve(orders[:count], x.T)]

    if qd.size:
        ((smooth,), rates) = derivatives(q, 1), derivatives(qd, 1 if qdd.size else 2)
    else:
        smooth, *rates = derivatives(q, 2 if qdd.size else 3)
    acceleration = derivatives(qdd, 1)[0] if qdd.size else rates[1]
    return smooth, rates[0], acceleration


def _led(rows: Iterable[Rows], torques: int, low_pass: LowPass) -> Iterator[Rows]:
    """The first stage of a filter: every `stride`-th row behind `lead`, and torques as recorded."""
    lead, stride = low_pass.lead, low_pass.stride
    half = len(lead) // 2

    def led(block: Rows) -> Rows:
        at = block[half : len(block) - half : stride]
        smooth = apply(lead, block[:, 1:].T, stride).T
        return np.hstack([at[:, :1], smooth, at[:, block.shape[1] - torques :]])

    size = -(-_LEAD_ROWS // stride) * stride
    return ordered(led, recut(rows, size, len(lead) - 1))
