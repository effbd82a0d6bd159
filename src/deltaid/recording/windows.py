"""Converts rows of a segment to windows of samples (z, q̇, q̈, τ), filtered where needed.

A segment is a run of rows without a gap. No filter reaches beyond its ends.

Friction changes its sign with the speed ϑ̇. Positions have noise, and channels are read at slightly
different instants, so the time of a reversal is known to about one sample. Near it, torque and
model may differ by the whole friction. A row is excluded where

    |ϑ̇| ≤ δ |ϑ̈| + 3 σ,

with the time δ between torques and positions, at most one millisecond and one sample, and the
standard deviation σ of ϑ̇ due to noise of positions behind the filter. A drive excludes its own row,
a passive joint the rows of all drives that move it. If a drive's torque is interpolated, δ is
longer by the samples over which it is interpolated.
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
# Samples per window: many against the filter's length, few against memory, and not a power of two,
# because rows of an array a power of two apart compete for the same cache lines.
WINDOW = 8000
Values = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Directions:
    """Decides where the directions of motion are certain near reversals.

    Attributes:
        period: time between two samples [s].
        noise: σ of each drive's speed [rad/s or m/s].
        smear: samples to either side over which torques are interpolated; empty if none are.
        turns: speeds below which passive joints with friction may turn either way [rad/s or m/s];
            empty if their directions are certain.
        settling: least δ of passive joints [s]: behind compliant gears their friction is a step of
            the gears' torques, which the links' motion follows.
    """

    period: float
    noise: Float[np.ndarray, " dof"]
    smear: tuple[int, ...] = ()
    turns: tuple[float, ...] = ()
    settling: float = 0.0

    def known(
        self,
        kinematics: Kinematics,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
        within: float = _SAME,
    ) -> Bool[np.ndarray, "samples dof"]:
        """Whether all joints with friction in a drive's row have certain directions.

        Args:
            within: largest δ [s].
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
            turns = self.turns or (0.0,) * len(passive.names)
            apart = np.maximum(apart, self.settling)
            for k, moved_by in enumerate(passive.moved_by):
                speed, rise = np.abs(joints.speed[:, k, None]), np.abs(joints.acceleration[:, k])
                sure = speed > apart * rise[:, None] + SURE * noise[:, k, None] + turns[k]
                known &= sure | ~moved_by
        return known


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """Consecutive, evenly spaced samples in rows.

    Attributes:
        time [s], z, qd, qdd: the motion; filtered if there is a filter.
        tau: drive torques as recorded minus `carried`, unfiltered; no columns if the log has none.
        weights: weight of each drive's torque, between 0 and 1; no columns without torques.
        extra: extra columns as in `Columns.extra`, unfiltered.
        carried: drive torques of held loads and external causes.
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
        """Multiply channels (channels, samples) by the weights m of their drives.

        m τ = m Y p holds sample by sample, so samples are excluded at the full rate, before a
        filter spreads them.
        """
        values, part = values.copy(), np.flatnonzero((self.weights != 1.0).any(axis=1))
        values[:, part] *= self.weights[part].T[drives]
        return values


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a recording, ready for computations.

    Attributes:
        start: number of samples in earlier windows.
        inner: samples of this window; those of all windows make up the recording.
        wide: `inner` and further samples at either end, which the filter needs.
        low_pass: the filter; `no_filter` if velocities and accelerations are recorded.
        off: recorded minus filtered positions at the wide samples [rad or m].
        turning: for each drive, number of inner samples excluded only because a joint reverses.
    """

    start: int
    inner: SampleBlock
    wide: SampleBlock
    low_pass: LowPass
    off: Float[np.ndarray, "wide dof"]
    turning: Int[np.ndarray, " torques"]

    def filtered(self, of: Callable[[SampleBlock], Values]) -> Values:
        """Filter a function of the samples by the low-pass, thinned as the cut-off allows.

        Args:
            of: returns (channels, samples). With a filter of two stages it is evaluated part by
                part, because few samples of each part remain.
        """
        parts = [self.low_pass.leading(of(part)) for part in self._parts()]
        values = parts[0] if len(parts) == 1 else np.hstack(parts)  # no copy of a whole window
        return apply(self.low_pass.smooth, values, self.low_pass.decimation)

    def smoothed(self, x: Float[np.ndarray, "channels wide"], *, thinned: bool = False) -> Values:
        """Filter values at the `wide` samples by the low-pass.

        Args:
            thinned: whether to thin as `filtered` does, else to every `stride`-th inner sample.
        """
        every = self.low_pass.decimation if thinned else 1
        return apply(self.low_pass.smooth, self.low_pass.leading(x), every)

    def counted(
        self, every: int, weights: Float[np.ndarray, "channels wide"] | None = None
    ) -> Float[np.ndarray, "channels kept"]:
        """Weight of each filtered sample of every channel: the share of the noise's power that
        weights m keep, Σ (h m)² / Σ h², with the low-pass h.

        Args:
            every: decimation of inner samples, the filter's `stride` or `thinned`.
            weights: weights of channels at the wide samples; by default those of the torques.
        """
        weights = self.wide.weights.T if weights is None else weights
        if np.all(weights == 1.0):
            return self.trimmed(weights.T)[::every].T ** 2
        return apply(self.low_pass.power, weights**2, every)[:, : -(-len(self.inner.time) // every)]

    def trimmed(self, x: Shaped[np.ndarray, "wide ..."]) -> Shaped[np.ndarray, "inner ..."]:
        """Unfiltered values at the inner samples, from values at the `wide` samples."""
        lost = self.low_pass.lead_half + self.low_pass.stride * self.low_pass.half
        return x[lost : lost + len(self.inner.time)]

    def _parts(self) -> Iterator[SampleBlock]:
        """Cut `wide` into parts whose outputs of the first stage are consecutive."""
        lead, stride = len(self.low_pass.lead), self.low_pass.stride
        size = len(self.wide.time) if stride == 1 else -(-WINDOW // stride) * stride
        for start in range(0, len(self.wide.time) - lead + 1, size):
            yield self.wide.part(slice(start, start + size + lead - stride))


def blocks(rows: Iterable[Rows], low_pass: LowPass) -> Iterator[Rows]:
    """Rows of a segment in overlapping blocks, from each of which a window is made."""
    overlap = low_pass.reach
    size = -(-rows_at_once(overlap) // low_pass.thinned) * low_pass.thinned
    return recut(rows, size, overlap)


def rows_at_once(overlap: int) -> int:
    """Rows by which blocks that share `overlap` rows advance: a window, or twice the overlap."""
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
    """Window of consecutive rows.

    The filter differentiates the highest recorded derivative to those that are not recorded; with
    `no_filter` velocities and accelerations must be recorded.

    Args:
        rows: columns as in `Columns.all`, then one weight per drive.
        start: number of samples in earlier windows.
        directions: decides which directions are certain; None if all rows count.
        burden: torques to subtract, as `burden_of` returns them.
    """
    c, first = columns, low_pass.first_row
    counts = [len(x) for x in (c.position, c.velocity, c.acceleration)]
    q, *rates = np.split(rows[:, c.motion_places], np.cumsum(counts)[:2], axis=1)
    smooth, qd, qdd = _motion(low_pass, q, *rates)
    z, _ = kinematics.forward_unchecked(smooth)
    samples, with_motion = low_pass.samples_of(len(rows)), slice(first, first + len(smooth))
    off, rows = q[with_motion] - smooth, rows[with_motion]
    time, tau, extra = rows[:, 0], rows[:, c.torque_places], rows[:, c.extra_places]
    recorded = weights = rows[:, c.extra_places.stop :]
    if directions is not None and weights.size:
        weights = weights * directions.known(kinematics, z, qd, qdd)
    carried = burden(time, z, qd, qdd, extra) if burden else np.zeros_like(qd)
    if burden and tau.size:
        tau = tau - carried
    wide = SampleBlock(time, z, qd, qdd, tau, weights, extra, carried)
    lost = low_pass.lead_half + low_pass.stride * low_pass.half
    inner = slice(lost, lost + samples)
    turning = np.count_nonzero((weights[inner] == 0.0) & (recorded[inner] > 0.0), axis=0)
    return Window(start, wide.part(inner), wide, low_pass, off, turning)


def _motion(
    low_pass: LowPass, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered q, q̇ and q̈ in rows; quantities that are not recorded have no columns."""
    orders = np.stack([low_pass.level, low_pass.first, low_pass.second])

    def derivatives(x: np.ndarray, count: int) -> list[np.ndarray]:
        smoothed = convolve(orders[:count], low_pass.leading(x.T))
        return [low_pass.spread(values).T for values in smoothed]

    if qd.size:
        (smooth,), rates = derivatives(q, 1), derivatives(qd, 1 if qdd.size else 2)
    else:
        smooth, *rates = derivatives(q, 2 if qdd.size else 3)
    return smooth, rates[0], derivatives(qdd, 1)[0] if qdd.size else rates[1]
