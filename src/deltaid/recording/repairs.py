"""Corrections of the rows of a recording, which every pass over it applies.

Positions of motors on compliant gears are converted to those of the links. On a gear of compliance
s, the motor is ahead of its link by s τ_g, with the torque τ_g of the gear:

    q = q_motor − s τ_g,   τ_g = τ − viscous q̇ − coulomb sign(q̇) − rotor q̈.

τ_g is the low-passed *measured* torque less friction and rotor inertia of the motor. (With a
model's torque, which depends on q̈, the iteration diverges.) Friction and rotor inertia act with the
motor's motion, but a model of rigid gears has only the link's. So torques are converted to those of
a motor that moves as its link: terms at the motor's motion are subtracted, those at the link's
motion are added.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from deltaid.dynamics.dynamics import compiled
from deltaid.grouping import grouped
from deltaid.recording.carried import carrier
from deltaid.recording.columns import Columns, Readings, Rows
from deltaid.recording.delay import LagGrowth, Shift, delayed
from deltaid.recording.filter import LowPass, design_low_pass
from deltaid.recording.hold import Hold, filled
from deltaid.recording.masks.masks import joined_times, within
from deltaid.recording.table import recut
from deltaid.recording.windows import rows_at_once
from deltaid.robot.description import RobotDescription

Values = Float[np.ndarray, "samples drives"]
Samples = Float[np.ndarray, "samples dof"]
# Periods of the cut-off after which 3 % of the second derivative of a step remains.
_PERIODS = 2
# Reasons to exclude stretches, and their explanations.
CONTACT, SPIKE, STOP, JOLT = "contact", "torque spike", "stop", "jolt"
BACKLASH, CHANGE = "backlash", "change of sign"
WHY_REPAIRED = {
    CONTACT: "torques exceed what the motion requires, as if something pushed the robot",
    SPIKE: "one torque channel jumps for one to three samples",
    STOP: "the robot was stopped by more than its drives",
    CHANGE: "torques exceed what the motion requires where a joint reverses or the torque of a "
    "gear changes its sign",
    JOLT: "torque and motion change faster than the low-pass follows",
    BACKLASH: "play in a gear lets its motor go ahead where the torque changes its sign",
}


@dataclass(frozen=True)
class Gears:
    """Compliant gears of all drives.

    Attributes:
        compliance: s [rad/(N m) or m/N]; 0 for a stiff gear.
        viscous, coulomb, rotor: friction and inertia on the motor's side of the gears.
        cutoff: cut-off of the low-pass over the gears' torques [Hz].
    """

    compliance: tuple[float, ...]
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]
    rotor: tuple[float, ...]
    cutoff: float

    @property
    def settling(self) -> float:
        """Time after a step of their torques until the links' motion is known again [s]."""
        return _PERIODS / self.cutoff

    def low_pass(self, rate: float) -> LowPass:
        """Filter of the gears' torques, in one stage."""
        return design_low_pass(self.cutoff, rate, single=True)

    def of_motor(self, qd: Values, qdd: Values) -> Values:
        friction = np.array(self.viscous) * qd + np.array(self.coulomb) * np.sign(qd)
        return friction + np.array(self.rotor) * qdd

    def less(self, qd: Values, qdd: Values, ahead: Values, faster: Values) -> Values:
        """Friction and inertia torque of the motors minus that at the motion of their links.

        Args:
            qd, qdd: speed and acceleration of the motors.
            ahead, faster: speed and acceleration of the motors minus those of the links.
        """
        return self.of_motor(qd, qdd) - self.of_motor(qd - ahead, qdd - faster)

    def turned_back(self, segment: Iterable[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
        """Rows of a segment with the links' motion, in constant memory.

        Filters take some rows at both ends.

        Args:
            segment: evenly spaced rows in blocks: `columns`, then one weight per drive.
            columns: columns of the rows.
            rate: samples per second.
        """
        low_pass, dof = self.low_pass(rate), len(self.compliance)
        filters = (low_pass.level, low_pass.first, low_pass.second)
        recorded = (columns.position, columns.velocity, columns.acceleration)
        lost, reach = low_pass.margin, round(self.settling * rate)
        for wide in recut(segment, rows_at_once(4 * lost), 4 * lost):
            once, twice = (slice(lost * k, len(wide) - lost * k) for k in (1, 2))
            q = wide[:, 1 : 1 + dof]
            qd, qdd = convolved(low_pass.first, q), convolved(low_pass.second, q)
            tau = wide[once, columns.torque_places] - self.of_motor(qd, qdd)
            wound = [self.compliance * convolved(taps, tau) for taps in filters]
            out = wide[twice].copy()
            kept = [by for by, channels in zip(wound, recorded, strict=True) if channels]
            out[:, columns.motion_places] -= np.hstack(kept)
            motion = [x[lost : len(x) - lost] for x in (qd, qdd)]
            out[:, columns.torque_places] -= self.less(*motion, *wound[1:])
            # While brakes or friction hold the robot, gears need not transmit drives' torques.
            idle = wide[:, -dof:].max(axis=1) == 0.0
            unknown = maximum_filter1d(idle, 2 * reach + 1)
            out[unknown[twice], -dof:] = 0.0
            yield out


def convolved(taps: Float[np.ndarray, " taps"], x: Values) -> Float[np.ndarray, "fewer drives"]:
    """Convolve each column where the taps fit entirely, by Fourier transform."""
    count = len(x) - len(taps) + 1
    if count <= 0:
        return x[:0]
    size = 1 << (len(x) - 1).bit_length()
    product = np.fft.rfft(x, size, axis=0) * np.fft.rfft(taps, size)[:, None]
    return np.fft.irfft(product, size, axis=0)[len(taps) - 1 : len(x)]


@dataclass(frozen=True)
class Push:
    """A push on the platform, at its maximum.

    Attributes:
        time: time of the maximum [s].
        place: platform point in the world (3) [m].
        force: force in the world (3) [N].
        moment: moment about the tool's axis [N m]; None if the robot does not turn its tool.
    """

    time: float
    place: tuple[float, float, float]
    force: tuple[float, float, float]
    moment: float | None = None


@dataclass(frozen=True)
class LeftSpan:
    """An excluded stretch of time.

    Attributes:
        first, last: first and last time stamp, as the torques were recorded [s].
        reason: reason of the exclusion, such as 'contact'.
        drives: drives whose torques are excluded; all if empty.
        push: push on the platform, if that is the reason.
        gear: drive whose gear has play, if that is the reason.
    """

    first: float
    last: float
    reason: str
    drives: tuple[int, ...] = ()
    push: Push | None = None
    gear: int | None = None


@runtime_checkable
class Pull(Protocol):
    """An external cause that takes torque of the drives, such as a hose."""

    def torques(self, z: Samples, qd: Samples, qdd: Samples) -> Samples:
        """Drive torques that it takes along a motion."""
        ...


def burden_of(
    robot: RobotDescription,
    columns: Columns,
    loads: Sequence[Sequence[float]],
    pulls: Sequence[Pull],
) -> Callable[..., Samples]:
    """Function τ(time, z, q̇, q̈, extra) that returns the torques of loads and pulls.

    Args:
        columns: columns of the recording, which determine when each load is held.
        loads: ten parameters per load, in the order of `Columns.loads`; empty to ignore loads.
        pulls: external causes, which act all the time.

    Raises:
        RecordingError: the robot has no body that carries a load.
    """
    dynamics = compiled(robot)
    # Parameters of a robot that consists of the load only, for each load.
    p = np.zeros((len(columns.loads), len(dynamics.layout.names)))
    for parameters, load, ten in zip(p, columns.loads if loads else (), loads, strict=True):
        parameters[dynamics.layout.body(carrier(load, robot))] = ten

    def torques(
        time: np.ndarray, z: Samples, qd: Samples, qdd: Samples, extra: np.ndarray
    ) -> Samples:
        taken = np.zeros_like(z)
        for pull in pulls:
            taken += pull.torques(z, qd, qdd)
        for parameters, held in zip(p, columns.held(time, extra), strict=True):
            rows = np.flatnonzero(held)
            if rows.size and parameters.any():
                torque = dynamics.torque(z[rows], qd[rows], qdd[rows], parameters)
                taken[rows] += held[rows, None] * torque
        return taken

    return torques


@dataclass(frozen=True)
class TorqueDrift:
    """Torque constants that drift along a recording: τ_m = (1 + a s + b s² + c) τ, where
    s = (t − t_0)/T.

    Attributes:
        start, length: t_0 and T [s].
        coefficients: a, b and c of each drive.
    """

    start: float
    length: float
    coefficients: tuple[tuple[float, float, float], ...] = ()

    def share(self, time: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Share s of the recording at given times [s]."""
        return (time - self.start) / self.length

    def undone(self, rows: Rows, columns: Columns) -> Rows:
        """Rows with torques τ, by the torque constants at the beginning of the first recording."""
        (a, b, c), s = np.array(self.coefficients).T, self.share(rows[:, 0])[:, None]
        rows = rows.copy()
        rows[:, columns.torque_places] /= 1.0 + a * s + b * s**2 + c
        return rows


@dataclass(frozen=True)
class Repairs:
    """Known errors of a recording, corrected in every pass over it.

    Attributes:
        readings: errors of positions and torques; None for none.
        drift: drift of torque constants; None for none.
        gain: factor of each drive's torques; empty for 1.
        hold: how drives hold their torques between updates; empty for none.
        delay: lag of each drive's torques [s]; empty for none.
        constants: time constant of the first-order filter of each drive's torques [s]; empty for
            none.
        growth: growth of delays with time; None if clocks agree.
        blur: time to either side of reversals over which averages or filters blur the steps of
            each drive's torques [s]; empty for none.
        left_out: excluded stretches, in addition to the survey's masks.
        gears: compliant gears; None for stiff ones.
        loads: ten parameters of each load, in the order of `Columns.loads`, whose torques are
            subtracted; empty for none.
        pulls: external causes whose torques are subtracted.
        turns: speeds below which passive joints with friction may turn either way [rad/s or m/s];
            empty if their directions are certain.
    """

    readings: Readings | None = None
    drift: TorqueDrift | None = None
    gain: tuple[float, ...] = ()
    hold: tuple[Hold, ...] = ()
    delay: tuple[float, ...] = ()
    constants: tuple[float, ...] = ()
    growth: LagGrowth | None = None
    blur: tuple[float, ...] = ()
    left_out: tuple[LeftSpan, ...] = ()
    gears: Gears | None = None
    loads: tuple[tuple[float, ...], ...] = ()
    pulls: tuple[Pull, ...] = ()
    turns: tuple[float, ...] = ()

    def apply(self, segment: Iterator[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
        """Correct the rows of a segment.

        Args:
            segment: evenly spaced rows in blocks, columns as in `Log.batches`.
            columns: columns of the rows.
            rate: rows per second.
        """
        if not columns.torque:  # a planned motion, which needs no correction
            return segment
        if self.left_out:  # before delays, which shift weights with torques
            segment = (self._weighed(rows, columns) for rows in segment)
        if any(self.hold):
            segment = filled(segment, columns, self.hold, rate)
        if (readings := self.readings) is not None:
            segment = (readings.corrected(rows, columns) for rows in segment)
        if (drift := self.drift) is not None:
            segment = (drift.undone(rows, columns) for rows in segment)
        if any(self.delay) or any(self.constants) or self.growth:
            segment = delayed(segment, columns, self.shift(rate), rate)
        if self.gain:
            factors = np.ones(columns.extra_places.stop + len(columns.torque))
            factors[columns.torque_places] = self.gain
            segment = (rows * factors for rows in segment)
        if self.gears is not None:
            segment = self.gears.turned_back(segment, columns, rate)
        return segment

    def shift(self, rate: float) -> Shift:
        """Delays, filters and clocks at a sampling rate [Hz]."""
        return Shift.of_delays(self.delay, rate, self.constants, self.growth)

    @property
    def lag(self) -> tuple[float, ...]:
        """Lag of torques, dead time plus time constant [s]; empty for none."""
        if not any(self.constants):
            return self.delay
        return tuple(np.add(self.delay or 0.0, self.constants).tolist())

    def smear(self, rate: float) -> tuple[int, ...]:
        """Samples to either side over which each torque is interpolated or its steps are blurred;
        empty if none is."""
        parts = (
            self.shift(rate).smear,
            tuple(hold.spread for hold in self.hold),
            tuple(int(np.ceil(blur * rate)) for blur in self.blur),
        )
        present = [part for part in parts if any(part)]
        return tuple(np.sum(present, axis=0).tolist()) if present else ()

    def _weighed(self, rows: Rows, columns: Columns) -> Rows:
        """Rows with zero weights in excluded stretches, where sensors are NaN if all drives are
        excluded."""
        rows, drives = rows.copy(), len(columns.torque)
        for drives_of, ends in self._by_drives.items():
            which, excluded = drives_of or tuple(range(drives)), within(ends, rows[:, 0])
            rows[np.ix_(excluded, rows.shape[1] - drives + np.array(which))] = 0.0
            if len(which) == drives:
                rows[excluded, columns.sensor_places] = np.nan
        return rows

    @cached_property
    def _by_drives(self) -> dict[tuple[int, ...], np.ndarray]:
        """Excluded stretches by their drives, disjoint and ascending."""
        by_drives = grouped((span.drives, (span.first, span.last)) for span in self.left_out)
        return {drives: joined_times(np.array(spans)) for drives, spans in by_drives.items()}


NO_REPAIRS = Repairs()
