"""Whether a recording's columns are what they are taken for, and its velocities worth taking.

A drive's velocity often comes filtered, and so late against its position, or with more noise than
differences of the positions have. Both make loads look lighter: what is late, and what is noise,
stands in the columns of the load and not in the torques.

Where the model's torques go along with those recorded, drive by drive, columns are what they are
taken for. Else signs, order and units are judged as an identification judges them, and what is
wrong is refused as there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.errors import Doubt, RecordingError
from deltaid.estimation.spectra import white_noise
from deltaid.model.model import Model
from deltaid.model.verdict import Grade
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import with_filter

# A lag [s] that does no harm, and noise [rad/s or m/s] that does none.
_HARMLESS, _QUIET = 1e-4, 3e-3
# Rows that are looked at, seconds that are averaged over, parts whose scatter says how sure a lag
# is, and so many deviations.
_ROWS, _MEAN, _PARTS, _CLEAR = 1 << 16, 0.02, 20, 4.0


@dataclass(frozen=True, eq=False)
class RecordedSpeeds:
    """What is known of a recording's velocities.

    Attributes:
        differenced: whether positions are differenced, because none are recorded or as that is
            better.
        noise: standard deviation of one cycle's speed, as it is taken, drive by drive.
        doubts: why recorded ones are not taken.
    """

    differenced: bool
    noise: tuple[float, ...]
    doubts: tuple[Doubt, ...] = ()


def speeds_of(log: Log, model: Model) -> RecordedSpeeds:
    """Look at the velocities of a recording."""
    dof = model.dynamics.dof
    made = log.position_noise[:dof] * log.rate * np.sqrt(2.0)
    differences = RecordedSpeeds(True, tuple(made.tolist()))
    if not log.columns.velocity:
        return differences
    known = model.identified.corrections if model.identified else ()
    if any(
        correction.kind == "velocity" for correction in known
    ):  # its drives' velocities come late
        return differences
    rows = _first(log)
    lag, names = _lag(rows, log.rate, dof), [channel.column for channel in log.columns.velocity]
    if np.abs(lag).max() > _HARMLESS:
        return replace(differences, doubts=(_late(lag, names),))
    noise = white_noise(rows[:, 1 + dof : 1 + 2 * dof])
    if np.any(noise > np.maximum(made, _QUIET)):
        return replace(differences, doubts=(_noisy(noise, made, names),))
    return RecordedSpeeds(False, tuple(noise.tolist()))


def _first(log: Log) -> Float[np.ndarray, "rows channels"]:
    """The longest of the first stretches of even rows."""
    found, read = np.zeros((0, len(log.columns.all))), 0
    for segment in log.segments(None):
        for rows in segment:
            found, read = max(found, rows[:_ROWS], key=len), read + len(rows)
            if read > _ROWS:
                return found
    return found


def _lag(
    rows: Float[np.ndarray, "rows channels"], rate: float, dof: int
) -> Float[np.ndarray, " drives"]:
    """By how much recorded velocities are late, v(t) = q̇(t − δ) = q̇ − δ q̈ [s]; zero unless sure.

    Means over some hundredths of a second, of velocities and of what positions did meanwhile, have
    hardly any noise.
    """
    n = max(1, round(_MEAN * rate))
    q, v = rows[:, 1 : 1 + dof], rows[:, 1 + dof : 1 + 2 * dof]
    if len(q) < 4 * n + _PARTS:
        return np.zeros(dof)
    area = np.vstack([np.zeros(dof), np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0)])
    means, true = (area[n:] - area[:-n]) / n, (q[n:] - q[:-n]) * rate / n
    change = (true[2 * n :] - true[: -2 * n]) * rate / (2 * n)
    late = (true - means)[n:-n]
    starts = np.linspace(0, len(late), _PARTS, endpoint=False).astype(int)
    power, moment = (np.add.reduceat(x, starts) for x in (change**2, change * late))
    total = np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    lag = moment.sum(axis=0) / total
    deviation = np.sqrt(np.sum((moment - lag * power) ** 2, axis=0)) / total
    return np.where(np.abs(lag) > _CLEAR * deviation, lag, 0.0)


def _late(lag: Float[np.ndarray, " drives"], names: Sequence[str]) -> Doubt:
    i = int(np.argmax(np.abs(lag)))
    word = "late" if lag[i] > 0 else "early"
    return Doubt(
        f"column {names[i]} comes {1e3 * abs(lag[i]):.2g} ms "
        f"{word} against its position: velocities are excluded, and positions differenced",
        cause="the drive filters its velocity",
        cure="a controller that runs on such velocities has to difference positions too "
        "(OnlineSettings.speed)",
        key="velocity",
    )


def _noisy(noise: np.ndarray, made: np.ndarray, names: Sequence[str]) -> Doubt:
    i = int(np.argmax(noise))
    return Doubt(
        f"column {names[i]} has noise of {noise[i]:.2g} a row, and differences of its position "
        f"have {made[i]:.2g}: velocities are excluded, and positions differenced",
        cause="the drive makes its velocity of few steps of the encoder",
        cure="a controller that runs on such velocities has to difference positions too "
        "(OnlineSettings.speed)",
        key="velocity",
    )


# What is judged elsewhere: the size of torques by the run, as the model knows it better than the
# prior does, and velocities with what comes of it (`speeds_of`).
_ELSEWHERE = {"torque-unit", "velocity"}
# Torques that correlate so much with the model's are those of the same drives. Loads that nobody
# told take from that, so it is no more.
_ALONG, _WINDOWS = 0.85, 4


def judged_wiring(
    model: Model, opened: Log, log: RecordingLike, mapping: ColumnMapping
) -> tuple[Doubt, ...]:
    """What looks wrong of units, signs and order of columns.

    Args:
        opened: the log, surveyed.

    Raises:
        RecordingError: what surely is.
    """
    if np.all(_along(model, opened) > _ALONG):
        return ()
    found = checked_wiring(evidence(model.robot, log, mapping))
    verdicts = [verdict for verdict in found if verdict.key not in _ELSEWHERE]
    for verdict in verdicts:
        if verdict.grade is Grade.WRONG:
            raise RecordingError(
                verdict.finding,
                where=str(opened.path),
                cure=f"{verdict.cure}; `deltaid check` shows more",
            )
    return tuple(
        Doubt(verdict.seen, cause=verdict.cause, cure=verdict.cure, key=verdict.key)
        for verdict in verdicts
        if verdict.grade is Grade.DOUBTFUL
    )


def _along(model: Model, opened: Log) -> Float[np.ndarray, " drives"]:
    """Correlation of recorded torques with the model's, drive by drive; 0 where there is none."""
    dynamics, pairs = model.dynamics, list[np.ndarray]()
    try:
        for window in with_filter(opened).spread(dynamics.kinematics, _WINDOWS):
            wide = window.wide
            torque = dynamics.torque(wide.z, wide.qd, wide.qdd, model.p)
            pairs.append(np.stack([window.smoothed(x.T) for x in (wide.tau, torque)]))
    except RecordingError:  # whose cause is told by what follows
        return np.zeros(dynamics.dof)
    both = np.concatenate([np.zeros((2, dynamics.dof, 0)), *pairs], axis=2)
    both = both - both.mean(axis=2, keepdims=True) if both.size else both
    scale = np.sqrt(np.sum(both[0] ** 2, axis=1) * np.sum(both[1] ** 2, axis=1))
    return np.sum(both[0] * both[1], axis=1) / np.maximum(scale, np.finfo(float).tiny)
