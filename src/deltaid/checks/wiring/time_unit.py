"""Time in another unit, or of another cycle, than the mapping says.

Where time is f times too long, q̇ is f times and q̈ is f² times too small. Inertia then seems f²
times and viscous friction f times what is described, and gravity and Coulomb friction stay.
Recorded velocities are f times the rate at which positions change.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import WRONG_SCALE, Evidence
from deltaid.checks.wiring.candidate import as_good
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.residual import UNIT, FilteredMotion, residual
from deltaid.checks.wiring.velocity import rates
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.time.counts import unit_factors

# Number of chords of the motion that bound its speed from below.
_CHORDS = 32


def time_unit_verdicts(log: RemappedRecording) -> Iterator[Verdict]:
    """A verdict where inertia and viscous friction agree on a factor of time, with which a robot
    nearer to the described one explains the torques.

    Only moving drives that limbs tie to others count: of a single drive, other units look the same.
    """
    tied = ~log.best.loose & ~log.best.residual.still if log.good else np.zeros(0, bool)
    if not tied.any():
        return
    estimated, expected = log.components[:, tied]
    ratios = estimated / np.where(expected == 0, np.nan, expected)
    inertia, gravity, viscous, coulomb = (_usual(column) for column in ratios.T)
    static = coulomb if np.isnan(gravity) else gravity
    factor = float(np.sqrt(inertia / static))
    far = max(factor, 1 / factor)
    if not far**2 > UNIT:
        return
    speeds = [abs(rate.scale) for rate in rates(log.motion, log.best.map)]
    confirmed = bool(speeds) and all(_agrees(speed, factor) for speed in speeds)
    if not (confirmed or _agrees(viscous / static, factor)) or not _is_likelier(log, factor):
        return
    factor = float(np.median(speeds)) if confirmed else factor
    sure, by = confirmed or far > WRONG_SCALE, max(factor, 1 / factor)
    size = f"{by:.3g}" if confirmed else f"about {by:.2g}"
    rate = float(f"{factor / log.evidence.rows.step:.2g}")
    rest = "" if sure else ", or inertia and viscous friction are not as described"
    yield Verdict(
        "time-unit",
        Grade.WRONG if sure else Grade.DOUBTFUL,
        f"torques of inertia are {inertia:.3g} times those of the prior, of viscous friction "
        f"{viscous:.3g} times, of {'Coulomb friction' if np.isnan(gravity) else 'gravity'} "
        f"{static:.3g} times",
        cause=f"time is in another unit or cycle, {size} times too "
        f"{'long' if factor > 1 else 'short'}{rest}",
        cure="declare the unit of the time column, such as time: {column: t, unit: 100 us}, or the "
        f"rate, here about time: {{rate: {rate:g}}}",
        number=factor,
    )


def too_fast_verdicts(record: Evidence) -> Iterator[Verdict]:
    """A verdict where a drive would exceed its limit between samples far apart, for a recording
    that is too short to be filtered."""
    rows, robot = record.rows, record.robot
    if record.stands or len(rows.time) <= _CHORDS:
        return
    few = np.linspace(0, len(rows.time) - 1, _CHORDS + 1).astype(int)
    seconds = float(np.ptp(rows.time[few]))
    speeds = np.abs(np.diff(rows.q[few], axis=0)).sum(axis=0) / max(seconds, np.finfo(float).tiny)
    most = [robot.limits_of(drive).top_speed or np.inf for drive in robot.drives]
    i = int(np.argmax(speeds / np.array(most)))
    if speeds[i] > most[i]:
        time = record.columns.time
        fits = (unit for unit, by in unit_factors(time).items() if by * speeds[i] < most[i])
        unit = f"{robot.units(robot.drives[i]).coordinate}/s"
        yield Verdict(
            "time-unit",
            Grade.WRONG,
            f"{robot.drives[i]} would move at {speeds[i]:.2g} {unit} on average, and its limit is "
            f"{most[i]:.2g} {unit}; in {seconds:.2g} s no columns can be judged",
            cause="time is in another unit",
            cure="declare the unit of the time column, such as time: {column: "
            f"{time.column}, unit: {next(fits, '…')}}}",
            number=float(speeds[i] / most[i]),
        )


def _usual(ratios: Float[np.ndarray, " drives"]) -> float:
    """The median of positive ratios: a wrong sign is noise. NaN where there are none."""
    positive = ratios[ratios > 0]
    return float(np.median(positive)) if positive.size else np.nan


def _agrees(ratio: float, factor: float) -> bool:
    """Whether a ratio is nearer to a factor than to 1, and than to the factor's square."""
    return bool(abs(np.log(ratio / factor)) < 0.5 * abs(np.log(factor)))


def _is_likelier(log: RemappedRecording, factor: float) -> bool:
    """Whether the recording is clearly likelier with its time divided by a factor."""
    timed = residual(log.evidence.dynamics, _faster(log.motion, factor), log.best.map)
    if timed is None:
        return False
    gain = replace(log.best, residual=timed).fit.score - log.best.fit.score
    return gain > as_good(len(timed.Y))


def _faster(motion: FilteredMotion, factor: float) -> FilteredMotion:
    return replace(motion, qd=factor * motion.qd, qdd=factor**2 * motion.qdd)
