"""What the fit leaves of the torques: a lag, or the effect that makes it.

The torques of a recording are compared with what any parameters could make of its motion, without
prior and consistency. What is left and is more than chance is given to the cause whose columns
explain it best; the next cause gets what that one leaves.
"""

from collections.abc import Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.resonance import resonances
from deltaid.check.spectra import bandwidth
from deltaid.check.torque_lag import lag_verdicts
from deltaid.check.unexplained import largest_torques, longest, unexplained, white_share
from deltaid.effects.all import EFFECTS
from deltaid.effects.cause import Cause, causes_of
from deltaid.effects.effect import Effect
from deltaid.effects.lag_columns import UnknownLag
from deltaid.errors import RecordingError
from deltaid.identification.study import Study
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import percent
from deltaid.recording.recording import Recording

# A cause is wrong, and not only doubtful, where it makes this share of a drive's torque.
_MUCH = 0.1
# What is left is far above noise when it is so many times the noise and this share of the largest
# torque; it comes in bursts when a tenth of the time has so much of it.
_FAR, _SEEN, _BURSTS = 3.0, 0.01, 0.7
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
    yield from _of_effects(study, recording, rings=rings)


def _of_resonance(study: Study) -> Iterator[Verdict]:
    trace = study.fit.trace
    rate, q = trace.low_pass.rate, trace.dynamics.kinematics.inverse(longest(study).z)
    return resonances(
        unexplained(study), rate, bandwidth(q, rate), largest_torques(study), study.fit.drives
    )


def _of_effects(study: Study, recording: Recording, *, rings: bool) -> Iterator[Verdict]:
    """The causes that count; where there is none, whether more is left than noise.

    Args:
        recording: what was looked at.
        rings: whether a resonance explains what is left.
    """
    causes, effects = causes_of(study.fit, study.account), {one.kind: one for one in EFFECTS}
    for cause in causes:
        if effects[cause.kind].is_described:
            yield _verdict(effects[cause.kind], cause, recording)
    if causes:
        return
    left = study.fit.rows.of_drives(study.account.left)
    rms = np.sqrt(np.mean(left**2, axis=1))
    noise, largest = white_share(study), largest_torques(study)
    times = rms / np.maximum(noise, _FLOOR * largest)
    worst = int(np.argmax(np.where(rms > _SEEN * largest, times, 0.0)))
    number, drive = float(times[worst]), study.fit.drives[worst]
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


def _verdict(effect: Effect, cause: Cause, recording: Recording) -> Verdict:
    share = cause.rms / np.maximum(cause.fit.model.std(axis=1), 1e-300)
    subject, drives = effect.subject(cause), cause.fit.drives
    worst = int(np.argmax(share)) if subject not in drives else drives.index(subject)
    number, unit, seen = effect.seen(cause, subject, share[worst])
    return Verdict(
        effect.key,
        Grade.WRONG if share[worst] > _MUCH else Grade.DOUBTFUL,
        seen,
        subject=subject,
        cause=effect.why(cause),
        cure=effect.cure(cause),
        number=number,
        unit=unit,
        proposals=effect.proposals(cause, recording),
    )
