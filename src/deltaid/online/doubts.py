"""Doubts about the detected loads and contacts, one cause each."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median_low

import numpy as np

from deltaid.checks.signal import CLIPPED
from deltaid.errors import Doubt
from deltaid.identification.events import LONGEST_EVENT
from deltaid.levels import SURE
from deltaid.model.model import Model
from deltaid.model.verdict import listed, percent
from deltaid.online.columns import judged_lag
from deltaid.online.events import Touch, WeighedLoad
from deltaid.online.instant import EMPTY, HOLDS
from deltaid.online.replay import Replay
from deltaid.online.settings import SOON, OnlineSettings
from deltaid.online.suspicion import STEP, RunEvidence
from deltaid.recording.carried import Load
from deltaid.recording.log import Log

# Size of a slight contact in thresholds; number of them that is suspicious if it is half of all.
_SLIGHT, _STRANGE = 2.0, 5
# Share of time in contact from which the cause is not a push, but the model or the signal.
_ALWAYS = 0.2
# Relative deviation of one drive's torques from the model's, and of all drives' torques, from which
# torques have another scale.
_GAIN, _COMMON = 0.06, 0.03
# Share by which an undetected load may enlarge torques without a gripper's signal; ratio to the
# model's torques from which a wrong signal cannot be the cause.
_UNSIGNALLED, _FAR = 0.2, 2.0
# Time for which a moving drive's torque is constant [s], from which it is not measured.
_STUCK = 0.05
# Noise of a speed [rad/s or m/s] beyond which loads look lighter than they are.
_NOISY = 0.015
# Doubts about rows after which gripper and model cannot be judged.
_BLIND = {"stuck", "encoder", "standing"}
# Rate of rows below which masses and contacts are less certain [1/s].
_SLOW = 200.0
# Shares of stale rows, and of rows at rest, from which they are reported.
_STALE, _RESTING = 0.005, 0.9


def doubts(
    model: Model,
    replay: Replay,
    settings: OnlineSettings,
    run: RunEvidence,
    loads: Sequence[WeighedLoad],
    touches: Sequence[Touch],
) -> tuple[Doubt, ...]:
    """All doubts, those about the recording first."""
    of_rows, of_run = tuple(_of_rows(replay, settings, run)), list[Doubt]()
    # Useless rows, torques that are too small, and a wrong gripper's signal all look like
    # weightless loads, or like a wrong model.
    if not any(doubt.key in _BLIND for doubt in of_rows):
        scale = list(_of_scale(replay, run))
        if replay.has_gripper and (not scale or 1 < run.common[0] < _FAR):
            by_column = any(load.column for load in replay.log.columns.loads)
            of_run += gripper_doubts(run, loads, settings.grip_time, is_column=by_column)
        if not of_run:
            delay = np.array(replay.delay if settings.delay is None else settings.delay)
            delay = np.broadcast_to(delay, (len(replay.delay),))
            of_run += judged_lag(model, _carrying(replay, loads), delay)
            of_run += scale or _of_contacts(run, () if of_run else touches)
    return (*replay.doubts, *of_rows, *(of_run or _too_heavy(settings, loads)))


def _carrying(replay: Replay, loads: Sequence[WeighedLoad]) -> Log:
    log = replace(replay.log, masks=replay.masks)
    if not loads or replay.has_gripper:
        return log
    spans = tuple((load.start, load.end or log.clock.last + 1.0) for load in loads)
    return replace(log, columns=replace(log.columns, loads=(Load(spans=spans),)))


def _of_rows(replay: Replay, settings: OnlineSettings, run: RunEvidence) -> Iterator[Doubt]:
    drives = replay.log.columns.torque
    if replay.log.rate < _SLOW:
        yield Doubt(
            f"{replay.log.rate:.4g} rows a second are few: masses are off by some per cent more "
            "than their intervals say, and contacts are reported later and for longer",
            cause="the recording is thinned out",
            cure="record at the controller's rate, 1000 a second is good",
            key="rate",
        )
    for i in np.flatnonzero(run.stuck > _STUCK).tolist():
        yield Doubt(
            f"column {drives[i].column} stays the same for {run.stuck[i]:.3g} s from "
            f"{run.stuck_at[i]:.4g} s on, while its drive moves: contacts and masses from there "
            "on are none",
            cause="the logger or the bus lost this channel",
            cure="leave these rows out",
            key="stuck",
        )
    if (share := replay.share("stale rows")) > _STALE:
        yield Doubt(
            f"{percent(share)} of the rows repeat the one before them while the robot moves; these "
            "are skipped, as the motion goes on",
            cause="the logger did not keep up, or reads faster than values change",
            cure="record in the controller's own cycle",
            key="clock",
        )
    if (share := replay.share("saturated torque")) > CLIPPED:
        ended = [
            drive.column for drive, end in zip(drives, replay.ends, strict=True) if end < np.inf
        ]
        yield Doubt(
            f"{percent(share)} of the rows are within 3 ms of the largest or smallest number of "
            f"{listed(ended)}: while they are, a push on that drive is not detected, and it says "
            "nothing of a load",
            cause="the drive is at its limit of current, or the channel's range ends there",
            cure="raise the channel's range, or move more gently",
            key="saturation",
        )
    yield from _of_motion(replay, settings)


def _of_motion(replay: Replay, settings: OnlineSettings) -> Iterator[Doubt]:
    """Doubts about brakes, rest and coarse positions."""
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


def _of_contacts(run: RunEvidence, touches: Sequence[Touch]) -> Iterator[Doubt]:
    share = run.touched / max(run.touched + run.untouched, 1e-9)
    if share > _ALWAYS and run.touched > LONGEST_EVENT:
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


def _of_scale(replay: Replay, run: RunEvidence) -> Iterator[Doubt]:
    (common, deviation), drives = run.common, replay.log.columns.torque
    most = 0.0 if replay.has_gripper else _UNSIGNALLED  # an undetected load makes torques larger
    apart = np.abs(run.gain - common) > np.maximum(_COMMON, SURE * run.deviation)
    gains, sure = np.append(run.gain, common), np.append(run.deviation, deviation)
    least = np.append([_GAIN] * len(drives), _COMMON)
    *each, alike = np.maximum(1.0 - gains, gains - 1.0 - most) > np.maximum(least, SURE * sure)
    bad = np.flatnonzero(each & (run.deviation < _GAIN)).tolist()
    which = listed([f"{drives[i].column} is {run.gain[i]:.3g} times" for i in bad])
    if alike and not apart.any():
        which = f"torques of all drives are {common:.3g} times"
    if not which:
        return
    yield Doubt(
        f"while nothing is held, {which} what the model says: loads and forces are wrong by as "
        "much",
        cause="another unit, gear or torque constant than when the model was recorded, or another "
        "robot",
        cure="declare it with --columns MAPPING.yaml, or identify the robot anew",
        key="drive-gain",
    )


def _too_heavy(settings: OnlineSettings, loads: Sequence[WeighedLoad]) -> Iterator[Doubt]:
    most = settings.largest_mass or np.inf
    if heavy := [load for load in loads if load.mass.low > most]:
        yield Doubt(
            f"{len(heavy)} of {len(loads)} loads weigh more than the {most:g} kg that may be held "
            "at most",
            cause="the largest mass is too small, or torques are in another unit",
            cure="say by --payload-max how much is held at most",
        )


def gripper_doubts(
    run: RunEvidence, loads: Sequence[WeighedLoad], grip_time: float, *, is_column: bool = True
) -> Iterator[Doubt]:
    """Doubts about the gripper's signal.

    Args:
        grip_time: known time from the signal to the load [s].
        is_column: whether the signal is a column, which should change.
    """
    if is_column and (run.signals <= {EMPTY} or run.signals <= {HOLDS}):
        what = "empty" if EMPTY in run.signals else "something held"
        yield Doubt(
            f"the gripper signals {what} from the first row to the last",
            cause="the column is not the gripper's, or was not recorded",
            cure="give the column that changes with each pick, or leave --gripper out: loads are "
            "then found from torques alone",
        )
        return
    nothing = sum(load.mass.low <= 0 for load in loads)
    weightless = bool(loads) and median_low(load.mass.low for load in loads) <= 0
    if weightless and run.touched_empty > _ALWAYS * run.empty:
        yield Doubt(
            f"{nothing} of {len(loads)} loads weigh nothing, and torques are beyond the model for "
            f"{run.touched_empty:.3g} s while the gripper signals nothing held",
            cause="the signal is 0 while something is held, and 1 while not",
            cure="give the numbers that mean held in a mapping, load: {column: …, when: [0]}",
        )
    elif apart := tuple(_apart(run, grip_time)):
        yield from apart
    elif weightless:
        yield Doubt(
            f"{nothing} of {len(loads)} loads weigh nothing that torques show",
            cause="the gripper closed without a part, or its signal is another one",
            cure="check what the column holds",
        )


def _apart(run: RunEvidence, grip_time: float) -> Iterator[Doubt]:
    kinds = {"are taken": run.taken, "are left": run.released}
    shown = {word: offset for word, offset in kinds.items() if offset.low or offset.high}
    # Least offset of each kind from the known time.
    least = {w: np.clip(grip_time, o.low, o.high) - grip_time for w, o in shown.items()}
    off = {w: o for w, o in shown.items() if abs(least[w]) > 1.5 * STEP}
    if not off:
        return
    low, high = max(o.low for o in off.values()), min(o.high for o in off.values())
    alike = len(off) == 2 and high > low - 2.5 * STEP
    if alike:
        low, high = min(low, high), max(low, high)
        said = f"{_span_in_words(low, high, grip_time)} loads are taken, and left"
    else:
        said = " and ".join(
            f"{_span_in_words(o.low, o.high, grip_time)} loads {w}" for w, o in off.items()
        )
    signals, saying = (sum(getattr(o, n) for o in off.values()) for n in ("signals", "saying"))
    early = min(o.low + o.high for o in off.values()) > 2 * grip_time
    yield Doubt(
        f"the gripper signals {said} ({saying} of {signals} signals show it): masses of the first "
        "tenths of a second are wrong, later ones a little, and contacts about then may be the "
        "load",
        cause="the signal is the command to the gripper, or parts are gripped before being lifted"
        if early
        else "the signal comes through a sensor or a bus that is slow",
        cure=f"give the time from the signal to the load by --grip-time {0.5 * (low + high):.2g}"
        if alike and early
        else "record a signal that comes with the load, or leave --gripper out",
    )


def _span_in_words(low: float, high: float, grip_time: float) -> str:
    """'50 ms before', '40 to 60 ms after', 'at least 190 ms after' where the search ends."""
    first, last = sorted((abs(low - grip_time), abs(high - grip_time)))
    word = "before" if low + high > 2 * grip_time else "after"
    if max(abs(low), abs(high)) > SOON - 2.5 * STEP:
        return f"at least {1e3 * first:.0f} ms {word}"
    span = f"{1e3 * first:.0f} to " if last - first > 2.5 * STEP else ""
    value = last if span else 0.5 * (first + last)
    return f"{span}{1e3 * value:.0f} ms {word}"
