"""Stages for columns of recordings: torques that drives hold between two updates are interpolated,
late velocities and accelerations are replaced by differentiated positions, and sensors join.

The lag δ of a recorded rate x against that of the positions, y, both filtered, is determined by

    x(t) = y(t − δ)   →   x − y = −δ ½ (ẋ + ẏ)   to third order in δ

to microseconds, without parameters or torques. Rates without a lag make no difference (M and
friction change by less than 0.003 % on six kinds of robot); 2 ms of lag cost 5 % of M.

Entries of a body that `free` excludes do no harm while no row determines them. A sensor's row may:
the fit would take them for exactly known, and intervals would be too narrow. So such entries become
free, with their prior. Excluded entries that torques determine stay excluded, as the description
states; so does a body with `free: []`.
"""

from collections.abc import Sequence
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.parameters import parameter_layout
from deltaid.effects.lag_groups import HARMLESS
from deltaid.effects.lags import Lag
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition, extended
from deltaid.estimation.drive_rows import stretch_numbers
from deltaid.estimation.problem import group_sums
from deltaid.identification.fit import fit
from deltaid.identification.measured_rows import MeasuredRows, SensorAddition
from deltaid.identification.setup import Progress, Setup
from deltaid.levels import ROUNDS, SETTLED
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.corrections import Correction
from deltaid.recording.hold import holds
from deltaid.recording.log import FEW_WINDOWS
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, entry_map
from deltaid.sensors.weighings import weighings

# A lag is clear above this many half widths of its 95 % interval.
CLEAR_LAG = 2.0

_HELD = (
    "drives update torques at this interval only and hold them in between, which delays them; "
    "torques are interpolated between updates"
)
_STRAIGHT = (
    "the logger draws straight lines between torques at this interval; they are interpolated "
    "smoothly"
)


def holds_filled(setup: Setup, progress: Progress) -> Setup:
    """Interpolate torques between the updates of drives."""
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
                       log=recording.path.name, value=hold.rows / log.rate, unit="s",
                       text=_STRAIGHT if hold.is_straight else _HELD)
            for drive, hold in zip(setup.robot.drives, held, strict=True)
            if hold
        )  # fmt: skip
    return setup.reported(list(dict.fromkeys(corrections)), "hold")


def late_rates_excluded(setup: Setup, progress: Progress) -> Setup:
    """Exclude recorded velocities and accelerations that lag behind positions."""
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
    """The recording without velocities and accelerations: positions are differentiated."""
    columns = recording.log.columns.without_rates
    return recording.changed(recording.cutoff or cutoff, columns=columns)


def late_rate(recording: PreparedRecording, kinematics: Kinematics) -> Lag | None:
    """The lag of recorded velocities, or else of accelerations, if harmful and significant."""
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
        (x.inner.qd, x.inner.qdd, y.inner.qd, y.inner.qdd, y.inner.weights)
        for x, y in islice(windows, FEW_WINDOWS)
    ]
    qd, qdd, qd_derived, qdd_derived, weights = map(np.concatenate, zip(*rows, strict=True))
    counts, acceleration = weights.min(axis=1) > 0, 0.5 * (qdd + qdd_derived)
    lags = list[Lag]()
    if columns.velocity:
        lags.append(rate_lag(qd, qd_derived, acceleration, counts))
    if columns.acceleration:
        lags.append(rate_lag(qdd, qdd_derived, rate * np.gradient(acceleration, axis=0), counts))
    shown = (np.abs(lag.values) > np.maximum(CLEAR_LAG * lag.interval, HARMLESS) for lag in lags)
    return next((lag for lag, harmful in zip(lags, shown, strict=True) if harmful.any()), None)


def rate_lag(
    recorded: Float[np.ndarray, "samples dof"],
    derived: Float[np.ndarray, "samples dof"],
    slope: Float[np.ndarray, "samples dof"],
    counts: Bool[np.ndarray, " samples"],
) -> Lag:
    """δ of each drive by least squares, its deviation by scatter between stretches of time."""
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
    """One correction for all drives if their lags may be equal, else one a drive."""
    values, halves, subjects = lag.values, lag.interval, list(drives)
    if np.ptp(values) < max(HARMLESS, 0.05 * np.abs(values).max(), halves.max()):
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
            text=f"recorded velocities {'lag' if value > 0 else 'lead'} positions: they are "
            "excluded, and positions are differentiated",
        )
        for name, value, half in zip(subjects, values.tolist(), halves.tolist(), strict=True)
    ]


def sensors_included(setup: Setup, progress: Progress) -> Setup:
    """Add the described sensors that some recording has columns of to the fit."""
    robot, dynamics, spread = setup.robot, setup.dynamics, setup.settings.prior_spread
    recorded = {
        sensor.name for recording in setup.recordings for sensor in recording.log.columns.sensors
    }
    names, known = [name for name in robot.sensors if name in recorded], weighings(robot)
    if not (names or known):
        return setup
    if names:
        progress(f"taking in {', '.join(names)}")
    sensors = [SensorAddition.for_sensor(dynamics, name, spread) for name in names]
    shown = MeasuredRows(extended(dynamics, sensors), known).active
    setup = setup.changed(robot=with_new_entries(robot, shown, dynamics.regressor_pattern[1]))
    sensors = tuple(SensorAddition.for_sensor(setup.dynamics, name, spread) for name in names)
    return setup.changed(additions=(*setup.additions, *sensors))


def with_new_entries(
    robot: RobotDescription,
    shown: Int[np.ndarray, " shown"],
    by_torques: Int[np.ndarray, " visible"],
) -> RobotDescription:
    """The description with those entries of M̄ free that only sensors and measured values determine.

    Args:
        shown: numbers of the parameters that these determine.
        by_torques: numbers of the parameters that torques determine.
    """
    layout, bodies = parameter_layout(robot), dict(robot.bodies)
    new = np.isin(np.arange(len(layout.names)), np.setdiff1d(shown, by_torques))
    for name in layout.bodies:
        consists = np.any(entry_map()[new[layout.body(name)]] != 0, axis=0)
        free = bodies[name].free
        pairs = zip(PSEUDO_INERTIA_ENTRIES, consists, strict=True)
        entries = tuple(entry for entry, is_needed in pairs if is_needed or entry in free)
        if free and set(entries) != set(free):
            bodies[name] = bodies[name].changed(free=entries)
    return robot if bodies == robot.bodies else robot.changed(bodies=bodies)


def sensors_settled(setup: Setup, progress: Progress) -> Setup:
    """Linearise sensors' gains and poses about the fitted values, by turns with the fit."""
    sensors = [sensor for sensor in setup.additions if isinstance(sensor, SensorAddition)]
    if not any(sensor.is_bilinear for sensor in sensors):
        return setup
    progress("settling gain and pose of sensors")
    for _ in range(ROUNDS):
        problem = fit(setup.dynamics, setup.recordings, setup.settings, additions=setup.additions)
        known = problem.layout.named(problem.values)
        steps, additions = list[float](), list[Addition]()
        for addition in setup.additions:
            if isinstance(addition, SensorAddition):
                steps += [
                    abs(known[entry.name] - addition.known.get(entry.name, entry.prior))
                    / (addition.prior_spread * entry.scale)
                    for entry in addition.parameters
                ]
                name, spread = addition.rows.name, addition.prior_spread
                addition = SensorAddition.for_sensor(setup.dynamics, name, spread, known)
            additions.append(addition)
        setup = setup.changed(additions=tuple(additions))
        if max(steps) < SETTLED:
            break
    return setup
