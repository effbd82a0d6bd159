"""Corrects delays of torques and sensors against the motion.

A torque recorded δ_i late is read δ_i later. In samples,

    δ_i · rate = k_i + f + r_i,

with whole samples k_i, a fraction f that drives have in common, |f| ≤ ½, and the remainder r_i of
each drive. The common fraction shifts the motion instead, to the instant t − f / rate: positions
and sensors are smooth and can be interpolated, while a torque jumps where a joint reverses, and
interpolation spreads the jump over neighbouring samples. So if all drives have the same lag,
torques stay as recorded. Only torques of drives whose lag differs by a fraction of a sample,
r_i ≠ 0, are interpolated.

A torque that is y behind a filter 1/(1 + T s) was y + T ẏ ahead of it, with the slope of the
interpolating polynomial. If torques and positions have different clocks, the lag δ + ρ (t − t_0)
grows with time, and all torques are interpolated.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.recording.columns import Columns, Rows
from deltaid.recording.table import padded, recut
from deltaid.recording.time.signals import weights_at
from deltaid.recording.units import SIDE
from deltaid.recording.windows import WINDOW

# Samples on either side that interpolate a torque, and a torque with its slope; a motion takes
# `SIDE`.
TORQUE_SIDE, _SLOPE_SIDE = 2, 3
# Fraction of a sample that counts as zero: it changes a torque by this share of its step.
_NONE = np.sqrt(np.finfo(float).eps)


@dataclass(frozen=True)
class LagGrowth:
    """Growth of lags with time, by ρ (t − t_0).

    Attributes:
        rate: ρ, the share by which the clock of torques is slow; negative if it is fast.
        about: t_0 [s].
        reach: largest |t − t_0| [s].
    """

    rate: float
    about: float
    reach: float


@dataclass(frozen=True)
class Shift:
    """Delays, filters and clock errors in samples.

    Attributes:
        common: f, by which the motion is read earlier, in samples.
        whole: k of each drive.
        rest: r of each drive.
        constants: T of each drive's filter, in samples; 0 for none.
        growth: growth of all lags; None for none.
        grown: bound of |ρ (t − t_0)|, in samples.
    """

    common: float
    whole: tuple[int, ...]
    rest: tuple[float, ...]
    constants: tuple[float, ...]
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
        """Shift that corrects delays with as few interpolated torques as possible.

        The common fraction is that of most drives; 0 if lags grow.

        Args:
            delay: lag of each drive's torque [s]; empty for none.
            rate: sampling rate [Hz].
            constants: time constants of filters [s]; empty for none.
            growth: growth of all lags; None for none.
        """
        late = delay if len(delay) else np.zeros(len(constants))
        samples = np.asarray(late, dtype=float) * rate
        parts = samples - np.round(samples)
        apart = samples[:, None] - samples[None, :]
        equal = np.abs(apart - np.round(apart)) < _NONE
        common = float(parts[np.argmax(equal.sum(axis=1))]) if parts.size and not growth else 0.0
        whole = np.round(samples - common)
        rest = samples - common - whole
        rest[np.abs(rest) < _NONE] = 0.0
        filters = tuple((np.asarray(constants or (0.0,) * len(late)) * rate).tolist())
        grown = int(np.ceil(abs(growth.rate) * growth.reach * rate)) + 1 if growth else 0
        places = tuple(whole.astype(int).tolist())
        return cls(common, places, tuple(rest.tolist()), filters, growth, grown)

    @property
    def smear(self) -> tuple[int, ...]:
        """Samples to either side over which each drive's torque is interpolated."""
        return tuple(
            _SLOPE_SIDE if T else TORQUE_SIDE if rest or self.growth else 0
            for rest, T in zip(self.rest, self.constants, strict=True)
        )

    @property
    def reach(self) -> tuple[int, int]:
        """Rows before and after a row that are needed to correct it."""
        first, last = min(self.whole, default=0), max(self.whole, default=0)
        around = max(self.smear, default=0) + self.grown
        moved = SIDE if self.common else 0
        return max(moved, around - first, 0), max(moved, around + last, 0)

    def rows(self, wide: Rows, motion: int, rate: float, sensors: slice = slice(0, 0)) -> Rows:
        """Corrected rows of `wide`, without `reach` at either end.

        Args:
            wide: time, columns of motion, one torque per drive; at the end one weight per drive.
            motion: number of columns.
            rate: rows per second.
            sensors: columns of sensors, which are shifted with the motion.
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
        if self.growth is not None:  # additional lag at these times, in samples
            time = np.nan_to_num(wide[before : before + count, 0])
            grown = self.growth.rate * (time - self.growth.about) * rate
            grown = np.clip(grown, 1 - self.grown, self.grown - 1)
        drive_shifts = zip(self.whole, self.rest, self.constants, strict=True)
        for i, (whole, rest, T) in enumerate(drive_shifts):
            tau, weight = 1 + motion + i, wide.shape[1] - drives + i
            if grown is None:
                unshifted = around(rest, _SLOPE_SIDE if T else TORQUE_SIDE, T)
                taps = [(whole + by, share) for by, share in unshifted]
                out[:, tau] = sum(share * later(tau, by) for by, share in taps)
                least = np.min([later(weight, by) for by, _ in taps], axis=0)
            else:
                place = before + np.arange(count) + whole + rest + grown
                out[:, tau], least = _interpolated(wide[:, tau], wide[:, weight], place, T)
            out[:, weight] = np.minimum(out[:, weight], least)
        return out


def delayed(segment: Iterable[Rows], columns: Columns, shift: Shift, rate: float) -> Iterator[Rows]:
    """Rows of a segment with τ(t + δ) at the time t of the motion, in constant memory.

    The weight of a torque becomes the least of its row and of the rows that interpolate it; torques
    from beyond the ends have weight 0. The result does not depend on the blocks.

    Args:
        segment: evenly spaced rows in blocks: `columns`, then one weight per drive.
        columns: columns of the rows.
        shift: shift by δ of each drive, which is negative if torques are early.
        rate: samples per second.
    """
    before, after = shift.reach
    motion = columns.motion_places.stop - 1
    for wide in recut(padded(segment, before, after, columns), WINDOW, before + after):
        yield shift.rows(wide, motion, rate, columns.sensor_places)


def in_time(segment: Iterable[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
    """Rows of a segment with y(t + δ) of each sensor at the time t of the motion, in constant
    memory.

    Sensors are interpolated like the motion; they are NaN beyond the ends of a segment.

    Args:
        segment: evenly spaced rows in blocks.
        columns: columns of the rows, with the delay of each sensor.
        rate: rows per second.
    """
    # Columns of each delayed sensor, and weights of the samples that interpolate it.
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
            moved = columns.sensor_places.start + channels
            out[:, moved] = sum(share * wide[before + by :][:count, moved] for by, share in taps)
        yield out


def around(place: float, half: int, constant: float = 0.0) -> list[tuple[int, float]]:
    """Samples around a place, and their weights in y + T ẏ there by Lagrange's polynomial.

    Args:
        place: place in samples.
        half: number of samples on either side.
        constant: T in samples.
    """
    whole = int(np.floor(place))
    s = place - whole
    if s == 0.0 and not constant:
        return [(whole, 1.0)]
    points = np.arange((s > 0.0) - half, half + 1)
    shares = _weights(np.array([s]), points, constant)[0]
    return list(zip((whole + points).tolist(), shares.tolist(), strict=True))


def _interpolated(
    tau: np.ndarray, weight: np.ndarray, place: np.ndarray, constant: float
) -> tuple[np.ndarray, np.ndarray]:
    half = _SLOPE_SIDE if constant else TORQUE_SIDE
    whole, points = np.floor(place).astype(int), np.arange(1 - half, half + 1)
    rows = whole[:, None] + points
    shares = _weights(place - whole, points, constant)
    return np.sum(shares * tau[rows], axis=1), np.min(weight[rows], axis=1)


def _weights(s: np.ndarray, points: np.ndarray, constant: float) -> np.ndarray:
    """Weights of samples at `points` in y + T ẏ at s, by the polynomial through them."""
    shares = weights_at(np.tile(points.astype(float), (len(s), 1)), s)
    for k, point in enumerate(points if constant else ()):
        others = np.delete(points, k)
        slope = np.polyder(np.poly(others) / np.prod(point - others))
        shares[:, k] += constant * np.polyval(slope, s)
    return shares
