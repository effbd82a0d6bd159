"""Whether a recording's columns are what they are taken for, its velocities worth taking, and its
torques as late as is known.

A drive's velocity often comes filtered, and so late against its position, or with more noise than
differences of the positions have. Both make loads look lighter: what is late, and what is noise,
stands in the columns of the load and not in the torques.

Where the model's torques go along with those recorded, drive by drive, columns are what they are
taken for. Else signs, order and units are judged as an identification judges them, and what is
wrong is refused as there.
"""

from contextlib import suppress
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.errors import Doubt, RecordingError
from deltaid.estimation.spectra import white_noise
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import studied
from deltaid.model.model import Model
from deltaid.model.settings import Settings
from deltaid.model.verdict import Grade, listed
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import with_filter

# A lag [s] that does no harm, and noise [rad/s or m/s] that does none.
_HARMLESS, _QUIET = 1e-4, 3e-3
# Rows that are looked at, seconds that are averaged over, parts whose scatter says how sure a lag
# is, and so many deviations.
_ROWS, _MEAN, _PARTS, _CLEAR = 1 << 16, 0.02, 20, 4.0


def speeds_of(log: Log, model: Model) -> tuple[bool, tuple[float, ...], tuple[Doubt, ...]]:
    """Whether a recording's velocities are taken: there are any, and better than differences of
    positions; standard deviation of one cycle's speed, as it is taken, drive by drive; why recorded
    ones are not taken."""
    dof, known = model.dynamics.dof, model.identified.corrections if model.identified else ()
    made, velocity = log.position_noise[:dof] * log.rate * np.sqrt(2.0), log.columns.velocity
    if not velocity or any(correction.kind == "velocity" for correction in known):  # or late
        return False, tuple(made.tolist()), ()
    rows = _first(log)
    lag, noise = _lag(rows, log.rate, dof), white_noise(rows[:, 1 + dof : 1 + 2 * dof])
    if np.abs(lag).max() > _HARMLESS:
        i = int(np.argmax(np.abs(lag)))
        what = f"comes {_in_words(lag[i])} against its position"
        cause = "the drive filters its velocity"
    elif np.any(noise > np.maximum(made, _QUIET)):
        i = int(np.argmax(noise))
        what = (
            f"has noise of {noise[i]:.2g} a row, and differences of its position have {made[i]:.2g}"
        )
        cause = "the drive makes its velocity of few steps of the encoder"
    else:
        return True, tuple(noise.tolist()), ()
    doubt = Doubt(
        f"column {velocity[i].column} {what}: velocities are excluded, and positions differenced",
        cause=cause,
        cure="a controller that runs on such velocities has to difference positions too "
        "(OnlineSettings.speed)",
        key="velocity",
    )
    return False, tuple(made.tolist()), (doubt,)


def _first(log: Log) -> Float[np.ndarray, "rows channels"]:
    found, read = np.zeros((0, len(log.columns.all))), 0
    for rows in chain.from_iterable(log.segments(None)):
        found, read = max(found, rows[:_ROWS], key=len), read + len(rows)
        if read > _ROWS:
            break
    return found


def _lag(
    rows: Float[np.ndarray, "rows channels"], rate: float, dof: int
) -> Float[np.ndarray, " drives"]:
    """By how much recorded velocities are late, v(t) = q̇(t − δ) = q̇ − δ q̈ [s]; zero unless sure.

    Means over some hundredths of a second, of velocities and of what positions did meanwhile, have
    hardly any noise.
    """
    n, q, v = max(1, round(_MEAN * rate)), rows[:, 1 : 1 + dof], rows[:, 1 + dof : 1 + 2 * dof]
    if len(q) < 4 * n + _PARTS:
        return np.zeros(dof)
    area = np.vstack([np.zeros(dof), np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0)])
    means, true = (area[n:] - area[:-n]) / n, (q[n:] - q[:-n]) * rate / n
    change, late = (true[2 * n :] - true[: -2 * n]) * rate / (2 * n), (true - means)[n:-n]
    starts = np.linspace(0, len(late), _PARTS, endpoint=False).astype(int)
    power, moment = (np.add.reduceat(x, starts) for x in (change**2, change * late))
    total = np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    lag = moment.sum(axis=0) / total
    deviation = np.sqrt(np.sum((moment - lag * power) ** 2, axis=0)) / total
    return np.where(np.abs(lag) > _CLEAR * deviation, lag, 0.0)


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
    doubts = list[Doubt]()
    for verdict in checked_wiring(evidence(model.robot, log, mapping)):
        if verdict.key in _ELSEWHERE:
            continue
        if verdict.grade is Grade.WRONG:
            cure = f"{verdict.cure}; `deltaid check` shows more"
            raise RecordingError(verdict.finding, where=str(opened.path), cure=cure)
        if verdict.grade is Grade.DOUBTFUL:
            doubts.append(
                Doubt(verdict.seen, cause=verdict.cause, cure=verdict.cure, key=verdict.key)
            )
    return tuple(doubts)


def _along(model: Model, opened: Log) -> Float[np.ndarray, " drives"]:
    """Correlation of recorded torques with the model's, drive by drive; 0 where there is none."""
    dynamics, pairs = model.dynamics, [np.zeros((2, model.dynamics.dof, 0))]
    with suppress(RecordingError):  # whose cause is told by what follows
        for window in with_filter(opened).spread(dynamics.kinematics, _WINDOWS):
            wide = window.wide
            torque = dynamics.torque(wide.z, wide.qd, wide.qdd, model.p)
            pairs.append(np.stack([window.smoothed(x.T) for x in (wide.tau, torque)]))
    both = np.concatenate(pairs, axis=2)
    both = both - both.mean(axis=2, keepdims=True) if both.size else both
    scale = np.sqrt(np.prod(np.sum(both**2, axis=2), axis=0))
    return np.sum(np.prod(both, axis=0), axis=1) / np.maximum(scale, np.finfo(float).tiny)


# A lag that the model has not is told beyond this [s], and beyond so many half widths of its
# interval, or so many where other causes explain more.
_LAG, _CLEAR_LAG, _HIDDEN_LAG = 3e-4, 2.0, 4.0

Delay = Float[np.ndarray, " drives"]


def judged_lag(model: Model, log: Log, delay: Delay) -> tuple[Doubt, ...]:
    """Lags of the torques that are not those that are put right.

    A lag is searched as an identification does, parameters free, so that a model which is a little
    off makes no lag. None where the recording is too short, or hardly moves, so that none shows.

    Args:
        log: with the loads that are held, as the gripper told of them or as they were found.
        delay: by how much torques are taken to come late [s].
    """
    study = None
    with suppress(RecordingError):  # too short to be filtered
        setup = Setup(model.robot, (with_filter(log),), Settings())
        (recording,) = declared_loads(setup, lambda _: None).recordings
        study = studied(model.dynamics, recording, model.p)
    if study is None:
        return ()
    lag, drives = study.common if study.alike else study.each, model.robot.drives
    surely = lag.interval * (_HIDDEN_LAG if study.hidden else _CLEAR_LAG)
    clear = np.abs(lag.values - delay) > np.maximum(_LAG, surely)
    if not clear.any():
        return ()
    found, off = np.where(clear, lag.values, delay), np.flatnonzero(clear).tolist()
    each = [f"{drives[i]}'s torque is {_in_words(found[i], lag.interval[i])}" for i in off]
    said, given = listed(each), found
    if np.ptp(found) == 0 and np.ptp(delay) == 0:
        said, given, off = f"torques are {_in_words(found[0], lag.interval[0])}", found[:1], off[:1]
    put_right = listed([_in_words(delay[i]) for i in off]) if delay.any() else "no lag"
    return (
        Doubt(
            f"{said} against positions, and {put_right} is corrected: masses are wrong by a per "
            "cent or two for each ms between",
            cause="this recording was made another way than the model's, through another filter or "
            "bus",
            cure="record as the model's recordings were made, or give it by --lag="
            + ",".join(f"{1e3 * value:.2g}" for value in given),
            key="torque-lag",
        ),
    )


def _in_words(lag: float, half: float | None = None) -> str:
    """'2 ± 0.2 ms late'."""
    about = "" if half is None else f" ± {1e3 * half:.1g}"
    return f"{1e3 * abs(lag):.2g}{about} ms {'late' if lag >= 0 else 'early'}"
