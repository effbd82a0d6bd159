"""Checks of sensors in addition to the drives: unit, sign, axes, order, delay and noise.

Each signal is compared with the robot as torques and prior determine it (`sensing.misfit`). If they
contradict each other, maps that would correct its columns are tried (`sensing.guesses`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import UNRELATED, Evidence
from deltaid.checks.sensing.guesses import Guess, best_guess, mapped, verdict_of
from deltaid.checks.sensing.misfit import MapFit, Misfit, misfits
from deltaid.levels import FEW_ROUNDS, STRONG, SURE
from deltaid.model.verdict import Grade, Proposal, Verdict, percent
from deltaid.robot.sensors import BaseWrench, Sensor

# Misfit from which guesses are tried, and from which a sensor contradicts the torques even if no
# guess explains it; largest remaining share of a misfit with a guess.
_DOUBTED, _CONTRADICTS, _EXPLAINS = 0.15, 1.0, 0.2
# Largest remaining share of a misfit with a delay that is reported.
_BETTER = 0.9
# Least number and share of rows at the largest or smallest number of a clipped sensor.
_CLIPPED, _OFTEN = 20, 0.005
# Prior deviation of a delay [s].
_DELAY = 0.05


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_sensors(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on each sensor of a recording, good ones included."""
    if (recording := evidence.surveyed) is None:
        return ()
    sensors = misfits(evidence.dynamics, recording)
    return tuple(verdict for misfit in sensors for verdict in _of_sensor(misfit, sensors))


@dataclass(frozen=True)
class SensorLag:
    """A sensor's delay against the motion, its deviation [s], and the misfit without it."""

    delay: float
    std: float
    Q: float


def _lag_of(misfit: Misfit, unshifted: MapFit) -> SensorLag | None:
    """The delay δ of a sensor, y(t) = ŷ(t − δ), by Gauss–Newton steps jointly with θ; None with
    holes, across which a signal cannot be shifted."""
    if np.ptp(misfit.samples) > 1e-6:
        return None
    T, theta, delay, std = np.eye(len(misfit.noise)), unshifted.theta, 0.0, np.inf
    for _ in range(FEW_ROUNDS):
        expected = misfit.expected(theta)
        slope = np.zeros_like(expected)
        for part in misfit.stretches():
            slope[:, part] = -np.gradient(expected[:, part], misfit.period, axis=1)
        fit = misfit.earlier(delay).with_columns(slope[:, None, :], _DELAY).judge(T)
        theta, step, std = fit.theta[:-1], float(fit.theta[-1]), fit.last_std
        delay += step
    return SensorLag(delay, std, misfit.earlier(delay).judge(T).Q)


def _of_sensor(misfit: Misfit, sensors: Sequence[Misfit]) -> list[Verdict]:
    if misfit.counts < 1.0:
        return []
    verdicts = list(_clipped(misfit))
    as_mapped = misfit.judge(np.eye(len(misfit.noise)))
    late = _lag_of(misfit, as_mapped)
    if as_mapped.Q > _DOUBTED:
        if late is not None and min(_CONTRADICTS, _EXPLAINS * as_mapped.Q) > late.Q:
            return [*verdicts, _late(misfit, late, as_mapped.Q)]
        if (against := _contradiction(misfit, sensors, as_mapped)) is not None:
            return [*verdicts, against]
    least = np.inf if late is None else max(misfit.row, STRONG * late.std)
    if late is not None and late.Q < _BETTER * as_mapped.Q and abs(late.delay) > least:
        verdicts.append(_late(misfit, late, as_mapped.Q))
    rms = misfit.residual_rms(as_mapped)
    verdicts += _noisy(misfit, rms)
    k = int(np.argmax(rms / misfit.noise))
    channel, number = misfit.rows.channels[k], float(rms[k])
    seen = (
        f"{misfit.name} agrees with the torques: at most {number:.2g} {channel.unit} is left, "
        f"of {channel.name}"
    )
    return verdicts or [
        Verdict("sensor-residual", Grade.GOOD, seen, misfit.name, number=number, unit=channel.unit)
    ]


def _contradiction(misfit: Misfit, sensors: Sequence[Misfit], as_mapped: MapFit) -> Verdict | None:
    """The best explanation of a sensor that contradicts the torques; None if it does not."""
    others = [other for other in sensors if other is not misfit and other.units == misfit.units]
    guess = best_guess(misfit, others if len(misfit.units) == 1 else ())
    described, name = misfit.rows.sensor, misfit.name
    rest = misfit.unexplained(as_mapped)
    share = _EXPLAINS if guess.Q < _CONTRADICTS else _EXPLAINS**2
    if share * as_mapped.Q > guess.Q:
        return None if _is_allowed(guess, described) else verdict_of(guess, misfit, rest)
    if as_mapped.Q < _CONTRADICTS:
        return None
    correlation, line = misfit.correlation, f"by the line `sensors: {{{name}: null}}` of a mapping"
    if correlation < UNRELATED:
        return Verdict(
            "sensor-dead",
            Grade.WRONG,
            f"{name} does not follow the robot: its correlation with what torques expect is "
            f"{correlation:.2g}",
            name,
            "a sensor that is not connected or not loaded, or a column of something else",
            "check by name which signal the column holds, or leave the sensor out of this "
            f"recording {line}",
            number=correlation,
        )
    return Verdict(
        "sensor-residual",
        Grade.DOUBTFUL,
        f"torques leave {percent(rest)} of what {name} shows of the motion unexplained, and no "
        "unit, sign, order or frame of it explains that",
        name,
        "a load on the sensor that is not the robot, several things at once, or a description that "
        "is not of this robot",
        f"look at the columns beside the torques of a motion known well, or leave the sensor out "
        f"{line}",
        number=100 * rest,
        unit="%",
    )


def _is_allowed(guess: Guess, sensor: Sensor) -> bool:
    """Whether a tolerance of the description covers it, so that a fit can correct it."""
    if guess.kind == "unit":
        return bool(np.all(np.abs(guess.gains - 1) < SURE * sensor.gain_tolerance))
    if not isinstance(sensor, BaseWrench) or guess.kind not in ("rotated", "origin"):
        return False
    if guess.kind == "origin":
        return float(np.abs(guess.offset).max()) < SURE * sensor.position_tolerance
    return guess.angle < SURE * sensor.rotation_tolerance


def _clipped(misfit: Misfit) -> Iterator[Verdict]:
    for channel, numbers in zip(misfit.columns.channels, misfit.raw, strict=True):
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
                    misfit.name,
                    "a range of the sensor or its amplifier that ends there",
                    "choose a wider range and record again",
                    number=share,
                    unit="%",
                )


def _late(misfit: Misfit, lag: SensorLag, Q: float) -> Verdict:
    return Verdict(
        "sensor-lag",
        Grade.WRONG if Q > _CONTRADICTS else Grade.DOUBTFUL,
        f"{misfit.name} is {'late' if lag.delay > 0 else 'early'} against the motion by "
        f"{1e3 * abs(lag.delay):.3g} ± {1e3 * lag.std:.2g} ms, {abs(lag.delay) / misfit.row:.3g} "
        "rows",
        misfit.name,
        "a filter in the sensor's amplifier, or another clock",
        "declare how late it is in the mapping",
        mapped(misfit, [("delay", float(f"{misfit.columns.delay + lag.delay:.3g}"))]),
        number=1e3 * lag.delay,
        unit="ms",
    )


def _noisy(misfit: Misfit, rms: np.ndarray) -> Iterator[Verdict]:
    size = np.maximum(misfit.white, rms)
    times = size / misfit.noise
    for group in misfit.groups:
        k = max(group, key=lambda i: times[i])
        channel, key = misfit.rows.channels[k], "noise"
        if times[k] <= SURE:
            continue
        if isinstance(misfit.rows.sensor, BaseWrench):
            key = "force_noise" if channel.unit == "N" else "moment_noise"
        value = float(f"{np.sqrt(np.mean(size[group] ** 2)):.2g}")
        source = "what the model leaves of" if rms[k] > misfit.white[k] else "noise of"
        yield Verdict(
            "sensor-noise",
            Grade.DOUBTFUL,
            f"{source} {channel.name} is {size[k]:.3g} {channel.unit}, {times[k]:.2g} times the "
            f"{channel.noise:.3g} {channel.unit} stated",
            misfit.name,
            "noise that is stated too small, a resonance, or what else acts on it",
            "state the noise that it has, or find what acts on it",
            (Proposal("robot", ((f"sensors.{misfit.name}.{key}", value),)),),
            float(times[k]),
        )
