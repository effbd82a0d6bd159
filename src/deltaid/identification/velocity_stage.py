"""Columns as they were sampled: torques that drives hold between two updates are interpolated, and
recorded velocities and accelerations that come late give way to differentiated positions.

With x a recorded rate, filtered as everything is, and y the one that follows from the positions,

    x(t) = y(t − δ)   →   x − y = −δ ½ (ẋ + ẏ)   to third order in δ,

which a drive's velocity column shows to microseconds: no parameter and no torque is in the way.
Where rates agree with positions in time, it makes no difference whether they are used (M and
friction change by less than 0.003 % on six kinds of robot), and 2 ms of lag cost 5 % of M.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from deltaid.effects.lags import Lag
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import stretch_numbers
from deltaid.estimation.problem import group_sums
from deltaid.identification.setup import Progress, Setup
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.corrections import Correction
from deltaid.recording.hold import holds
from deltaid.recording.recording import PreparedRecording

# Windows of a recording that are compared, at most.
_WINDOWS = 8
# Lags [s] that do no harm, and how many half widths of its interval a lag is larger than.
_HARMLESS, _CLEAR = 2e-5, 2.0

_HELD = (
    "drives update their torques so seldom and hold them in the rows between, which come late: "
    "torques there are interpolated between updates"
)


def holds_filled(setup: Setup, progress: Progress) -> Setup:
    """Recordings with torques between their updates."""
    if setup.settings.lag == "none":
        return setup
    progress("looking for repeated torques")
    corrections = list[Correction]()
    for recording in setup.recordings:
        log = recording.brief.log
        if not log.columns.torque:
            continue
        held = holds(log.segments(recording.motion_cutoff), log.columns, log.rate)
        if not any(held):
            continue
        setup = setup.repaired(recording, hold=held)
        alike = len({hold.rows for hold in held}) == 1
        corrections += (
            Correction(kind="hold", subject="" if alike else drive,
                       log=recording.path.name, value=hold.rows / log.rate, unit="s", text=_HELD)
            for drive, hold in zip(setup.robot.drives, held, strict=True)
            if hold
        )  # fmt: skip
    return setup.reported(list(dict.fromkeys(corrections)), "hold")


def late_rates_left_out(setup: Setup, progress: Progress) -> Setup:
    """Recordings without velocities and accelerations that lag behind their positions."""
    if setup.settings.lag == "none":
        return setup
    corrections, recordings = list[Correction](), list[PreparedRecording]()
    for recording in setup.recordings:
        if recording.log.columns.velocity or recording.log.columns.acceleration:
            progress(f"comparing velocities of {recording.path} with positions")
        lag = late_rate(recording, setup.dynamics.kinematics)
        if lag is not None:
            corrections += _corrections(lag, recording, setup.robot.drives)
            recording = _without_rates(recording, setup.settings.cutoff)
        recordings.append(recording)
    return setup.changed(recordings=tuple(recordings)).reported(corrections, "velocity")


def _without_rates(recording: PreparedRecording, cutoff: float | None) -> PreparedRecording:
    """The recording with its positions differentiated."""
    columns = replace(recording.log.columns, velocity=(), acceleration=())
    return recording.changed(recording.cutoff or cutoff, columns=columns)


def late_rate(recording: PreparedRecording, kinematics: Kinematics) -> Lag | None:
    """The lag of recorded velocities, or else of accelerations; None where none is harmful and
    significant."""
    columns, rate = recording.log.columns, recording.log.rate
    cutoff = recording.cutoff or recording.log.suggested_cutoff
    if not (columns.velocity or columns.acceleration) or cutoff is None:
        return None
    try:
        recorded = recording.brief.changed(cutoff)
        derived = _without_rates(recording.brief, cutoff)
    except RecordingError:
        return None  # too short to be differentiated
    windows = zip(recorded.windows(kinematics), derived.windows(kinematics), strict=True)
    rows = [
        (x.own.qd, x.own.qdd, y.own.qd, y.own.qdd, y.own.weights)
        for x, y in islice(windows, _WINDOWS)
    ]
    qd, qdd, qd_derived, qdd_derived, weights = map(np.concatenate, zip(*rows, strict=True))
    counts, acceleration = weights.min(axis=1) > 0, 0.5 * (qdd + qdd_derived)
    lags = list[Lag]()
    if columns.velocity:
        lags.append(_lag(qd, qd_derived, acceleration, counts))
    if columns.acceleration:
        lags.append(_lag(qdd, qdd_derived, rate * np.gradient(acceleration, axis=0), counts))
    shown = (np.abs(lag.values) > np.maximum(_CLEAR * lag.interval, _HARMLESS) for lag in lags)
    return next((lag for lag, harmful in zip(lags, shown, strict=True) if harmful.any()), None)


def _lag(
    recorded: Float[np.ndarray, "samples dof"],
    derived: Float[np.ndarray, "samples dof"],
    slope: Float[np.ndarray, "samples dof"],
    counts: Bool[np.ndarray, " samples"],
) -> Lag:
    """δ of every drive by least squares, its deviation by scatter between stretches of time."""
    groups = stretch_numbers(len(slope))
    power, moments = (
        group_sums(np.where(counts[:, None], terms, 0.0), groups)
        for terms in (slope**2, slope * (derived - recorded))
    )
    total, n = np.maximum(power.sum(axis=0), np.finfo(float).tiny), len(power)
    values = moments.sum(axis=0) / total
    residual = moments - values * power
    return Lag(values, np.sqrt(np.sum(residual**2, axis=0) * n / max(n - 1, 1)) / total)


def _corrections(lag: Lag, recording: PreparedRecording, drives: Sequence[str]) -> list[Correction]:
    """One for all drives if their lags may be equal, or one a drive."""
    values, halves, subjects = lag.values, lag.interval, list(drives)
    if np.ptp(values) < max(_HARMLESS, 0.05 * np.abs(values).max(), halves.max()):
        weights, subjects = 1.0 / np.maximum(halves, 1e-9) ** 2, [""]
        values, halves = np.array([weights @ values / weights.sum()]), halves.max(keepdims=True)
    return [
        Correction(
            kind="velocity",
            subject=name,
            log=recording.path.name,
            value=value,
            low=value - half,
            high=value + half,
            unit="s",
            text=f"recorded velocities come {'late' if value > 0 else 'early'} against positions: "
            "they are excluded, and positions differentiated",
        )
        for name, value, half in zip(subjects, values.tolist(), halves.tolist(), strict=True)
    ]
