"""Sensors beside the drives: units, signs, axes, order and time of what they show, and their noise.

What torques and the prior say of the robot, with all that they leave open, is compared with what
each sensor shows (`sensing.misfit`). Where these contradict each other, maps that would put its
columns right are tried (`sensing.guesses`).
"""

from collections.abc import Iterable, Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.sensing.guesses import Guess, best_guess
from deltaid.check.sensing.lateness import lag_of
from deltaid.check.sensing.misfit import Found, Misfit
from deltaid.check.sensing.sheet import Sensed, Sheet, sheet
from deltaid.check.sensing.told import mapped, told
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.model.verdict import Grade, Proposal, Verdict, worst
from deltaid.model.words import percent
from deltaid.recording.recording import Recording
from deltaid.robot.sensors import BaseWrench, Sensor

# Misfit from which guesses are tried, and from which a sensor contradicts the torques even if none
# explains it; the share of a misfit that a guess may leave, and of a large one.
_DOUBTED, _CONTRADICTS, _EXPLAINS, _LEAVES = 0.15, 1.0, 0.2, 0.04
# So many times a tolerance is what it allows.
_ALLOWED = 3.0
# A sensor is dead where it goes with what is expected no better than this.
_DEAD = 0.2
# Clipped: so many rows, and this share of all, on the largest or the smallest number.
_CLIPPED, _OFTEN = 20, 0.005
# Late: by so many rows, so many standard deviations, and the misfit is so much less without it.
_ROWS, _SURE, _BETTER = 1.5, 6.0, 0.9
# Noise, or what is left, so many times as large as stated.
_NOISY = 3.0


def checked_sensors(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on each sensor of a recording; none of one without."""
    recording = evidence.surveyed
    if isinstance(recording, RecordingError):
        return ()
    return sensor_verdicts(evidence.dynamics, [recording])


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def sensor_verdicts(dynamics: Dynamics, recordings: Iterable[Recording]) -> tuple[Verdict, ...]:
    """Verdicts on each sensor of each recording, good ones too.

    Args:
        dynamics: of the robot as described.
        recordings: surveyed, with their filters.
    """
    found: list[Verdict] = []
    for recording in recordings:
        rows = sheet(dynamics, recording)
        if rows is not None:
            for sensor in rows.sensors:
                found += _of_sensor(rows, sensor)
    return tuple(found)


def _of_sensor(rows: Sheet, sensor: Sensed) -> list[Verdict]:
    misfit = Misfit(rows, sensor, sensor.channels)
    if misfit.told.sum() < 1.0:
        return []
    found = list(_clipped(rows, sensor))
    plain = misfit.of(np.eye(len(misfit.noise)))
    late = lag_of(misfit, plain)
    if plain.Q > _DOUBTED:
        if late is not None and min(_CONTRADICTS, _EXPLAINS * plain.Q) > late.Q:
            return [*found, _late(sensor, late.delay, late.std, rows.row, plain.Q)]
        if (against := _contradiction(misfit, plain)) is not None:
            return [*found, against]
    least = max(_ROWS * rows.row, _SURE * late.std) if late is not None else 0.0
    if late is not None and late.Q < _BETTER * plain.Q and abs(late.delay) > least:
        found.append(_late(sensor, late.delay, late.std, rows.row, plain.Q))
    found += _noisy(rows, misfit, plain)
    return found if worst(found) is not Grade.GOOD else [_good(misfit, plain)]


def _contradiction(misfit: Misfit, plain: Found) -> Verdict | None:
    """What explains best why a sensor contradicts the torques; None where it hardly does."""
    rows, sensor = misfit.sheet, misfit.sensor
    others = tuple(
        one
        for one in rows.sensors
        if one is not sensor
        and [c.unit for c in one.rows.channels] == [c.unit for c in sensor.rows.channels]
        and len(one.rows.channels) == 1
    )
    guess, described = best_guess(misfit, others), rows.dynamics.robot.sensors[sensor.name]
    left = misfit.unexplained(plain)
    share = _EXPLAINS if guess.Q < _CONTRADICTS else _LEAVES
    if share * plain.Q > guess.Q:
        return None if _is_allowed(guess, described) else told(guess, sensor, described, left)
    if plain.Q < _CONTRADICTS:
        return None
    along = _along(misfit)
    if along < _DEAD:
        return Verdict(
            "sensor-dead",
            Grade.WRONG,
            f"{sensor.name} does not follow the robot: its correlation with what torques expect "
            f"is {along:.2g}",
            subject=sensor.name,
            cause="a sensor that is not connected or not loaded, or a column of something else",
            cure="check by name which signal the column holds, or leave the sensor out of this "
            f"recording by the line `sensors: {{{sensor.name}: null}}` of a mapping",
            number=along,
        )
    return Verdict(
        "sensor-residual",
        Grade.DOUBTFUL,
        f"torques leave {percent(left)} of what {sensor.name} shows of the motion unexplained, and "
        "no unit, sign, order or frame of it explains that",
        subject=sensor.name,
        cause="a load on the sensor that is not the robot, several things at once, or a "
        "description that is not of this robot",
        cure="look at the columns beside the torques of a motion known well, or leave the sensor "
        f"out by the line `sensors: {{{sensor.name}: null}}` of a mapping",
        number=100 * left,
        unit="%",
    )


def _is_allowed(guess: Guess, sensor: Sensor) -> bool:
    """Whether the description has a tolerance for it, so that a fit takes it in."""
    if guess.kind == "unit":
        return bool(np.all(np.abs(guess.gains - 1) < _ALLOWED * sensor.gain_tolerance))
    if not isinstance(sensor, BaseWrench) or guess.kind not in ("rotated", "origin"):
        return False
    if guess.kind == "origin":
        return float(np.abs(guess.offset).max()) < _ALLOWED * sensor.position_tolerance
    return guess.angle < _ALLOWED * sensor.rotation_tolerance


def _along(misfit: Misfit) -> float:
    """Correlation of what is shown with what torques expect, without means."""
    G, g = misfit.sheet.of_torques
    expected = misfit.expected(np.linalg.solve(G, g))
    mean = expected.sum(axis=1) / misfit.told.sum()
    expected = (expected - mean[:, None] * misfit.told) / misfit.noise[:, None]
    y = misfit.moving / misfit.noise[:, None]
    size = np.sqrt(np.sum(expected**2) * np.sum(y**2))
    return float(abs(np.sum(expected * y)) / max(size, 1e-300))


def _clipped(rows: Sheet, sensor: Sensed) -> Iterator[Verdict]:
    for channel, values in zip(sensor.given.channels, rows.raw[sensor.channels], strict=True):
        values = values[np.isfinite(values)]
        if not values.size:
            continue
        for end, word in ((values.max(), "largest"), (values.min(), "smallest")):
            at = values == end
            held = int(np.count_nonzero(at[1:] & at[:-1]))
            if held > max(_CLIPPED, _OFTEN * values.size):
                yield Verdict(
                    "sensor-clipped",
                    Grade.DOUBTFUL,
                    f"column {channel.column} stays on its {word} number, {end:.4g}, in "
                    f"{100 * held / values.size:.2g} % of the rows",
                    subject=sensor.name,
                    cause="a range of the sensor or its amplifier that ends there",
                    cure="choose a wider range and record again",
                    number=100 * held / values.size,
                    unit="%",
                )


def _late(sensor: Sensed, delay: float, std: float, row: float, Q: float) -> Verdict:
    word = "late" if delay > 0 else "early"
    return Verdict(
        "sensor-lag",
        Grade.WRONG if Q > _CONTRADICTS else Grade.DOUBTFUL,
        f"{sensor.name} is {word} against the motion by {1e3 * abs(delay):.3g} ± "
        f"{1e3 * std:.2g} ms, {abs(delay) / row:.3g} rows",
        subject=sensor.name,
        cause="a filter in the sensor's amplifier, or another clock",
        cure="declare how late it is in the mapping",
        proposals=mapped(sensor, [("delay", float(f"{sensor.given.delay + delay:.3g}"))]),
        number=1e3 * delay,
        unit="ms",
    )


def _noisy(rows: Sheet, misfit: Misfit, plain: Found) -> Iterator[Verdict]:
    """Noise from row to row, and what is left after the filter, beside what is stated."""
    sensor = misfit.sensor
    white, left = misfit.white, misfit.left(np.eye(len(misfit.noise)), plain)
    size = np.maximum(white, left)
    for keys, group in zip(_keys(rows, sensor, misfit), misfit.groups, strict=True):
        k = max(group, key=lambda one: size[one] / misfit.noise[one])
        times = float(size[k] / misfit.noise[k])
        if times > _NOISY:
            channel = sensor.rows.channels[k]
            value = float(f"{np.sqrt(np.mean(size[group] ** 2)):.2g}")
            what = "what the model leaves of" if left[k] > white[k] else "noise of"
            yield Verdict(
                "sensor-noise",
                Grade.DOUBTFUL,
                f"{what} {channel.name} is {size[k]:.3g} {channel.unit}, {times:.2g} times the "
                f"{channel.noise:.3g} {channel.unit} stated",
                subject=sensor.name,
                cause="noise that is stated too small, a resonance, or what else acts on it",
                cure="state the noise that it has, or look for what acts on it",
                proposals=(Proposal("robot", ((keys, value),)),),
                number=times,
            )


def _keys(rows: Sheet, sensor: Sensed, misfit: Misfit) -> list[str]:
    """The key of the noise of each group."""
    where = f"sensors.{sensor.name}"
    if not isinstance(rows.dynamics.robot.sensors[sensor.name], BaseWrench):
        return [f"{where}.noise"] * len(misfit.groups)
    units = [sensor.rows.channels[group[0]].unit for group in misfit.groups]
    return [f"{where}.{'force' if unit == 'N' else 'moment'}_noise" for unit in units]


def _good(misfit: Misfit, plain: Found) -> Verdict:
    left = misfit.left(np.eye(len(misfit.noise)), plain)
    k = int(np.argmax(left / misfit.noise))
    channel = misfit.sensor.rows.channels[k]
    return Verdict(
        "sensor-residual",
        Grade.GOOD,
        f"{misfit.sensor.name} agrees with the torques: at most {left[k]:.2g} {channel.unit} is "
        f"left, of {channel.name}",
        subject=misfit.sensor.name,
        number=float(left[k]),
        unit=channel.unit,
    )
