"""Whether the signals of a recording are worth a fit: rate, clock, torque channels."""

from collections.abc import Iterator

import numpy as np

from deltaid.check.encoder import checked_encoder, moving
from deltaid.check.evidence import Evidence
from deltaid.check.spectra import bandwidth, step_of, white_noise
from deltaid.check.spectra import jitter as jitter_of
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import percent
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import Reason, kept
from deltaid.recording.recording import Recording

# Samples for one wave of the fastest part of a motion: fewer are doubtful, or wrong. Differentiated
# signals need more, because the filter keeps six hundredths of the rate.
_DIFFERENTIATED, _TAKEN = (16.0, 10.0), (5.0, 2.5)
# Jitter of the stamps that is said, as a share of the period.
_JITTER = 0.005
# Share of the rows on a torque's largest or smallest number, and at rest.
_CLIPPED, _RESTING = 0.002, 0.2
# Noise as a share of the largest torque: drives have 0.3 to 3 %. And the share of a channel's power
# above which it is noise only.
_NOISY, _NOTHING_ELSE = 0.06, 0.9
# Step of a torque as a share of its root mean square.
_COARSE, _BLIND = 0.1, 1.0

_AT_REST: tuple[Reason, ...] = ("standing still", "on brakes", "emergency stop")


def checked_signals(evidence: Evidence) -> Iterator[Verdict]:
    """All verdicts on the signals as they are recorded."""
    if len(evidence.rows.time) < 2 or evidence.rows.step <= 0:
        return
    rate, recording = _rate(evidence), evidence.surveyed
    yield rate
    if rate.grade is Grade.WRONG:  # motions that are sampled like this look like noise
        return
    yield from checked_encoder(evidence)
    if isinstance(recording, Recording):
        yield _clock(evidence, recording.log)
        yield from _saturation(evidence, recording.log)
        yield _standing(evidence, recording.log)
    if evidence.rows.tau.shape[1]:
        yield from _torque(evidence)


def _rate(evidence: Evidence) -> Verdict:
    """Samples for one wave of the motion's fastest part."""
    rows, columns = evidence.rows, evidence.columns
    rate, fastest = 1.0 / rows.step, bandwidth(rows.q, 1.0 / rows.step)
    if fastest == 0:
        seen = f"{rate:.4g} Hz, and no motion that it could be too slow for"
        return Verdict("rate", Grade.CANNOT_TELL, seen, number=rate, unit="Hz")
    samples = rate / fastest
    differentiated = not (columns.velocity and columns.acceleration)
    doubtful, wrong = _DIFFERENTIATED if differentiated else _TAKEN
    seen = (
        f"{samples:.3g} samples for one wave of the motion's fastest part: {rate:.4g} Hz for "
        f"{fastest:.3g} Hz"
    )
    if samples >= doubtful:
        return Verdict("rate", Grade.GOOD, seen, number=samples, unit="samples")
    return Verdict(
        "rate",
        Grade.WRONG if samples < wrong else Grade.DOUBTFUL,
        seen,
        cause="the recording is too slow to be differentiated: what is faster than a sixteenth of "
        "the rate is bent or cut away"
        if differentiated
        else "the recording is too slow for this motion",
        cure=f"record at {_round_up(20 * fastest):g} Hz or more, or move more slowly",
        number=samples,
        unit="samples",
    )


def _round_up(x: float) -> float:
    """To one significant digit."""
    scale = 10.0 ** np.floor(np.log10(x))
    return float(np.ceil(x / scale) * scale)


def _clock(evidence: Evidence, log: Log) -> Verdict:
    """What is missing, doubled or jittered."""
    clock = log.clock
    lost, restarts = int(clock.lost[clock.lost > 0].sum()), int(np.sum(clock.lost < 0))
    stale = sum(m.last - m.first + 1 for m in log.masks if m.reason == "stale rows")
    jitter = clock.jitter / clock.period
    told = []
    if lost:
        told.append(f"{lost} rows are missing in {int(np.sum(clock.lost > 0))} places")
    if restarts:
        told.append(f"time starts again {restarts} times")
    if len(clock.extra):
        told.append(f"{len(clock.extra)} rows are there twice or have no place of their own")
    if stale:
        told.append(f"{stale} rows repeat the one before them while the robot moves")
    if jitter > _JITTER:
        told.append(f"stamps jitter by {percent(jitter)} of the {1e3 * clock.period:.4g} ms")
    if not told and clock.steady:
        uneven = jitter_of(evidence.rows.q, clock.period) / clock.period
        if uneven > _JITTER:
            jitter = uneven
            told.append(
                f"positions scatter with speed as if rows were taken {percent(uneven)} of the "
                f"{1e3 * clock.period:.4g} ms from where their even stamps say"
            )
    if not told:
        seen = f"{clock.rows} rows, one every {1e3 * clock.period:.4g} ms"
        return Verdict("clock", Grade.GOOD, seen, number=100 * jitter, unit="%")
    if jitter > _JITTER and not (lost or restarts or len(clock.extra) or stale):
        cause = (
            "rows are sampled when the logger gets round to it, not by a clock"
            if clock.even is False or clock.steady
            else "stamps are made when rows are written, and not when they are sampled"
        )
    else:
        cause = "the logger or the network did not keep up"
    return Verdict(
        "clock",
        Grade.DOUBTFUL,
        "; ".join(told),
        cause=cause,
        cure="log with the controller's own cycle and its counter as time; meanwhile holes are cut "
        "out or bridged, and rows put on an even grid",
        number=100 * (lost + len(clock.extra) + stale) / clock.rows
        if lost or stale
        else 100 * jitter,
        unit="%",
    )


def _share_of(evidence: Evidence, log: Log, reasons: tuple[Reason, ...]) -> np.ndarray:
    """For each drive the share of the rows that are left out for some reasons."""
    masks = [mask for mask in log.masks if mask.reason in reasons]
    return 1.0 - kept(masks, evidence.kinematics.dof, log.samples)


def _saturation(evidence: Evidence, log: Log) -> Iterator[Verdict]:
    shares = _share_of(evidence, log, ("saturated torque",))
    drives = evidence.robot.drives
    bad = np.flatnonzero(shares > _CLIPPED).tolist()
    if not bad:
        seen = "no torque stays on its largest or smallest number"
        yield Verdict("saturation", Grade.GOOD, seen, number=100 * float(shares.max()), unit="%")
    for i in bad:
        yield Verdict(
            "saturation",
            Grade.DOUBTFUL,
            f"{percent(shares[i])} of {drives[i]}'s rows are on the largest or smallest number of "
            "the torque; these are left out",
            subject=drives[i],
            cause="the drive is at its limit of current, or the channel's range ends there",
            cure="raise the channel's range, or move more gently or with less load",
            number=100 * float(shares[i]),
            unit="%",
        )


def _standing(evidence: Evidence, log: Log) -> Verdict:
    share = float(_share_of(evidence, log, _AT_REST).min())
    seen = f"the robot rests for {percent(share)} of the time"
    if share <= _RESTING:
        return Verdict("standing", Grade.GOOD, seen, number=100 * share, unit="%")
    return Verdict(
        "standing",
        Grade.DOUBTFUL,
        f"{seen}; these rows are left out",
        cause="at rest friction balances whatever there is, so that torques say nothing",
        cure="record a motion without pauses, or more of it",
        number=100 * share,
        unit="%",
    )


def _torque(evidence: Evidence) -> Iterator[Verdict]:
    """Noise and steps of the torque channels."""
    tau, drives, robot = evidence.rows.tau, evidence.robot.drives, evidence.robot
    largest = np.maximum(np.abs(tau).max(axis=0), 1e-300)
    spread = np.maximum(tau.std(axis=0), 1e-300)
    steps = np.array([step_of(x) for x in tau.T])
    noise = white_noise(tau, 1.0 / evidence.rows.step)
    noise = np.sqrt(np.maximum(noise**2 - steps**2 / 12, 0.0))
    moves = moving(evidence)
    coarse = np.flatnonzero(moves & (steps > _COARSE * spread)).tolist()
    noisy = [i for i in np.flatnonzero(moves & (noise > _NOISY * largest)) if i not in coarse]
    worst = int(np.argmax(np.where(moves, noise / largest, 0.0)))
    if not noisy:
        number = 100 * float(noise[worst] / largest[worst])
        seen = f"at most {percent(noise[worst] / largest[worst])} of the largest torque"
        yield Verdict("torque-noise", Grade.GOOD, seen, number=number, unit="%")
    for i in noisy:
        nothing = noise[i] ** 2 > _NOTHING_ELSE * spread[i] ** 2
        share = noise[i] / largest[i]
        yield Verdict(
            "torque-noise",
            Grade.WRONG if nothing else Grade.DOUBTFUL,
            f"{drives[i]}'s torque is noise only"
            if nothing
            else f"{drives[i]}'s torque has noise of {percent(share)} of its largest; 0.3 to 3 % "
            "is usual",
            subject=drives[i],
            cause="the channel is not connected, or another signal"
            if nothing
            else "current ripple or an unshielded sensor, or a motion with little torque",
            cure="check which signal the column holds"
            if nothing
            else "record the controller's filtered torque and its lag, longer, or a faster motion",
            number=100 * float(share),
            unit="%",
        )
    worst = int(np.argmax(steps / spread))
    if not coarse:
        share = steps[worst] / spread[worst]
        seen = f"steps of {percent(share)} of the torque" if share else "torques show no steps"
        yield Verdict("torque-step", Grade.GOOD, seen, number=100 * float(share), unit="%")
    for i in coarse:
        share, unit = steps[i] / spread[i], robot.units(drives[i]).force
        yield Verdict(
            "torque-step",
            Grade.WRONG if share > _BLIND else Grade.DOUBTFUL,
            f"{drives[i]}'s torque comes in steps of {steps[i]:.3g} {unit}, {percent(share)} of "
            "its usual size",
            subject=drives[i],
            cause="the channel has too few digits, such as whole per cent of a rated torque",
            cure="record it with more digits (per mille, or the current in mA)",
            number=100 * float(share),
            unit="%",
        )
