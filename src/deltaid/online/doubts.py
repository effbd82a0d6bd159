"""What speaks against the loads and contacts that were found, in words: one cause each.

A lag is searched as an identification does, parameters free, so that a model which is a little off
makes no lag; loads that are held are taken out, as the gripper told of them or as they were found.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import studied
from deltaid.model.model import Model
from deltaid.model.settings import Settings
from deltaid.model.verdict import listed, percent
from deltaid.online.events import Touch, WeighedLoad
from deltaid.online.gripper_doubts import gripper_doubts
from deltaid.online.replay import Replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.suspicion import RunEvidence
from deltaid.recording.carried import Load
from deltaid.recording.recording import with_filter

# Contacts below this many thresholds are slight, and so many of them, and half of all, are strange.
_SLIGHT, _STRANGE = 2.0, 5
# Share of the time in contact, and seconds of it, that are more than pushes.
_ALWAYS, _LONG = 0.2, 1.0
# One drive's torques that are so far from the model's, those of all drives that are, and by so many
# deviations, are of another scale.
_GAIN, _COMMON, _CLEAR = 0.06, 0.03, 3.0
# Drives are alike within so many deviations; where nobody tells what is held, torques may be larger
# by so much.
_APART, _UNTOLD = 2.5, 0.2
# What a load that the gripper does not tell of never makes of torques.
_FAR = 2.0
# Of a drive that does hardly more than rub, nothing is said: its gain is known worse than this.
_KNOWN = 0.06
# A torque that stays the same for so long [s] while its drive moves is none.
_STUCK = 0.05
# Noise of a speed [rad/s or m/s] beyond which loads look lighter than they are.
_NOISY = 0.015
# Verdicts on rows that leave nothing to be said of gripper and model.
_BLIND = {"stuck", "encoder", "standing"}
# Rows a second that are few.
_SLOW = 200.0
# Shares of rows that are told.
_STALE, _ENDS, _RESTING = 0.005, 0.001, 0.9


def doubts(
    model: Model,
    replay: Replay,
    settings: OnlineSettings,
    seen: RunEvidence,
    loads: Sequence[WeighedLoad],
    touches: Sequence[Touch],
) -> tuple[Doubt, ...]:
    """All of them, the recording's own first."""
    of_rows = tuple(_of_rows(replay, settings, seen))
    # Rows that tell nothing, torques that are too small, and a gripper that tells something else:
    # all look like loads that weigh nothing, or like a wrong model.
    blind = any(doubt.key in _BLIND for doubt in of_rows)
    scale = () if blind else tuple(_of_scale(replay, seen))
    told = ()
    if replay.is_told and not blind and not (scale and not 1 < seen.common[0] < _FAR):
        by_column = any(load.column for load in replay.log.columns.loads)
        told = gripper_doubts(seen, loads, settings.grip_time, is_column=by_column)
    late = () if blind or told else judged_lag(model, replay, _delay(settings, replay), loads)
    of_model = () if told else scale
    if not (blind or told or scale):
        of_model = tuple(_of_contacts(seen, () if late else touches))
    found = (*late, *told, *of_model) or tuple(_too_heavy(settings, loads))
    return (*replay.doubts, *of_rows, *found)


def _delay(settings: OnlineSettings, replay: Replay) -> Float[np.ndarray, " drives"]:
    given = replay.delay if settings.delay is None else settings.delay
    return np.broadcast_to(np.array(given, dtype=float), (len(replay.delay),))


def _of_rows(replay: Replay, settings: OnlineSettings, seen: RunEvidence) -> Iterator[Doubt]:
    drives = replay.log.columns.torque
    if replay.log.rate < _SLOW:
        yield Doubt(
            f"{replay.log.rate:.4g} rows a second are few: masses are off by some per cent more "
            "than their intervals say, and contacts are reported later and for longer",
            cause="the recording is thinned out",
            cure="record at the controller's rate, 1000 a second is good",
            key="rate",
        )
    for i in np.flatnonzero(seen.stuck > _STUCK).tolist():
        yield Doubt(
            f"column {drives[i].column} stays the same for {seen.stuck[i]:.3g} s from "
            f"{seen.stuck_at[i]:.4g} s on, while its drive moves: contacts and masses from there "
            "on are none",
            cause="the logger or the bus lost this channel",
            cure="leave these rows out",
            key="stuck",
        )
    if (share := replay.share("stale rows")) > _STALE:
        yield Doubt(
            f"{percent(share)} of the rows repeat the one before them while the robot moves; these "
            "are not used, and filters begin anew behind them",
            cause="the logger did not keep up, or reads faster than values change",
            cure="record in the controller's own cycle",
            key="clock",
        )
    if (share := replay.share("saturated torque")) > _ENDS:
        which = [
            drive.column for drive, end in zip(drives, replay.ends, strict=True) if end < np.inf
        ]
        yield Doubt(
            f"{percent(share)} of the rows are on the largest or smallest number of "
            f"{listed(which)}: while they are, a push on that drive is not detected, and it says "
            "nothing of a load",
            cause="the drive is at its limit of current, or the channel's range ends there",
            cure="raise the channel's range, or move more gently",
            key="saturation",
        )
    if (share := replay.share("on brakes", "emergency stop")) > 0:
        yield Doubt(
            f"brakes hold the robot in {percent(share)} of the rows: these are not used",
            cause="an emergency stop, or drives that were switched off",
            cure="what is pushed or held meanwhile cannot be determined",
        )
    if (share := replay.share("standing still")) > _RESTING:
        yield Doubt(
            f"the robot stands still for {percent(share)} of the time: friction hides loads and "
            "pushes as far as it can hold them",
            cause="it was not moved",
            cure="record it at work",
            key="standing",
        )
    noise = np.array(settings.speed_noise or (0.0,))
    if noise.max() > _NOISY:
        i = int(noise.argmax())
        yield Doubt(
            f"the speed of {replay.log.columns.position[i].column} has noise of {noise[i]:.2g} a "
            "row: loads look lighter than they are, and intervals do not say so",
            cause="the position comes in coarse steps, or is noisy",
            cure="record positions with more digits, or at a lower rate",
            key="encoder",
        )


def _of_contacts(seen: RunEvidence, touches: Sequence[Touch]) -> Iterator[Doubt]:
    share = seen.touched / max(seen.touched + seen.untouched, 1e-9)
    if share > _ALWAYS and seen.touched > _LONG:
        yield Doubt(
            f"torques are beyond what the model may lack for {percent(share)} of the time, which "
            "is no contact: the model and this recording do not belong together",
            cause="the recording is of another robot, tool or state than the model",
            cure="`deltaid validate` shows how far they are apart; identify the robot anew",
            key="residual",
        )
        return
    slight = sum(touch.size < _SLIGHT for touch in touches)
    if slight >= max(_STRANGE, 0.5 * len(touches)):
        yield Doubt(
            f"{slight} of {len(touches)} contacts are hardly beyond the threshold, which pushes "
            "are not as a rule",
            cause="torques lag, or the model is of another robot or state",
            cure="see what `deltaid validate` and `deltaid check` say of this recording",
        )


def _of_scale(replay: Replay, seen: RunEvidence) -> Iterator[Doubt]:
    """Torques that are a multiple of the model's."""
    names = [drive.column for drive in replay.log.columns.torque]
    common, deviation = seen.common
    most = _UNTOLD if not replay.is_told else 0.0  # what nobody noticed looks like larger torques
    apart = np.abs(seen.gain - common) > np.maximum(_COMMON, _APART * seen.deviation)
    off = _off(seen.gain, most) > np.maximum(_GAIN, _CLEAR * seen.deviation)
    off &= seen.deviation < _KNOWN
    if not apart.any() and _off(np.array(common), most) > max(_COMMON, _CLEAR * deviation):
        which = f"torques of all drives are {common:.3g} times"
    elif off.any():
        bad = np.flatnonzero(off).tolist()
        which = listed([f"{names[i]} is {seen.gain[i]:.3g} times" for i in bad])
    else:
        return
    yield Doubt(
        f"while nothing is held, {which} what the model says: loads and forces are wrong by as "
        "much",
        cause="another unit, gear or torque constant than when the model was recorded, or another "
        "robot",
        cure="declare it with --columns MAPPING.yaml, or identify the robot anew",
        key="drive-gain",
    )


def _off(gain: np.ndarray, most: float) -> np.ndarray:
    """How far from 1, and from 1 + most."""
    return np.asarray(np.maximum(1.0 - gain, gain - 1.0 - most))


def _too_heavy(settings: OnlineSettings, loads: Sequence[WeighedLoad]) -> Iterator[Doubt]:
    most = settings.largest_mass
    heavy = [load for load in loads if most is not None and load.mass.low > most]
    if heavy:
        yield Doubt(
            f"{len(heavy)} of {len(loads)} loads weigh more than the {most:g} kg that may be held "
            "at most",
            cause="the largest mass is too small, or torques are in another unit",
            cure="say by --payload-max how much is held at most",
        )


# A lag that the model has not is told beyond this [s], and beyond so many half widths of its
# interval, or so many where other causes explain more.
_LAG, _CLEAR_LAG, _HIDDEN_LAG = 3e-4, 2.0, 4.0

Delay = Float[np.ndarray, " drives"]


def judged_lag(
    model: Model, replay: Replay, delay: Delay, loads: Sequence[WeighedLoad]
) -> tuple[Doubt, ...]:
    """Lags of the torques that are not those that are put right.

    None where the recording is too short, or hardly moves, so that none shows.

    Args:
        delay: by how much torques are taken to come late [s].
        loads: that were found, for a recording in which nothing told of them.
    """
    log, study = replace(replay.log, masks=replay.masks), None
    if loads and not replay.is_told:
        spans = tuple((load.start, load.end or log.clock.last + 1.0) for load in loads)
        log = replace(log, columns=replace(log.columns, loads=(Load(spans=spans),)))
    with suppress(RecordingError):  # too short to be filtered
        setup = Setup(model.robot, (with_filter(log),), Settings())
        (recording,) = declared_loads(setup, lambda _: None).recordings
        study = studied(model.dynamics, recording, model.p)
    if study is None:
        return ()
    lag = study.common if study.alike else study.each
    surely = lag.interval * (_HIDDEN_LAG if study.hidden else _CLEAR_LAG)
    clear = np.abs(lag.values - delay) > np.maximum(_LAG, surely)
    if not clear.any():
        return ()
    return (
        _delay_doubt(np.where(clear, lag.values, delay), lag.interval, delay, model.robot.drives),
    )


def _delay_doubt(found: Delay, half: Delay, known: Delay, drives: Sequence[str]) -> Doubt:
    off: list[int] = np.flatnonzero(found != known).tolist()
    alike = np.ptp(found) == 0 and np.ptp(known) == 0
    if alike:
        said = f"torques are {_in_words(found[0], half[0])}"
    else:
        said = listed([f"{drives[i]}'s torque is {_in_words(found[i], half[i])}" for i in off])
    given = ",".join(f"{1e3 * lag:.2g}" for lag in (found[:1] if alike else found))
    words = [_in_words(known[i]) for i in (off[:1] if alike else off)]
    put_right = listed(words) if known.any() else "no lag"
    return Doubt(
        f"{said} against positions, and {put_right} is corrected: masses are wrong by a per cent "
        "or two for each ms between",
        cause="this recording was made another way than the model's, through another filter or bus",
        cure=f"record as the model's recordings were made, or give it by --lag={given}",
        key="torque-lag",
    )


def _in_words(lag: float, half: float | None = None) -> str:
    """'2 ± 0.2 ms late'."""
    about = "" if half is None else f" ± {1e3 * half:.1g}"
    return f"{1e3 * abs(lag):.2g}{about} ms {'late' if lag >= 0 else 'early'}"
