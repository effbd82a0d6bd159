"""Checks of a recording's signals: rate, clock, encoders, torque channels."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool

from deltaid.checks.evidence import Evidence
from deltaid.errors import counted
from deltaid.estimation.spectra import bandwidth, jitter, step_of, white_noise
from deltaid.model.verdict import Fault, Grade, Verdict, graded, listed, percent
from deltaid.recording.filter import LowPass, design_low_pass, samples_needed
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import FROZEN, RESTS, Reason, kept_shares
from deltaid.recording.opening import NO_RATE, OTHER_RATE
from deltaid.recording.source import INCOMPLETE
from deltaid.recording.time.clock import HIGHEST_RATE, JITTER
from deltaid.recording.time.doubts import restarted, rows_are, slowed, stood

# Samples per period of the motion's bandwidth below which a recording is doubtful, and wrong; more
# where positions are differentiated, whose filter passes six hundredths of the rate.
_DIFFERENTIATED, _TAKEN = (16.0, 10.0), (5.0, 2.5)
# Largest step of an encoder as a share of the accelerations, of a torque as a share of its rms.
_COARSE = 0.1
# Least number of encoder steps over a stroke, whatever the filter does.
_FEW = 250.0
# Share of rows from which saturated torques, and rest, are reported.
CLIPPED, _RESTING = 0.002, 0.2
# Noise as a share of the largest torque (drives have 0.3 to 3 %), and share of a channel's power
# above which it is noise only.
_NOISY, _NOTHING_ELSE = 0.06, 0.9

_AT_REST: tuple[Reason, ...] = ("standing still", "on brakes", "emergency stop")
_RATE = Fault("rate", "samples", "the recording is too slow for this motion")
_TOO_SLOW = (
    "the sampling rate is too low to differentiate: content above a sixteenth of the rate is "
    "distorted or removed"
)
_ENCODER = Fault(
    "encoder-step",
    "%",
    "the encoder, or the number format of the log, resolves too little for this motion",
    "record the motor's encoder with all its digits, move faster, or take a lower --cutoff",
)
_CLOCK = Fault(
    "clock",
    "%",
    "the logger or the network did not keep up",
    "log with the controller's own cycle and its counter as time; meanwhile holes are cut out or "
    "bridged, and rows put on an even grid",
)
_UNEVEN = (
    "positions scatter with speed as if rows were sampled {share} of the {period} off their even "
    "stamps"
)
_INCOMPLETE_ROWS = (
    "rows that lack a number in a used column are excluded (see warnings)",
    "record all columns in each row or message",
)
_PAUSE = (
    "logging stopped and went on later, or the clock was set meanwhile",
    "split it there if load or wiring changed; otherwise no action is needed",
)
_BY_LOGGER = "the logger samples when it has time, not by a clock", ""
_WHEN_WRITTEN = "stamps are made when rows are written, and not when they are sampled", ""
_SATURATION = Fault(
    "saturation",
    "%",
    "the drive is at its limit of current, or the channel's range ends there",
    "raise the channel's range, or move more gently or with less load",
)
_FROZEN = Fault(
    "frozen-torque",
    "%",
    "the logger or the bus lost this channel",
    "check its connection, or record again",
)
_STANDING = Fault(
    "standing",
    "%",
    "at rest friction balances any load, so torques carry no information",
    "record a motion without pauses, or more of it",
)
_NOISE = Fault(
    "torque-noise",
    "%",
    "current ripple or an unshielded sensor, or a motion with little torque",
    "record the controller's filtered torque and its lag, longer, or a faster motion",
)
_ONLY_NOISE = Fault(
    "torque-noise",
    "%",
    "the channel is not connected, or another signal",
    "check which signal the column holds",
)
_STEP = Fault(
    "torque-step",
    "%",
    "the channel has too few digits, such as whole per cent of a rated torque",
    "record it with more digits (per mille, or the current in mA)",
)


def checked_signals(evidence: Evidence) -> Iterator[Verdict]:
    """All verdicts on the recorded signals."""
    if len(evidence.rows.time) < 2 or evidence.rows.step < 1 / HIGHEST_RATE:  # a survey refuses it
        return
    if evidence.stands:
        most = evidence.moved.max()
        seen = f"the robot stands still: no position changes by more than {most:.2g} rad or m"
        yield _STANDING.judged(seen, "", 100.0)
        return
    rate, recording = _rate(evidence), evidence.surveyed
    yield rate
    if rate.grade is Grade.WRONG:  # a motion sampled too slowly looks like noise
        return
    if not evidence.columns.velocity:  # positions are differentiated
        yield from _encoder(evidence)
    if recording is not None:
        yield _clock(evidence, recording.log)
        yield from _saturation(evidence, recording.log)
        yield from _frozen(evidence, recording.log)
        yield _standing(recording.log)
    if evidence.rows.tau.shape[1] and _is_long(evidence):
        yield from _torque(evidence)


def _rate(evidence: Evidence) -> Verdict:
    columns, rate = evidence.columns, 1.0 / evidence.rows.step
    fastest = bandwidth(evidence.rows.q, rate)
    if fastest == 0:
        seen = f"{rate:.4g} Hz, and no motion that it could be too slow for"
        return Verdict("rate", Grade.CANNOT_TELL, seen, number=rate, unit="Hz")
    taken = columns.velocity and columns.acceleration
    (doubtful, wrong), cause = (_TAKEN, "") if taken else (_DIFFERENTIATED, _TOO_SLOW)
    samples, scale = rate / fastest, 10.0 ** np.floor(np.log10(20 * fastest))
    return _RATE.judged(
        f"{samples:.3g} samples for one wave of the motion's fastest part: {rate:.4g} Hz for "
        f"{fastest:.3g} Hz",
        number=samples,
        grade=graded(1 / samples, 1 / doubtful, 1 / wrong),
        cause=cause,
        cure=f"record at {float(np.ceil(20 * fastest / scale) * scale):g} Hz or more, or move more "
        "slowly",  # to one significant digit
    )


def _encoder(evidence: Evidence) -> Iterator[Verdict]:
    q, drives, low_pass = evidence.rows.q, np.array(evidence.robot.drives), _low_pass(evidence)
    if low_pass is None:
        return
    second = np.zeros((len(low_pass.second) - 1) * low_pass.stride + 1)
    second[:: low_pass.stride] = low_pass.second
    response = np.convolve(second, low_pass.response)
    if len(q) < 2 * len(response):
        return
    steps, moves = np.array([step_of(x) for x in q.T]), _moving(evidence)
    shares, rough = np.zeros(len(steps)), steps / np.sqrt(12) * np.linalg.norm(response)
    for i in np.flatnonzero(moves):
        windows = np.lib.stride_tricks.sliding_window_view(q[:, i] - q[:, i].mean(), len(response))
        size = np.std(windows[:: low_pass.thinned] @ response[::-1])
        shares[i] = rough[i] / np.sqrt(max(size**2 - rough[i] ** 2, (0.1 * size) ** 2, 1e-300))
    counts = np.ptp(q, axis=0) / np.maximum(steps, 1e-300)
    bad = moves & ((shares > _COARSE) | ((counts < _FEW) & (counts > 0)))
    k, seen = int(np.argmax(shares)), "positions show no steps"
    if steps[k] > 0:
        seen = (
            f"steps of {steps[k]:.2g} {evidence.robot.units(drives[k]).coordinate} make "
            f"{percent(shares[k])} of {drives[k]}'s acceleration below {low_pass.cutoff:.3g} Hz"
        )
    grade = graded(shares[k], -np.inf, 1.0) if bad.any() else Grade.GOOD
    subject, number = listed(drives[bad].tolist()), 100 * float(shares[k])
    yield _ENCODER.judged(seen, subject, number, grade=grade)


def _low_pass(evidence: Evidence) -> LowPass | None:
    """The filter of the recording, or one that suits its motion."""
    if evidence.surveyed is not None:
        return evidence.surveyed.low_pass
    rate = 1.0 / evidence.rows.step
    fastest = bandwidth(evidence.rows.q, rate)
    if fastest == 0:
        return None
    return design_low_pass(min(max(2 * fastest, 2e-6 * rate), 0.1 * rate), rate)


def _is_long(evidence: Evidence) -> bool:
    """Whether the rows suffice for a filter; torques of fewer may be noise and gravity alone."""
    if evidence.surveyed is not None:
        return True
    low_pass, rate = _low_pass(evidence), 1.0 / evidence.rows.step
    return low_pass is not None and len(evidence.rows.q) >= samples_needed(low_pass.cutoff, rate)


def _moving(evidence: Evidence) -> Bool[np.ndarray, " drives"]:
    """Whether each drive moves, compared with others of its kind."""
    slides, span = np.array(evidence.robot.linear_drives), evidence.moved
    largest = np.where(slides, span[slides].max(initial=0.0), span[~slides].max(initial=0.0))
    return span > RESTS * largest


def _clock(evidence: Evidence, log: Log) -> Verdict:
    clock, period = log.clock, f"{1e3 * log.clock.period:.4g} ms"
    leaps = clock.lost[clock.lost > clock.rows]  # no logger loses more than it keeps
    holes = clock.lost[(clock.lost > 0) & (clock.lost <= clock.rows)]
    lost = int(holes.sum())
    restarts, *of_restart = restarted(clock, log.table, log.columns.time.column)
    stands, *of_stand = stood(clock, log.table, log.columns.time.column)
    slower, *of_rate = slowed(clock, log.table)
    stale = sum(m.last - m.first + 1 for m in log.masks if m.reason == "stale rows")
    stale *= not stands
    twice, scatter = len(clock.extra), clock.jitter / clock.period
    faults = {
        f"time leaps ahead by up to {clock.period * leaps.max(initial=0):.4g} s in "
        f"{counted(leaps.size, 'place')}": bool(leaps.size),
        slower or f"{rows_are(lost)} missing in {counted(holes.size, 'place')}": lost,
        restarts: bool(restarts),
        stands or f"{rows_are(twice)} there twice or without a place": twice,
        f"{rows_are(stale)} copies of the one before while the robot moves": stale,
        f"stamps jitter by {percent(scatter)} of the {period}": scatter > JITTER,
    }
    seen = "; ".join(words for words, present in faults.items() if present)
    if log.other_rate:
        return _CLOCK.judged(log.other_rate, cause=OTHER_RATE, cure=NO_RATE)
    if not seen and clock.steady:
        uneven = jitter(evidence.rows.q, clock.period) / clock.period
        if uneven > JITTER:
            scatter, seen = uneven, _UNEVEN.format(share=percent(uneven), period=period)
    if not seen:
        return _CLOCK.good(f"{clock.rows} rows, one every {period}", 100 * scatter)
    wrong = lost + twice + stale
    causes = (
        (lost and any(doubt.key == INCOMPLETE for doubt in log.warnings), _INCOMPLETE_ROWS),
        (stands, of_stand),
        (slower, of_rate),
        (wrong, ("", "")),
        (restarts, of_restart),
        (leaps.size, _PAUSE),
        (scatter > JITTER, _BY_LOGGER if clock.even is False or clock.steady else _WHEN_WRITTEN),
    )
    cause, cure = next((words for present, words in causes if present), ("", ""))
    number = 100 * (wrong / clock.rows if wrong else scatter)
    return _CLOCK.judged(seen, "", number, cause=cause, cure=cure)


def _excluded(log: Log, reasons: tuple[Reason, ...]) -> list[float]:
    masks = [mask for mask in log.masks if mask.reason in reasons]
    return (1.0 - kept_shares(masks, len(log.columns.position), log.samples)).tolist()


def _saturation(evidence: Evidence, log: Log) -> Iterator[Verdict]:
    yield from _of_rows(
        evidence, log, _SATURATION, "saturated torque", CLIPPED,
        "no torque stays on its largest or smallest number",
        "are within 3 ms of the largest or smallest number of the torque",
    )  # fmt: skip


def _frozen(evidence: Evidence, log: Log) -> Iterator[Verdict]:
    yield from _of_rows(
        evidence, log, _FROZEN, FROZEN, 0.0,
        "no torque repeats a number while its drive moves",
        "repeat one number of the torque while the drive moves",
    )  # fmt: skip


def _of_rows(
    evidence: Evidence, log: Log, fault: Fault, reason: Reason, least: float, none: str, many: str
) -> Iterator[Verdict]:
    """Verdicts on the share of each drive's rows that are excluded for a reason."""
    shares = _excluded(log, (reason,))
    if max(shares) <= least:
        yield fault.good(none, 100 * max(shares))
    for drive, share in zip(evidence.robot.drives, shares, strict=True):
        if share > least:
            seen = f"{percent(share)} of {drive}'s rows {many}; these are excluded"
            yield fault.judged(seen, drive, 100 * share)


def _standing(log: Log) -> Verdict:
    share = min(_excluded(log, _AT_REST))
    excluded = "; these rows are excluded" if share > _RESTING else ""
    seen = f"the robot rests for {percent(share)} of the time{excluded}"
    return _STANDING.judged(seen, "", 100 * share, grade=graded(share, _RESTING))


def _torque(evidence: Evidence) -> Iterator[Verdict]:
    tau, drives, moves = evidence.rows.tau, evidence.robot.drives, _moving(evidence)
    largest, spread = np.maximum([np.abs(tau).max(axis=0), tau.std(axis=0)], 1e-300)
    steps = np.array([step_of(x) for x in tau.T])
    noise = np.sqrt(np.maximum(white_noise(tau) ** 2 - steps**2 / 12, 0.0))
    shares, parts = (noise / largest).tolist(), (steps / spread).tolist()
    coarse = moves & (steps > _COARSE * spread)
    noisy = np.flatnonzero(moves & (noise / largest > _NOISY) & ~coarse)
    if not noisy.size:
        share = shares[int(np.argmax(np.where(moves, shares, 0.0)))]
        yield _NOISE.good(f"at most {percent(share)} of the largest torque", 100 * share)
    for i in noisy:
        if noise[i] ** 2 <= _NOTHING_ELSE * spread[i] ** 2:
            seen = (
                f"{drives[i]}'s torque has noise of {percent(shares[i])} of its largest; 0.3 to "
                "3 % is usual"
            )
            yield _NOISE.judged(seen, drives[i], 100 * shares[i])
        else:
            seen = f"{drives[i]}'s torque is noise only"
            yield _ONLY_NOISE.judged(seen, drives[i], 100 * shares[i], grade=Grade.WRONG)
    if not coarse.any():
        share = max(parts)
        seen = f"steps of {percent(share)} of the torque" if share else "torques show no steps"
        yield _STEP.good(seen, 100 * share)
    for i in np.flatnonzero(coarse):
        seen = (
            f"{drives[i]}'s torque comes in steps of {steps[i]:.3g} "
            f"{evidence.robot.units(drives[i]).force}, {percent(parts[i])} of its usual size"
        )
        yield _STEP.judged(seen, drives[i], 100 * parts[i], grade=graded(parts[i], -np.inf, 1.0))
