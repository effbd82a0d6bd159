"""What the fit leaves of the torques: a lag, or the effect that makes it.

The torques of a recording are compared with what any parameters could make of its motion, without
prior and consistency. What is left and is more than chance is given to the cause whose columns
explain it best; the next cause gets what that one leaves.
"""

from collections.abc import Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.resonance import largest_torques, resonance, white_share
from deltaid.check.torque_lag import lag_verdict
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
    unknown = any(isinstance(one, UnknownLag) and one.is_of(recording) for one in added)
    yield lag_verdict(study, unknown=unknown)
    ringing = resonance(study)
    yield ringing
    causes, effects = causes_of(study.fit, study.account), {one.kind: one for one in EFFECTS}
    for cause in causes:
        if effects[cause.kind].is_described:
            yield _verdict(effects[cause.kind], cause, recording)
    if not causes:
        yield _rest(study, rings=ringing.grade is not Grade.GOOD)


def _rest(study: Study, *, rings: bool) -> Verdict:
    """Whether more is left than noise where no cause counts, and no resonance explains it."""
    left = study.fit.rows.of_drives(study.account.left)
    rms = np.sqrt(np.mean(left**2, axis=1))
    noise, largest = white_share(study), largest_torques(study)
    times = rms / np.maximum(noise, _FLOOR * largest)
    worst = int(np.argmax(np.where(rms > _SEEN * largest, times, 0.0)))
    number, drive = float(times[worst]), study.fit.drives[worst]
    if rings or number < _FAR or rms[worst] < _SEEN * largest[worst]:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        return Verdict("residual", Grade.GOOD, seen, number=number, unit="times the noise")
    short = np.sort(left[worst] ** 2)[-max(len(left[worst]) // 10, 1) :].sum()
    words = "and it follows neither speed, place, time nor load"
    cause = "something that the model has no words for, such as compliance, backlash or cables"
    cure = "; check play and stiffness of the gears"
    if short > _BURSTS * np.sum(left[worst] ** 2):
        words, cure = "in short bursts", ", and leave out what was no free motion"
        cause = "knocks: contact with something, backlash that closes, or stops"
    return Verdict(
        "residual",
        Grade.DOUBTFUL,
        f"the fit leaves {number:.3g} times the noise of {drive}'s torque, "
        f"{percent(rms[worst] / largest[worst])} of its largest, {words}",
        drive,
        cause,
        f"look at the residual over time in the report{cure}",
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
