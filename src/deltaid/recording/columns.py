"""Columns of a log by quantity, and corrections of recorded positions q_m and torques τ_m,

    q = (1 + r) q_m + q_0,    τ = τ_m (1 − β_2 u² − β_4 u⁴),   u = τ_m / τ_max,

with the error r of the gear ratio, the error q_0 of the zero, and a torque constant that falls with
current, by the share β_2 + β_4 at τ_max.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.recording.carried import Load
from deltaid.robot.part import Part

# Rows of a log in SI units, columns as in `Columns.all`, then those that a pass appends.
Rows = Float[np.ndarray, "_ _"]
Torque = Float[np.ndarray, "samples dof"]
# Least slope of a motor's torque over its current, as a share of that at low current.
LEAST_SLOPE = 0.1


@dataclass(frozen=True)
class Channel:
    """One column with its affine map to SI: value = scale · (number − zero).

    Attributes:
        turn: change of the column in one turn; 0 if it does not count turns.
    """

    column: str
    scale: float
    zero: float
    turn: float = 0.0


@dataclass(frozen=True)
class TimeChannel(Channel):
    """Channel of the time.

    Attributes:
        is_absent: whether the log has no time; row numbers from 0 then replace it.
        counts: whether the column counts cycles.
    """

    is_absent: bool = False
    counts: bool = False


@dataclass(frozen=True)
class SensorChannels:
    """Columns of a sensor in a log.

    Attributes:
        name: name of the sensor in the description.
        channels: columns with their maps to N or N m, in the order of the sensor's channels.
        delay: time by which the sensor lags the motion [s].
    """

    name: str
    channels: tuple[Channel, ...]
    delay: float = 0.0


@dataclass(frozen=True)
class Columns:
    """Channels of a log; a quantity that the log does not have is empty.

    Attributes:
        extra: additional columns in their own units, each once: first those of sensors, NaN where
            they do not count, then states.
        loads: loads that the robot carries, and when.
        temperature: one of `extra`, with its map to degrees Celsius; None without temperatures.
        sensors: sensors of the log; their channels are the first of `extra`.
        drives: channels of the drives.
        all: all channels: time, drives, extra columns.
        recorded: channels that are in the log: all, or all but the time.
        motion_places: indices in `all` of positions, velocities and accelerations.
        torque_places, extra_places, sensor_places: indices in `all` of torques, of extra columns,
            and of sensors' channels.
    """

    time: TimeChannel
    position: tuple[Channel, ...]
    velocity: tuple[Channel, ...]
    acceleration: tuple[Channel, ...]
    torque: tuple[Channel, ...]
    extra: tuple[Channel, ...] = ()
    loads: tuple[Load, ...] = ()
    temperature: Channel | None = None
    sensors: tuple[SensorChannels, ...] = ()

    @property
    def drives(self) -> tuple[Channel, ...]:
        return self.position + self.velocity + self.acceleration + self.torque

    @property
    def without_rates(self) -> "Columns":
        """Columns whose positions are differentiated, whatever rates the log has."""
        return replace(self, velocity=(), acceleration=())

    def exclusion(self, channel: Channel) -> str:
        """Fix that excludes the rates of a channel, which follow from positions; else empty."""
        names = (n for n in ("velocity", "acceleration") if channel in getattr(self, n))
        return "".join(f"; or exclude it by `{name}: []` in a mapping" for name in names)

    @property
    def all(self) -> tuple[Channel, ...]:
        return (self.time, *self.drives, *self.extra)

    @property
    def motion_places(self) -> slice:
        return slice(1, 1 + len(self.drives) - len(self.torque))

    @property
    def torque_places(self) -> slice:
        return slice(self.motion_places.stop, 1 + len(self.drives))

    @property
    def extra_places(self) -> slice:
        return slice(1 + len(self.drives), 1 + len(self.drives) + len(self.extra))

    @property
    def sensor_places(self) -> slice:
        start = self.extra_places.start
        return slice(start, start + sum(len(sensor.channels) for sensor in self.sensors))

    @property
    def states(self) -> int:
        """Number of extra columns that are states: they hold a value until the next one."""
        return self.extra_places.stop - self.sensor_places.stop

    def shown(
        self, extra: Float[np.ndarray, "samples extra"]
    ) -> dict[str, Float[np.ndarray, "_ samples"]]:
        """Values of each sensor of the log by its name: (channels, samples) [N, N m].

        All channels of a sensor are NaN in samples that do not count for it: those without a
        number, in holes and stale rows, and in stretches that are excluded for all drives.

        Args:
            extra: numbers of the extra columns.
        """
        by_sensor: dict[str, np.ndarray] = {}
        for sensor, places in self.places_of_sensors():
            zeros = [channel.zero for channel in sensor.channels]
            values = (extra[:, places] - zeros) * [channel.scale for channel in sensor.channels]
            values[~np.isfinite(values).all(axis=1)] = np.nan
            by_sensor[sensor.name] = np.ascontiguousarray(values.T)
        return by_sensor

    def places_of_sensors(self) -> Iterator[tuple[SensorChannels, slice]]:
        """Sensors, and the indices of their channels in `extra`."""
        start = 0
        for sensor in self.sensors:
            yield sensor, slice(start, start + len(sensor.channels))
            start += len(sensor.channels)

    def extra_index(self, column: str) -> int:
        return [channel.column for channel in self.extra].index(column)

    def held(
        self, time: Float[np.ndarray, " samples"], extra: Float[np.ndarray, "samples extra"]
    ) -> Float[np.ndarray, "loads samples"]:
        """The share of each load that the robot holds at each sample.

        Args:
            time: times of the samples in the recording [s].
            extra: numbers of the extra columns.
        """
        shares = [
            load.held(
                time, None if load.column is None else extra[:, self.extra_index(load.column)]
            )
            for load in self.loads
        ]
        return np.array(shares).reshape(len(self.loads), len(time))

    @property
    def recorded(self) -> tuple[Channel, ...]:
        return self.all[1:] if self.time.is_absent else self.all


class Readings(Part):
    """Errors of all drives' readings; a tuple is empty if its numbers are right.

    Attributes:
        zero: q_0 [rad or m].
        ratio: r.
        falling: β_2 and β_4.
        largest: τ_max [N m or N].
    """

    zero: tuple[float, ...] = ()
    ratio: tuple[float, ...] = ()
    falling: tuple[tuple[float, float], ...] = ()
    largest: tuple[float, ...] = ()

    @property
    def are_right(self) -> bool:
        return not (self.zero or self.ratio or self.falling)

    def corrected(self, rows: Rows, columns: Columns) -> Rows:
        """Rows with corrected positions and torques."""
        rows = rows.copy()
        if self.ratio:
            motion = rows[:, columns.motion_places]
            motion *= np.tile(1.0 + np.array(self.ratio), motion.shape[1] // len(self.ratio))
        if self.zero:
            rows[:, 1 : 1 + len(self.zero)] += self.zero
        if self.falling:
            torque = rows[:, columns.torque_places]
            torque *= self._share(torque)[0]
        return rows

    def recorded(self, torque: Torque) -> Torque:
        """Recorded torques τ_m of torques τ, |τ_m| ≤ τ_max, by Newton's method."""
        if not self.falling:
            return torque
        out, highest, number = torque, np.array(self.largest), np.finfo(float)
        for _ in range(number.nmant):  # as many steps as bisection takes, at most
            share, slope = self._share(out)
            step = (out * share - torque) / np.maximum(slope, LEAST_SLOPE)
            before, out = out, np.clip(out - step, -highest, highest)
            # Steps converge quadratically, so the next one is lost in rounding.
            if np.all(np.abs(out - before) <= np.sqrt(number.eps) * highest):
                break
        return out

    def _share(self, torque: Torque) -> tuple[Torque, Torque]:
        """Ratio τ / τ_m and slope dτ / dτ_m."""
        squared = (torque / np.array(self.largest)) ** 2
        second, fourth = np.array(self.falling).T
        share = 1.0 - second * squared - fourth * squared**2
        return share, share - 2.0 * second * squared - 4.0 * fourth * squared**2
