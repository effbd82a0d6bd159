"""Sensors other than the drives': units, signs, axes, order, delay and noise of their signals.

Each signal is compared with the robot as torques and prior determine it (`sensing.misfit`). Where
they contradict each other, maps that would correct its columns are tried (`sensing.guesses`).
"""

from collections.abc import Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import Evidence
from deltaid.checks.sensing.guesses import Guess, best_guess, mapped, verdict_of
from deltaid.checks.sensing.misfit import MapFit, Misfit, SensorLag, lag_of
from deltaid.checks.sensing.sensed_rows import SensedRows, SensorSignal, sensed_rows
from deltaid.model.verdict import Grade, Proposal, Verdict, percent
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
# Noise or residual so many times as large as stated.
_NOISY = 3.0


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_sensors(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on each sensor of a recording, good ones too; none of one without."""
    recording = evidence.surveyed
    rows = None if recording is None else sensed_rows(evidence.dynamics, recording)
    if rows is None:
        return ()
    return tuple(verdict for signal in rows.signals for verdict in _of_signal(rows, signal))


def _of_signal(rows: SensedRows, signal: SensorSignal) -> list[Verdict]:
    misfit = Misfit(rows, signal, signal)
    if misfit.counts < 1.0:
        return []
    verdicts = list(_clipped(signal))
    as_mapped = misfit.judge(np.eye(len(misfit.noise)))
    late = lag_of(misfit, as_mapped)
    if as_mapped.Q > _DOUBTED:
        if late is not None and min(_CONTRADICTS, _EXPLAINS * as_mapped.Q) > late.Q:
            return [*verdicts, _late(signal, late, rows.row, as_mapped.Q)]
        if (against := _contradiction(misfit, as_mapped)) is not None:
            return [*verdicts, against]
    least_delay = max(_ROWS * rows.row, _SURE * late.std) if late is not None else 0.0
    if late is not None and late.Q < _BETTER * as_mapped.Q and abs(late.delay) > least_delay:
        verdicts.append(_late(signal, late, rows.row, as_mapped.Q))
    rms = misfit.left(as_mapped)
    verdicts += _noisy(rows, misfit, rms)
    if verdicts:
        return verdicts
    k = int(np.argmax(rms / misfit.noise))
    channel, number = signal.rows.channels[k], float(rms[k])
    seen = f"{signal.name} agrees with the torques: at most {number:.2g} {channel.unit} is left, "
    seen += f"of {channel.name}"
    unit = channel.unit
    return [Verdict("sensor-residual", Grade.GOOD, seen, signal.name, number=number, unit=unit)]


def _contradiction(misfit: Misfit, as_mapped: MapFit) -> Verdict | None:
    """The best explanation of a sensor that contradicts the torques; None if it hardly does."""
    rows, signal = misfit.rows, misfit.signal
    alike = [other for other in rows.signals if other.units == signal.units]
    others = [other for other in alike if other is not signal and len(other.units) == 1]
    guess, described = best_guess(misfit, others), rows.dynamics.robot.sensors[signal.name]
    rest = misfit.unexplained(as_mapped)
    share = _EXPLAINS if guess.Q < _CONTRADICTS else _LEAVES
    if share * as_mapped.Q > guess.Q:
        return None if _is_allowed(guess, described) else verdict_of(guess, signal, described, rest)
    if as_mapped.Q < _CONTRADICTS:
        return None
    along, line = misfit.along, f"by the line `sensors: {{{signal.name}: null}}` of a mapping"
    if along < _DEAD:
        return Verdict(
            "sensor-dead",
            Grade.WRONG,
            f"{signal.name} does not follow the robot: its correlation with what torques expect "
            f"is {along:.2g}",
            signal.name,
            "a sensor that is not connected or not loaded, or a column of something else",
            "check by name which signal the column holds, or leave the sensor out of this "
            f"recording {line}",
            number=along,
        )
    return Verdict(
        "sensor-residual",
        Grade.DOUBTFUL,
        f"torques leave {percent(rest)} of what {signal.name} shows of the motion unexplained, and "
        "no unit, sign, order or frame of it explains that",
        signal.name,
        "a load on the sensor that is not the robot, several things at once, or a description that "
        "is not of this robot",
        f"look at the columns beside the torques of a motion known well, or leave the sensor out "
        f"{line}",
        number=100 * rest,
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


def _clipped(signal: SensorSignal) -> Iterator[Verdict]:
    for channel, numbers in zip(signal.columns.channels, signal.raw, strict=True):
        numbers = numbers[np.isfinite(numbers)]
        for end, word in ((np.max, "largest"), (np.min, "smallest")) if numbers.size else ():
            extreme = end(numbers)
            at_end = numbers == extreme
            repeated = int(np.count_nonzero(at_end[1:] & at_end[:-1]))
            if repeated > max(_CLIPPED, _OFTEN * numbers.size):
                share = 100 * repeated / numbers.size
                yield Verdict(
                    "sensor-clipped",
                    Grade.DOUBTFUL,
                    f"column {channel.column} stays on its {word} number, {extreme:.4g}, in "
                    f"{share:.2g} % of the rows",
                    signal.name,
                    "a range of the sensor or its amplifier that ends there",
                    "choose a wider range and record again",
                    number=share,
                    unit="%",
                )


def _late(signal: SensorSignal, lag: SensorLag, row: float, Q: float) -> Verdict:
    return Verdict(
        "sensor-lag",
        Grade.WRONG if Q > _CONTRADICTS else Grade.DOUBTFUL,
        f"{signal.name} is {'late' if lag.delay > 0 else 'early'} against the motion by "
        f"{1e3 * abs(lag.delay):.3g} ± {1e3 * lag.std:.2g} ms, {abs(lag.delay) / row:.3g} rows",
        signal.name,
        "a filter in the sensor's amplifier, or another clock",
        "declare how late it is in the mapping",
        mapped(signal, [("delay", float(f"{signal.columns.delay + lag.delay:.3g}"))]),
        number=1e3 * lag.delay,
        unit="ms",
    )


def _noisy(rows: SensedRows, misfit: Misfit, rms: np.ndarray) -> Iterator[Verdict]:
    """Verdicts on noise and residual beyond the stated noise."""
    name, size = misfit.signal.name, np.maximum(misfit.white, rms)
    for group in misfit.groups:
        k = max(group, key=lambda i: size[i] / misfit.noise[i])
        times, channel = float(size[k] / misfit.noise[k]), misfit.signal.rows.channels[k]
        if times <= _NOISY:
            continue
        key = "noise"
        if isinstance(rows.dynamics.robot.sensors[name], BaseWrench):
            key = "force_noise" if channel.unit == "N" else "moment_noise"
        value = float(f"{np.sqrt(np.mean(size[group] ** 2)):.2g}")
        source = "what the model leaves of" if rms[k] > misfit.white[k] else "noise of"
        yield Verdict(
            "sensor-noise",
            Grade.DOUBTFUL,
            f"{source} {channel.name} is {size[k]:.3g} {channel.unit}, {times:.2g} times the "
            f"{channel.noise:.3g} {channel.unit} stated",
            name,
            "noise that is stated too small, a resonance, or what else acts on it",
            "state the noise that it has, or find what acts on it",
            (Proposal("robot", ((f"sensors.{name}.{key}", value),)),),
            times,
        )
