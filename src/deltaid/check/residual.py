"""What the fit leaves of the torques: a lag, or a pattern with the cause that makes it.

The torques of a recording are compared with what any parameters could make of its motion, without
prior and consistency. What is left and is more than chance is given to the cause whose columns
explain it best; the next cause gets what that one leaves.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.causes import Cause, causes_of, odd_gains
from deltaid.check.evidence import Evidence
from deltaid.check.resonance import resonances
from deltaid.check.spectra import bandwidth
from deltaid.check.torque_lag import lag_verdicts
from deltaid.check.unexplained import largest_torques, longest, unexplained, white_share
from deltaid.check.verdict import Grade, Proposal, Verdict
from deltaid.check.words import listed, percent
from deltaid.errors import RecordingError
from deltaid.identification.lag_columns import UnknownLag
from deltaid.identification.patterns import Pattern
from deltaid.identification.study import Study
from deltaid.recording.recording import Recording

# A cause is wrong, and not only doubtful, where it makes this share of a drive's torque.
_MUCH = 0.1
# The share that a single drive explains of what all do, where it is about this one.
_MOSTLY = 0.7
# What is left is far above noise when it is so many times the noise and this share of the largest
# torque; it comes in bursts when a tenth of the time has so much of it.
_FAR, _SEEN, _BURSTS = 3.0, 0.01, 0.7
# What may be missing of a recording that has been looked at as a whole, beside its ends [s].
_GONE = 1.0
# How far a span that lasts to the end of a recording goes beyond it [s].
_BEYOND = 0.01
_FLOOR = 1e-5  # least noise, as a share of the largest torque


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def checked_residual(evidence: Evidence) -> Iterator[Verdict]:
    """Lags, and the causes that what is left points at."""
    study, recording = evidence.study, evidence.surveyed
    if study is None or isinstance(recording, RecordingError):
        return
    added = () if evidence.made is None else evidence.made.additions
    yield from lag_verdicts(
        study, unknown=any(isinstance(one, UnknownLag) and one.is_of(recording) for one in added)
    )
    ringing = tuple(_of_resonance(study))
    yield from ringing
    rings = any(v.grade is not Grade.GOOD for v in ringing)
    yield from _of_patterns(study, recording, rings=rings)


def _of_resonance(study: Study) -> Iterator[Verdict]:
    trace = study.scene.trace
    rate, q = trace.low_pass.rate, trace.dynamics.kinematics.inverse(longest(study).z)
    return resonances(
        unexplained(study), rate, bandwidth(q, rate), largest_torques(study), study.scene.drives
    )


def _of_patterns(study: Study, recording: Recording, *, rings: bool) -> Iterator[Verdict]:
    """The causes that count; where there is none, whether more is left than noise.

    Args:
        recording: what was looked at.
        rings: whether a resonance explains what is left.
    """
    causes = causes_of(study)
    for cause in causes:
        if (words := _WORDS.get(cause.kind)) is not None:
            verdict = _verdict(study, cause, words)
            if cause.kind == "load-change":
                lines = _load_declared(study, cause, recording)
                verdict = replace(verdict, proposals=lines)
            yield verdict
    if causes:
        return
    left = study.scene.rows.of_drives(study.account.left)
    rms = np.sqrt(np.mean(left**2, axis=1))
    noise, largest = white_share(study), largest_torques(study)
    times = rms / np.maximum(noise, _FLOOR * largest)
    worst = int(np.argmax(np.where(rms > _SEEN * largest, times, 0.0)))
    number, drive = float(times[worst]), study.scene.drives[worst]
    if rings or number < _FAR or rms[worst] < _SEEN * largest[worst]:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        yield Verdict("residual", Grade.GOOD, seen, number=number, unit="times the noise")
        return
    short = np.sort(left[worst] ** 2)[-max(len(left[worst]) // 10, 1) :].sum()
    bursts = short > _BURSTS * np.sum(left[worst] ** 2)
    yield Verdict(
        "residual",
        Grade.DOUBTFUL,
        f"the fit leaves {number:.3g} times the noise of {drive}'s torque, "
        f"{percent(rms[worst] / largest[worst])} of its largest, "
        + ("in short bursts" if bursts else "and it follows neither speed, place, time nor load"),
        subject=drive,
        cause="knocks: contact with something, backlash that closes, or stops"
        if bursts
        else "something that the model has no words for, such as compliance, backlash or cables",
        cure="look at the residual over time in the report, and leave out what was no free motion"
        if bursts
        else "look at the residual over time in the report; check play and stiffness of the gears",
        number=number,
        unit="times the noise",
    )


def _verdict(study: Study, cause: Cause, words: "_Words") -> Verdict:
    scene = study.scene
    share = cause.rms / np.maximum(scene.model.std(axis=1), 1e-300)
    subject = _subject(study, cause)
    worst = int(np.argmax(share)) if subject not in scene.drives else scene.drives.index(subject)
    number, unit, seen = words.seen(study, cause, subject, share[worst])
    return Verdict(
        cause.kind,
        Grade.WRONG if share[worst] > _MUCH else Grade.DOUBTFUL,
        seen,
        subject=subject,
        cause=words.cause(cause),
        cure=words.cure(cause),
        number=number,
        unit=unit,
    )


def _subject(study: Study, cause: Cause) -> str:
    """The drive or joint that a cause is about, if it is one."""
    if cause.kind == "drive-gain":
        odd = list(odd_gains(study, cause))
        return listed(odd) if len(odd) < len(study.scene.drives) else ""
    named = cause.found[0].pattern.subject
    if named and all(one.pattern.subject in ("", named) for one in cause.found):
        return named
    alone = [
        one for one in study.account.first if one.pattern.kind == cause.kind and one.pattern.subject
    ]
    if alone and alone[0].gain > _MOSTLY * cause.found[0].gain:
        return alone[0].pattern.subject
    return ""


@dataclass(frozen=True)
class _Words:
    """What is said of a cause: number, unit and what was seen; why; what to do."""

    seen: Callable[[Study, Cause, str, float], tuple[float, str, str]]
    cause: Callable[[Cause], str]
    cure: Callable[[Cause], str]


# Number, unit, and what was seen.
_Seen = tuple[float, str, str]


def _of(subject: str) -> str:
    return f"{subject}'s torque" if subject else "the torques"


def _friction_seen(
    study: Study, cause: Cause, subject: str, share: float
) -> tuple[float, str, str]:
    words = cause.found[0].pattern.words
    seen = f"{percent(share)} of {_of(subject)} follows the speed and is not explained: {words}"
    return 100 * share, "%", seen


def _place_seen(study: Study, cause: Cause, subject: str, share: float) -> _Seen:
    ripple = _ripple(cause)
    words = ripple.words if ripple else "it bends with the place of the platform"
    seen = f"{percent(share)} of {_of(subject)} follows the position and is not explained: {words}"
    return 100 * share, "%", seen


def _ripple(cause: Cause) -> Pattern | None:
    """The ripple that a cause is; None where the place explains more."""
    ripples = [one for one in cause.found if one.pattern.detail]
    if sum(one.gain for one in ripples) > 0.5 * sum(one.gain for one in cause.found):
        return ripples[0].pattern
    return None


def _drift_seen(study: Study, cause: Cause, subject: str, share: float) -> _Seen:
    words = cause.found[0].pattern.words
    seen = f"{percent(share)} of {_of(subject)} changes with time, {words}, and is not explained"
    return 100 * share, "%", seen


def _load_seen(study: Study, cause: Cause, subject: str, share: float) -> _Seen:
    first = cause.found[0].pattern
    mass, times = abs(_mass(study, cause)), first.detail
    told = ", ".join(f"{t:.2f}" for t in times[:4]) + (
        f" s and {len(times) - 4} times more" if len(times) > 4 else " s"
    )
    return mass, "kg", f"the mass of {first.words} changes by {mass:.2g} kg, at {told}"


def _mass(study: Study, cause: Cause) -> float:
    """How much heavier the robot is in the second of a load's two states [kg]."""
    alone = study.scene.span.without(cause.found[0].pattern.columns)
    return float(np.linalg.lstsq(alone, study.scene.tau, rcond=1e-6)[0][0])


def _load_declared(study: Study, cause: Cause, recording: Recording) -> tuple[Proposal, ...]:
    """Lines of a mapping that declare a load; none where not all of the recording was looked at, or
    where a load is declared already."""
    pattern, time = cause.found[0].pattern, study.scene.motion.time
    log = recording.log
    start, end = log.clock.stamps(np.array([0, log.samples - 1])).tolist()
    if log.columns.loads or end - start > time[-1] - time[0] + 2 * (time[0] - start) + _GONE:
        return ()
    shown = pattern.columns.reshape(len(study.scene.drives), len(time), -1).any(axis=(0, 2))
    changes = np.array(pattern.detail)
    one = int(np.argmax(shown))
    held_first = (np.searchsorted(changes, time[one]) % 2 == 0) == (_mass(study, cause) > 0)
    ends = [*([start] if held_first else []), *changes.tolist()]
    ends += [end + _BEYOND] if len(ends) % 2 else []
    spans = [[round(a, 3), round(b, 3)] for a, b in zip(ends[::2], ends[1::2], strict=True)]
    body = () if pattern.words in ("EE", "P") else (("load.body", pattern.words),)
    return (Proposal("mapping", (("load.name", "load"), *body, ("load.spans", spans))),)


def _gain_seen(study: Study, cause: Cause, subject: str, share: float) -> _Seen:
    gains = odd_gains(study, cause)
    told = listed(
        [
            f"{drive}'s {'torque is ' if k == 0 else ''}{percent(abs(gain))} too "
            f"{'large' if gain > 0 else 'small'}"
            for k, (drive, gain) in enumerate(gains.items())
        ]
    )
    others = "the other drives'" if len(gains) == 1 else "the mean of the limbs' drives"
    return 100 * max(gains.values(), key=abs), "%", f"{told} against {others}"


_WORDS = {
    "friction-law": _Words(
        _friction_seen,
        lambda cause: (
            "the described friction law has no term for it, or the torque channel has an offset"
            if "direction" in cause.found[0].pattern.words
            else "the described friction law has no term for it, or gears have play"
        ),
        lambda cause: "deltaid identify adds the term; or describe it",
    ),
    "geometry-or-cogging": _Words(
        _place_seen,
        lambda cause: (
            "cogging of the motor, or teeth of the gear"
            if _ripple(cause)
            else "lengths, zeros or mounting are not as described, a spring or cable pulls, or "
            "gears have play"
        ),
        lambda cause: (
            "let the drive compensate it, or take a lower --cutoff"
            if _ripple(cause)
            else "measure arms, struts and radii, set the drives' zeros anew, and look for play"
        ),
    ),
    "drift": _Words(
        _drift_seen,
        lambda cause: (
            "friction that falls while gears and grease warm up, or a torque channel that drifts"
        ),
        lambda cause: "move the robot until it is warm before recording, and record shorter",
    ),
    "load-change": _Words(
        _load_seen,
        lambda cause: "a load is picked up or put down while recording goes on",
        lambda cause: (
            "declare it in the mapping (load: {spans: …}, or the gripper's column), and it is "
            "identified with the robot; else record without load"
        ),
    ),
    "drive-gain": _Words(
        _gain_seen,
        lambda cause: "a torque constant, rated torque or gear that is not what the mapping says",
        lambda cause: (
            "check torque constants and gears of these drives' torque columns; a recording shows "
            "ratios of gains only, and a second one with a known load tells each of them"
        ),
    ),
}
