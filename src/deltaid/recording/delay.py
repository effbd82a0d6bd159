"""Torques that are recorded late put beside the motion that they belong to, and late sensors.

A torque recorded δ_i late is read δ_i further on. What this is in samples,

    δ_i · rate = k_i + f + r_i,

is whole samples k_i, a part f of a sample that drives have in common, |f| ≤ ½, and what is left
of each, r_i. The common part moves the motion instead, to the instant t − f / rate: positions are
smooth and can be interpolated, as can what sensors show, while a torque jumps where a joint turns
round, and interpolating spreads the jump over neighbouring samples. So where all drives have the
same lag, every torque stays as it was recorded. Only of drives that differ, by no whole number of
samples, torques are interpolated, r_i ≠ 0.

Two more things go with a delay. A torque y that passed a filter 1/(1 + T s) was y + T ẏ, whose
slope comes from the polynomial that interpolates. Where the clock of torques is another one than
that of positions, δ grows with time, δ + ρ (t − t_0), and every torque is interpolated.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.recording.columns import Columns, Rows
from deltaid.recording.table import padded, recut
from deltaid.recording.time.signals import SIDE, weights_at
from deltaid.recording.windows import WINDOW

# Samples on either side from which a torque, and one with its slope, are interpolated; of a motion
# there are `SIDE`.
TORQUE_SIDE, _SLOPE_SIDE = 2, 3
# Parts of a sample that count as none: a torque is off by as small a share of its change.
_NONE = np.sqrt(np.finfo(float).eps)


@dataclass(frozen=True)
class LagGrowth:
    """How lags grow with time, by ρ (t − t_0).

    Attributes:
        rate: ρ, the share by which the clock of torques runs slow; negative where it runs fast.
        about: t_0 [s].
        reach: largest |t − t_0| [s].
    """

    rate: float
    about: float
    reach: float


@dataclass(frozen=True)
class Shift:
    """Delays in samples, and what goes with them.

    Attributes:
        common: f, by which the motion is taken earlier, in samples.
        whole: k of each drive.
        rest: r of each drive, between -½ and ½.
        constants: T of each drive's filter, in samples; empty for none.
        growth: of all lags; None for none.
        grown: by how much that changes them at most, in samples.
    """

    common: float
    whole: tuple[int, ...]
    rest: tuple[float, ...]
    constants: tuple[float, ...] = ()
    growth: LagGrowth | None = None
    grown: int = 0

    @classmethod
    def of_delays(
        cls,
        delay: Sequence[float],
        rate: float,
        constants: Sequence[float] = (),
        growth: LagGrowth | None = None,
    ) -> "Shift":
        """The shift of delays [s] at a sampling rate [Hz], with as few parts of samples as can be.

        The common part is that of most drives; none where lags grow.

        Args:
            constants: of filters [s]; empty for none.
        """
        count = max(len(delay), len(constants))
        samples = np.asarray(delay if len(delay) else np.zeros(count), dtype=float) * rate
        parts = samples - np.round(samples)
        apart = samples[:, None] - samples[None, :]
        alike = np.abs(apart - np.round(apart)) < _NONE
        common = float(parts[np.argmax(alike.sum(axis=1))]) if parts.size and not growth else 0.0
        whole = np.round(samples - common)
        rest = samples - common - whole
        rest[np.abs(rest) < _NONE] = 0.0
        filters = tuple((np.asarray(constants) * rate).tolist()) if any(constants) else ()
        # By how many samples growth changes a lag at most.
        grown = int(np.ceil(abs(growth.rate) * growth.reach * rate)) + 1 if growth else 0
        places = tuple(whole.astype(int).tolist())
        return cls(common, places, tuple(rest.tolist()), filters, growth, grown)

    @property
    def smear(self) -> tuple[int, ...]:
        """Over how many samples to either side each drive's torque is spread."""
        constants = self.constants or (0.0,) * len(self.rest)
        return tuple(
            _SLOPE_SIDE if T else TORQUE_SIDE if rest or self.growth else 0
            for rest, T in zip(self.rest, constants, strict=True)
        )

    @property
    def reach(self) -> tuple[int, int]:
        """How many rows before and after one are needed to put it right."""
        first, last = min(self.whole, default=0), max(self.whole, default=0)
        around = max(self.smear, default=0) + self.grown
        moved = SIDE if self.common else 0
        return max(moved, around - first, 0), max(moved, around + last, 0)

    def rows(self, wide: Rows, motion: int, rate: float, sensors: slice = slice(0, 0)) -> Rows:
        """Rows put right, all but the first and last of `wide`, as `reach` says.

        Args:
            wide: time, so many columns of motion, a torque a drive; at the end a weight a drive.
            motion: number of columns.
            rate: rows per second.
            sensors: columns of what sensors show, which go with the motion.
        """
        before, after = self.reach
        count, drives = len(wide) - before - after, len(self.whole)
        out = wide[before : before + count].copy()

        def later(channels: slice | int, by: int) -> np.ndarray:
            return wide[before + by : before + by + count, channels]

        if self.common:
            taps = around(-self.common, SIDE)
            for moved in (slice(1, 1 + motion), sensors):
                out[:, moved] = sum(share * later(moved, by) for by, share in taps)
            out[:, 0] -= self.common / rate
            beyond = np.any([np.isnan(later(0, by)) for by, _ in taps], axis=0)
            out[beyond, wide.shape[1] - drives :] = 0.0
        grown = None
        if self.growth is not None:  # by how many samples lags are longer at these times
            time = np.nan_to_num(wide[before : before + count, 0])
            grown = self.growth.rate * (time - self.growth.about) * rate
            grown = np.clip(grown, 1 - self.grown, self.grown - 1)
        constants = self.constants or (0.0,) * drives
        for i, (whole, rest, T) in enumerate(zip(self.whole, self.rest, constants, strict=True)):
            tau, weight = 1 + motion + i, wide.shape[1] - drives + i
            if grown is None:
                unshifted = around(rest, _SLOPE_SIDE if T else TORQUE_SIDE, T)
                taps = [(whole + by, share) for by, share in unshifted]
                out[:, tau] = sum(share * later(tau, by) for by, share in taps)
                least = np.min([later(weight, by) for by, _ in taps], axis=0)
            else:
                place = before + np.arange(count) + whole + rest + grown
                out[:, tau], least = _read(wide[:, tau], wide[:, weight], place, T)
            out[:, weight] = np.minimum(out[:, weight], least)
        return out


def delayed(segment: Iterable[Rows], columns: Columns, shift: Shift, rate: float) -> Iterator[Rows]:
    """Rows of a segment with τ(t + δ) beside the motion at t, in constant memory.

    A torque's weight becomes the least of its row and of those that it is made of; what would come
    from beyond the ends has none. Nothing depends on how the rows are cut into blocks.

    Args:
        segment: evenly spaced rows in blocks: `columns`, then a weight a drive.
        columns: what stands where.
        shift: δ of each drive; negative where torques come early.
        rate: samples per second.
    """
    before, after = shift.reach
    motion = columns.motion_places.stop - 1
    for wide in recut(padded(segment, before, after, columns), WINDOW, before + after):
        yield shift.rows(wide, motion, rate, columns.sensor_places)


def in_time(segment: Iterable[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
    """Rows of a segment with y(t + δ) of each sensor beside the motion at t, in constant memory.

    What a sensor shows is smooth, as the motion is, so it is interpolated between samples. Beyond
    the ends of a segment it says nothing.

    Args:
        segment: evenly spaced rows in blocks.
        columns: what stands where, and how late each sensor is.
        rate: rows per second.
    """
    # Columns of one sensor, and shares of the samples so many later.
    shifts = [
        (np.arange(places.start, places.stop), around(sensor.delay * rate, SIDE))
        for sensor, places in columns.places_of_sensors()
        if sensor.delay
    ]
    if not shifts:
        yield from segment
        return
    places = [by for _, taps in shifts for by, _ in taps]
    before, after = max(0, -min(places)), max(0, *places)
    for wide in recut(padded(segment, before, after, columns), WINDOW, before + after):
        count = len(wide) - before - after
        out = wide[before : before + count].copy()
        for channels, taps in shifts:
            own = columns.sensor_places.start + channels
            out[:, own] = sum(share * wide[before + by :][:count, own] for by, share in taps)
        yield out


def around(place: float, half: int, constant: float = 0.0) -> list[tuple[int, float]]:
    """Samples about a place and their shares of y + T ẏ there, by Lagrange's polynomial.

    Args:
        place: in samples.
        half: how many on either side.
        constant: T, in samples.
    """
    whole = int(np.floor(place))
    s = place - whole
    if s == 0.0 and not constant:
        return [(whole, 1.0)]
    points = np.arange((s > 0.0) - half, half + 1)
    shares = _shares(np.array([s]), points, constant)[0]
    return list(zip((whole + points).tolist(), shares.tolist(), strict=True))


def _read(
    tau: np.ndarray, weight: np.ndarray, place: np.ndarray, constant: float
) -> tuple[np.ndarray, np.ndarray]:
    half = _SLOPE_SIDE if constant else TORQUE_SIDE
    whole, points = np.floor(place).astype(int), np.arange(1 - half, half + 1)
    rows = whole[:, None] + points
    shares = _shares(place - whole, points, constant)
    return np.sum(shares * tau[rows], axis=1), np.min(weight[rows], axis=1)


def _shares(s: np.ndarray, points: np.ndarray, constant: float) -> np.ndarray:
    """Shares of y + T ẏ at s of samples at some points, by the polynomial through them."""
    shares = weights_at(np.tile(points.astype(float), (len(s), 1)), s)
    for k, point in enumerate(points if constant else ()):
        others = np.delete(points, k)
        slope = np.polyder(np.poly(others) / np.prod(point - others))
        shares[:, k] += constant * np.polyval(slope, s)
    return shares
