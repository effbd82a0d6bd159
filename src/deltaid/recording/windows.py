"""Turns rows of a segment into windows of samples (z, q̇, q̈, τ), filtered where needed.

A segment is a run of rows without a gap. No filter reaches beyond its ends.

Friction changes its sign with the speed ϑ̇. With noise on positions, and channels that are read at
slightly different instants, the time of a reversal is known to about a sample; torque and model of
the rows about it may differ by the whole friction. A row is excluded where

    |ϑ̇| ≤ δ |ϑ̈| + 3 σ,

with the time δ between torques and positions, at most a millisecond and at most a sample, and the
standard deviation σ of ϑ̇ from noise of positions after the filter: for a drive in its own row, for
a passive joint in the rows of all drives that move it. If a drive's torque is interpolated, δ is
longer by the samples under it.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from deltaid.levels import SURE
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.columns import Columns, Rows
from deltaid.recording.filter import LowPass
from deltaid.recording.spectrum import apply, convolve
from deltaid.recording.table import recut

# Largest time between torques and positions of a row [s].
_SAME = 1e-3
# Samples of a window: many against the filter's length, few against memory, and no power of two,
# because rows of an array a power of two apart share lines of the cache.
WINDOW = 8000
Values = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Directions:
    """Which directions of motion are certain near reversals.

    Attributes:
        period: time between two samples [s].
        noise: σ of each drive's speed [rad/s or m/s].
        smear: samples to either side over which torques are interpolated; empty for none.
    """

    period: float
    noise: Float[np.ndarray, " dof"]
    smear: tuple[int, ...] = ()

    def known(
        self,
        kinematics: Kinematics,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
        within: float = _SAME,
    ) -> Bool[np.ndarray, "samples dof"]:
        """Whether a drive's row has certain directions of all its joints with friction.

        Args:
            within: longest δ [s].
        """
        robot, apart = kinematics.robot, np.full(qd.shape[1], min(self.period, within))
        if self.smear:
            apart += self.period * np.array(self.smear)
        known = np.abs(qd) > apart * np.abs(qdd) + SURE * self.noise
        known |= np.array([drive not in robot.friction for drive in robot.drives])
        passive = kinematics.passive_friction
        if passive.names:
            joints = passive.rates(z, qd, qdd)
            noise = np.linalg.norm(joints.slope * self.noise, axis=2)
            for k, moved_by in enumerate(passive.moved_by):
                speed, rise = np.abs(joints.speed[:, k, None]), np.abs(joints.acceleration[:, k])
                sure = speed > apart * rise[:, None] + SURE * noise[:, k, None]
                known &= sure | ~moved_by
        return known


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """Consecutive samples in rows, evenly spaced.

    Attributes:
        time [s], z, qd, qdd: the motion; filtered if there is a filter.
        tau: drive torques as recorded, unfiltered, without those of held loads; no columns if the
            log has none.
        weights: of each drive's torque, between 0 and 1; no columns without torques.
        extra: extra columns as in `Columns.extra`, unfiltered.
        carried: torques of held loads.
    """

    time: Float[np.ndarray, " samples"]
    z: Float[np.ndarray, "samples dof"]
    qd: Float[np.ndarray, "samples dof"]
    qdd: Float[np.ndarray, "samples dof"]
    tau: Float[np.ndarray, "samples torques"]
    weights: Float[np.ndarray, "samples torques"]
    extra: Float[np.ndarray, "samples extra"]
    carried: Float[np.ndarray, "samples dof"]

    def part(self, which: slice) -> "SampleBlock":
        return SampleBlock(*(getattr(self, field.name)[which] for field in fields(self)))

    def weighted(self, values: Values, drives: Int[np.ndarray, " channels"]) -> Values:
        """Channels (channels, samples) times the weights of the drives that they belong to.

        m τ = m Y p holds sample by sample, so samples are excluded here, at the full rate, before a
        filter spreads them.
        """
        return self.weigh(values.copy(), drives)

    def weigh(self, values: Values, drives: Int[np.ndarray, " channels"]) -> Values:
        """The same in place."""
        part = np.flatnonzero((self.weights != 1.0).any(axis=1))
        values[:, part] *= self.weights[part].T[drives]
        return values


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a recording, ready for computations.

    Attributes:
        start: number of samples in earlier windows.
        own: its samples; those of all windows make up the recording.
        wide: its samples and more at either end, for values that are filtered.
        low_pass: the filter; `no_filter` if velocities and accelerations are recorded.
        off: recorded minus filtered positions, at the wide samples.
        turning: own samples of each drive that are excluded only because a joint reverses.
    """

    start: int
    own: SampleBlock
    wide: SampleBlock
    low_pass: LowPass
    off: Float[np.ndarray, "wide dof"]
    turning: Int[np.ndarray, " torques"]

    def filtered(self, of: Callable[[SampleBlock], Values]) -> Values:
        """The low-pass over a function of samples, thinned as the cut-off allows.

        Args:
            of: returns (channels, samples). With two stages of the filter it is evaluated part by
                part, of which few samples remain.
        """
        parts = [self.low_pass.leading(of(part)) for part in self._parts()]
        values = parts[0] if len(parts) == 1 else np.hstack(parts)  # no copy of a whole window
        return apply(self.low_pass.smooth, values, self.low_pass.decimation)

    def smoothed(self, x: Float[np.ndarray, "channels wide"], *, thinned: bool = False) -> Values:
        """The low-pass over values at the `wide` samples.

        Args:
            thinned: whether it is thinned as by `filtered`, else to every `stride`-th own sample.
        """
        every = self.low_pass.decimation if thinned else 1
        return apply(self.low_pass.smooth, self.low_pass.leading(x), every)

    def counted(
        self, every: int, weights: Float[np.ndarray, "channels wide"] | None = None
    ) -> Float[np.ndarray, "channels kept"]:
        """Share of the noise's power that weights m keep: Σ (h m)² / Σ h², h the low-pass.

        It is the weight of each filtered sample, for every channel.

        Args:
            every: decimation of own samples: the filter's `stride` or `thinned`.
            weights: of channels at the wide samples; those of the drives' torques by default.
        """
        weights = self.wide.weights.T if weights is None else weights
        if np.all(weights == 1.0):
            return self.trimmed(weights.T)[::every].T ** 2
        return apply(self.low_pass.power, weights**2, every)[:, : -(-len(self.own.time) // every)]

    def trimmed(self, x: Shaped[np.ndarray, "wide ..."]) -> Shaped[np.ndarray, "own ..."]:
        """Values at the `wide` samples, unfiltered, at the own samples."""
        lost = self.low_pass.lead_half + self.low_pass.stride * self.low_pass.half
        return x[lost : lost + len(self.own.time)]

    def _parts(self) -> Iterator[SampleBlock]:
        """`wide` in parts from which the first stage makes consecutive samples."""
        lead, stride = len(self.low_pass.lead), self.low_pass.stride
        size = len(self.wide.time) if stride == 1 else -(-WINDOW // stride) * stride
        for start in range(0, len(self.wide.time) - lead + 1, size):
            yield self.wide.part(slice(start, start + size + lead - stride))


def blocks(rows: Iterable[Rows], low_pass: LowPass) -> Iterator[Rows]:
    """Rows of a segment as blocks, from which windows are made independently."""
    overlap = low_pass.reach
    size = -(-rows_at_once(overlap) // low_pass.thinned) * low_pass.thinned
    return recut(rows, size, overlap)


def rows_at_once(overlap: int) -> int:
    """Rows by which blocks that share `overlap` rows advance: of a window, or twice the overlap."""
    return max(WINDOW, 2 * overlap)


def window_of(
    rows: Rows,
    start: int,
    columns: Columns,
    kinematics: Kinematics,
    low_pass: LowPass,
    directions: Directions | None,
    burden: Callable[..., Values] | None,
) -> Window:
    """The window of some rows, columns as in `Columns.all`, then one weight a drive.

    Velocities and accelerations that are not recorded come from differentiating the highest
    derivative that is, through the filter; with `no_filter` both must be recorded.

    Args:
        start: number of samples in earlier windows.
        directions: which are certain; None if all rows count.
        burden: torques to subtract, as `burden_of` makes it.
    """
    c, first = columns, low_pass.first_row
    counts = [len(x) for x in (c.position, c.velocity, c.acceleration)]
    q, *rates = np.split(rows[:, c.motion_places], np.cumsum(counts)[:2], axis=1)
    smooth, qd, qdd = _motion(low_pass, q, *rates)
    z, _ = kinematics.forward_unchecked(smooth)
    samples, inner = low_pass.samples_of(len(rows)), slice(first, first + len(smooth))
    off, rows = q[inner] - smooth, rows[inner]
    time, tau, extra = rows[:, 0], rows[:, c.torque_places], rows[:, c.extra_places]
    recorded = weights = rows[:, c.extra_places.stop :]
    if directions is not None and weights.size:
        weights = weights * directions.known(kinematics, z, qd, qdd)
    carried = burden(time, z, qd, qdd, extra) if burden else np.zeros_like(qd)
    if burden and tau.size:
        tau = tau - carried
    wide = SampleBlock(time, z, qd, qdd, tau, weights, extra, carried)
    lost = low_pass.lead_half + low_pass.stride * low_pass.half
    own = slice(lost, lost + samples)
    turning = np.count_nonzero((weights[own] == 0.0) & (recorded[own] > 0.0), axis=0)
    return Window(start, wide.part(own), wide, low_pass, off, turning)


def _motion(
    low_pass: LowPass, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered q, q̇ and q̈ in rows, from those that are recorded; the others have no columns."""
    orders = np.stack([low_pass.level, low_pass.first, low_pass.second])

    def derivatives(x: np.ndarray, count: int) -> list[np.ndarray]:
        smoothed = convolve(orders[:count], low_pass.leading(x.T))
        return [low_pass.spread(values).T for values in smoothed]

    if qd.size:
        (smooth,), rates = derivatives(q, 1), derivatives(qd, 1 if qdd.size else 2)
    else:
        smooth, *rates = derivatives(q, 2 if qdd.size else 3)
    return smooth, rates[0], derivatives(qdd, 1)[0] if qdd.size else rates[1]
