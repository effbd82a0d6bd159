"""Checks of a recording's columns for online estimation: wiring, velocities, and lag of torques.

A drive's velocity is often filtered, and so lags its position, or is noisier than differences of
positions. Both make loads look lighter: lag and noise are in the columns of the load, not in the
torques.

If the model's torques correlate with the recorded ones, drive by drive, the wiring is correct.
Otherwise signs, order and units are judged as for an identification, with the same refusals.
"""

from contextlib import suppress
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.lag import CLEAR
from deltaid.checks.wiring.candidate import ALONG
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.effects.lag_columns import APART
from deltaid.effects.lag_groups import SMALL
from deltaid.errors import Doubt, RecordingError
from deltaid.estimation.spectra import white_noise
from deltaid.identification.column_stages import CLEAR_LAG, late_rate
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import studied
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.model import Model
from deltaid.model.settings import Settings
from deltaid.model.verdict import Grade, listed, plus_minus
from deltaid.recording.log import FEW_WINDOWS, Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import with_filter
from deltaid.recording.source import BATCH_ROWS
from deltaid.recording.spectrum import spectrum_of

# Noise of a velocity that is harmless, even if differences of positions have less [rad/s or m/s].
_QUIET = 3e-3


def speeds_of(log: Log, model: Model) -> tuple[bool, tuple[float, ...], tuple[Doubt, ...]]:
    """Whether recorded velocities are used, which must exist and be better than differences of
    positions; standard deviation of one cycle's speed, drive by drive; why velocities are not
    used."""
    dof, known = model.dynamics.dof, model.identified.corrections if model.identified else ()
    made, velocity = _position_noise(log, dof) * log.rate * np.sqrt(2.0), log.columns.velocity
    if not velocity or any(correction.kind == "velocity" for correction in known):
        return False, tuple(made.tolist()), ()
    noise = white_noise(_first(log)[:, 1 + dof : 1 + 2 * dof])
    lag = _lag(log, model.dynamics.kinematics)
    if np.abs(lag).max() > SMALL:
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


def _position_noise(log: Log, dof: int) -> Float[np.ndarray, " drives"]:
    """Noise of positions in rows as replayed, in which stale rows are bridged."""
    if all(mask.reason != "stale rows" for mask in log.masks):
        return log.position_noise[:dof]
    return spectrum_of(_first(log)[:, 1 : 1 + dof]).noise


def _first(log: Log) -> Float[np.ndarray, "rows channels"]:
    """The longest block among the first rows."""
    longest, read = np.zeros((0, len(log.columns.all))), 0
    for rows in chain.from_iterable(log.segments(None)):
        longest, read = max(longest, rows[:BATCH_ROWS], key=len), read + len(rows)
        if read > BATCH_ROWS:
            break
    return longest


def _lag(log: Log, kinematics: Kinematics) -> Float[np.ndarray, " drives"]:
    """Lag of recorded velocities [s]; zero if not significant."""
    velocities, lag = replace(log, columns=replace(log.columns, acceleration=())), None
    with suppress(RecordingError):  # too short to be filtered
        lag = late_rate(with_filter(velocities), kinematics)
    if lag is None:
        return np.zeros(kinematics.dof)
    return np.where(np.abs(lag.values) > CLEAR_LAG * lag.interval, lag.values, 0.0)


# Verdicts that are given elsewhere: the run judges the size of torques, because its model is more
# certain than the prior, and `speeds_of` judges velocities.
_ELSEWHERE = {"torque-unit", "velocity"}


def judged_wiring(
    model: Model, opened: Log, log: RecordingLike, mapping: ColumnMapping
) -> tuple[Doubt, ...]:
    """Doubts about units, signs and order of columns.

    Args:
        opened: the surveyed log.

    Raises:
        RecordingError: they are surely wrong.
    """
    if np.all(_along(model, opened) > ALONG):
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
    """Correlation of recorded torques with the model's, drive by drive; 0 if undetermined."""
    dynamics, pairs = model.dynamics, [np.zeros((2, model.dynamics.dof, 0))]
    with suppress(RecordingError):  # later checks report the cause
        for window in with_filter(opened).spread(dynamics.kinematics, FEW_WINDOWS):
            wide = window.wide
            torque = dynamics.torque(wide.z, wide.qd, wide.qdd, model.p)
            pairs.append(np.stack([window.smoothed(x.T) for x in (wide.tau, torque)]))
    both = np.concatenate(pairs, axis=2)
    both = both - both.mean(axis=2, keepdims=True) if both.size else both
    scale = np.sqrt(np.prod(np.sum(both**2, axis=2), axis=0))
    return np.sum(np.prod(both, axis=0), axis=1) / np.maximum(scale, np.finfo(float).tiny)


Delay = Float[np.ndarray, " drives"]


def judged_lag(model: Model, log: Log, delay: Delay) -> tuple[Doubt, ...]:
    """Doubts about lags of the torques that differ from the corrected ones.

    Lags are fitted as in an identification, with free parameters, so model errors are not lags.
    Empty if the recording is too short or hardly moves.

    Args:
        log: with held loads, signalled or detected.
        delay: corrected lag [s].
    """
    study = None
    with suppress(RecordingError):  # too short to be filtered
        setup = Setup(model.robot, (with_filter(log),), Settings())
        (recording,) = declared_loads(setup, lambda _: None).recordings
        study = studied(model.dynamics, recording, model.p)
    if study is None:
        return ()
    lag, drives = study.common if study.alike else study.each, model.robot.drives
    surely = lag.interval * (CLEAR if study.hidden else CLEAR_LAG)
    clear = np.abs(lag.values - delay) > np.maximum(APART, surely)
    if not clear.any():
        return ()
    lags, off = np.where(clear, lag.values, delay), np.flatnonzero(clear).tolist()
    each = [f"{drives[i]}'s torque is {_in_words(lags[i], lag.interval[i])}" for i in off]
    text, given = listed(each), lags
    if np.ptp(lags) == 0 and np.ptp(delay) == 0:
        text, given, off = f"torques are {_in_words(lags[0], lag.interval[0])}", lags[:1], off[:1]
    corrected = listed([_in_words(delay[i]) for i in off]) if delay.any() else "no lag"
    return (
        Doubt(
            f"{text} against positions, and {corrected} is corrected: masses are wrong by a per "
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
    late = 1e3 * abs(lag)
    size = f"{late:.2g}" if half is None else plus_minus(late, 1e3 * half, 2)
    return f"{size} ms {'late' if lag >= 0 else 'early'}"
