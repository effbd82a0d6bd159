"""Recorded velocities and accelerations that come late are left out, and positions differentiated.

With x the recorded rate, filtered as everything is, and y the one that follows from the positions,

    x(t) = y(t − δ)   →   x − y = −δ ½ (ẋ + ẏ)   to third order in δ,

which a drive's velocity column shows to microseconds: no parameter and no torque is in the way.
Where rates agree with positions in time, it makes no difference whether they are used (M and
friction change by less than 0.003 % on six kinds of robot), and 2 ms of lag cost 5 % of M.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import stretch_starts
from deltaid.estimation.scatter import quantile
from deltaid.identification.setup import Progress, Setup
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.corrections import Correction
from deltaid.recording.recording import Recording

# Windows that are compared.
_WINDOWS = 8
# Lags [s] that do no harm, and how many half widths of its interval a lag is larger than.
_HARMLESS, _CLEAR = 2e-5, 2.0


@dataclass(frozen=True, eq=False)
class RateLag:
    """By how much a recorded rate of each drive is late.

    Attributes:
        values: [s].
        interval: half widths of their 95 % intervals [s].
    """

    values: Float[np.ndarray, " dof"]
    interval: Float[np.ndarray, " dof"]

    @property
    def shows(self) -> bool:
        """Whether any is too large to be left alone, and certain."""
        clear = np.abs(self.values) > np.maximum(_CLEAR * self.interval, _HARMLESS)
        return bool(np.any(clear))

    @property
    def alike(self) -> bool:
        """Whether all may be the same."""
        apart = np.ptp(self.values)
        return bool(apart < max(_HARMLESS, 0.05 * np.abs(self.values).max(), self.interval.max()))


def late_rates_left_out(setup: Setup, progress: Progress) -> Setup:
    """Recordings without velocities and accelerations that lag behind their positions."""
    if setup.settings.lag == "none":
        return setup
    told, recordings = list[Correction](), list[Recording]()
    for one in setup.recordings:
        if one.log.columns.velocity or one.log.columns.acceleration:
            progress(f"comparing velocities of {one.path} with positions")
        rate = late_rate(one, setup.dynamics.kinematics)
        if rate is not None:
            one = without_rates(one, setup.settings.cutoff)
            told += _told(rate, one, setup.robot.drives)
        recordings.append(one)
    return setup.changed(recordings=tuple(recordings)).told(told, "velocity")


def without_rates(recording: Recording, cutoff: float | None) -> Recording:
    """The recording with its positions differentiated, whatever else was recorded."""
    columns = replace(recording.log.columns, velocity=(), acceleration=())
    return recording.changed(recording.cutoff or cutoff, columns=columns)


def late_rate(recording: Recording, kinematics: Kinematics) -> RateLag | None:
    """The lag of recorded velocities, or else of accelerations; None where none shows."""
    columns = recording.log.columns
    if not columns.velocity and not columns.acceleration:
        return None
    cutoff = recording.cutoff or recording.log.suggested_cutoff
    if cutoff is None:
        return None
    recording = recording.brief
    try:
        recorded, derived = recording.changed(cutoff), without_rates(recording, cutoff)
    except RecordingError:
        return None  # too short to be differentiated
    rows = [
        (x.own.qd, x.own.qdd, y.own.qd, y.own.qdd, y.own.weights)
        for x, y in islice(
            zip(recorded.windows(kinematics), derived.windows(kinematics), strict=True), _WINDOWS
        )
    ]
    qd, qdd, qd_derived, qdd_derived, weights = (
        np.concatenate(part) for part in zip(*rows, strict=True)
    )
    counts = weights.min(axis=1) > 0
    rate = recording.log.rate
    if columns.velocity:
        found = _lag(qd, qd_derived, 0.5 * (qdd + qdd_derived), counts)
        if found.shows:
            return found
    if columns.acceleration:
        jerk = 0.5 * rate * np.gradient(qdd + qdd_derived, axis=0)
        found = _lag(qdd, qdd_derived, jerk, counts)
        if found.shows:
            return found
    return None


def _lag(
    recorded: Float[np.ndarray, "samples dof"],
    derived: Float[np.ndarray, "samples dof"],
    slope: Float[np.ndarray, "samples dof"],
    counts: Bool[np.ndarray, " samples"],
) -> RateLag:
    """δ of every drive by least squares, its deviation by scatter between stretches of time."""
    starts = stretch_starts(len(slope))

    def sums(x: np.ndarray) -> np.ndarray:
        return np.add.reduceat(np.where(counts[:, None], x, 0.0), starts, axis=0)

    power, moments = sums(slope**2), sums(slope * (derived - recorded))
    total = np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    values = moments.sum(axis=0) / total
    left = moments - values * power
    deviation = np.sqrt(np.sum(left**2, axis=0) * len(starts) / max(len(starts) - 1, 1)) / total
    return RateLag(values, float(quantile(np.array([len(starts) - 1.0]))[0]) * deviation)


def _told(rate: RateLag, recording: Recording, drives: Sequence[str]) -> list[Correction]:
    """One for all drives, or one a drive."""
    shown = [""] if rate.alike else list(drives)
    values, halves = rate.values, rate.interval
    if rate.alike:
        weights = 1.0 / np.maximum(halves, 1e-9) ** 2
        values = np.array([float(weights @ values / weights.sum())])
        halves = np.array([float(halves.max())])
    return [
        Correction(
            kind="velocity",
            subject=name,
            log=recording.path.name,
            value=float(value),
            low=float(value - half),
            high=float(value + half),
            unit="s",
            text=f"recorded velocities come {'late' if value > 0 else 'early'} against positions: "
            "they are left out, and positions differentiated",
        )
        for name, value, half in zip(shown, values, halves, strict=True)
    ]
