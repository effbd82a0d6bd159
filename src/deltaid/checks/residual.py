"""Residual torques of the fit and their causes: a lag, an effect, a resonance.

The fit here has free parameters, without prior and consistency. A residual beyond chance is
assigned to the cause whose columns explain it best; the next cause gets the remainder. The final
remainder is reported without a cause.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc, chdtri
from threadpoolctl import threadpool_limits

from deltaid.checks.closed_loop import SEGMENTS
from deltaid.checks.evidence import Evidence
from deltaid.checks.lag import checked_lag
from deltaid.checks.wiring.residual import ABOVE, LEAST
from deltaid.effects.all import effect_of
from deltaid.effects.effect import Cause, DescribedEffect, Effect, causes_of
from deltaid.effects.point import UnknownEffect
from deltaid.effects.unexplained import FreeTorque, in_words
from deltaid.estimation.spectra import bandwidth, density
from deltaid.identification.loads import load_change
from deltaid.identification.study import ADEQUATE, Study, longest, rest_of_each_drive, unexplained
from deltaid.identification.whole_loads import ExcessMass
from deltaid.levels import EXACT
from deltaid.model.verdict import Fault, Grade, Verdict, graded, listed, percent
from deltaid.recording.recording import PreparedRecording

# Share of a drive's torque from which a cause is wrong instead of doubtful.
_MUCH = 0.1
# Least power of a line over its neighbours; their distance and its largest width, as shares of its
# frequency.
_STANDS, _NEAR, _NARROW = 12.0, 0.25, 0.1
# Length of a spectrum's segment [s].
_SECONDS = 2.0
_DECLARE = (
    "declare it in the mapping (load: {spans: …}, or the gripper's column), which says exactly when"
)
# A residual comes in bursts if the share of its largest tenth is nearer to 1 than to that of normal
# noise, whose squares have one degree of freedom, and three when weighted by themselves.
_BURSTS = 0.5 * (1.0 + chdtrc(3.0, chdtri(1.0, 0.1)))
_NOT_CORRECTED = (
    "or something unknown that looks like it, for correcting it would not explain the torques"
)
_LOOK = "look at the residual over time in the report"
_RINGS = Fault(
    "resonance",
    "Hz",
    "struts, gears or frame ring there, or the drive's control loop does",
    "excite less near it and take a --cutoff below it; inspect for play and loose screws, or lower "
    "the gain of the control loop",
)
_REST = Fault(
    "residual",
    "%",
    "no known effect, and what is corrected may stand for a part of it",
    _LOOK,
)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def checked_residual(evidence: Evidence) -> Iterator[Verdict]:
    """Lags, and causes of the residual."""
    study, recording = evidence.study, evidence.surveyed
    if study is None or recording is None:
        return
    added = () if evidence.problem is None else evidence.problem.additions
    yield checked_lag(evidence, study, recording)
    ringing = _resonance(study)
    yield ringing
    causes = causes_of(study.fit, study.account)
    is_unexplained = any(isinstance(term, FreeTorque) for term in added)
    if is_unexplained:  # beside which the contest named its effects, and reported the rest
        causes = tuple(cause for cause in causes if not effect_of(cause).is_contested)
    # An identification corrects such causes where they explain the torques.
    is_weighed = evidence.problem is not None and evidence.settings.effects == "correct"
    is_weighed = is_weighed and not study.is_disturbed
    for cause in causes:
        verdict = _verdict(cause, recording)
        if verdict is not None and is_weighed and _is_corrected(effect_of(cause)):
            verdict = replace(verdict, cause=f"{verdict.cause}; {_NOT_CORRECTED}")
        if verdict is not None:
            yield verdict
    if not is_unexplained:
        yield _rest(study, rings=ringing.grade is not Grade.GOOD)


def _is_corrected(effect: Effect) -> bool:
    """Whether an identification corrects such an effect where that explains the torques."""
    return effect.is_contested or (isinstance(effect, UnknownEffect) and effect.is_candidate)


def detected_load(study: Study) -> Verdict:
    """Verdict on an undeclared load identified with the robot, from the study before that."""
    cause = load_change(study)
    assert cause is not None
    verdict = _verdict(cause, study.fit.trace.recording)
    assert verdict is not None
    seen = f"{verdict.seen}, and it is identified with the robot"
    return replace(verdict, grade=Grade.DOUBTFUL, seen=seen, cure=_DECLARE)


def load_held_throughout(excess: ExcessMass) -> Verdict:
    """Verdict on an undeclared load of a whole recording, by other recordings without it."""
    return Verdict(
        "load-change",
        Grade.DOUBTFUL,
        f"{excess.body} weighs {excess.mass:.2g} kg more than in the lightest recording",
        cause="a load is held in the whole recording",
        cure="declare it in the mapping (load: {always: true}); until then the lightest recording "
        "counts as empty, and what others hold in addition is identified as a load",
        number=excess.mass,
        unit="kg",
    )


def _verdict(cause: Cause, recording: PreparedRecording) -> Verdict | None:
    """The verdict on an effect; None where another check judges it."""
    effect = effect_of(cause)
    if not isinstance(effect, DescribedEffect):
        return None
    share = cause.shares
    subject, drives = effect.subject(cause), cause.fit.drives
    size = share[drives.index(subject) if subject in drives else int(np.argmax(share))]
    number, unit, seen = effect.finding(cause, subject, size)
    proposals, grade = effect.proposals(cause, recording), graded(size, -np.inf, _MUCH)
    why, cure = effect.why(cause), effect.cure(cause)
    return Verdict(effect.key, grade, seen, subject, why, cure, proposals, number, unit)


def _resonance(study: Study) -> Verdict:
    """The highest line of all drives; drives that show it are named."""
    trace, drives, residual = study.fit.trace, study.fit.drives, unexplained(study)
    rate, q = trace.low_pass.rate, trace.dynamics.kinematics.inverse(longest(study).z)
    length = int(min(_SECONDS * rate, 2 * len(residual) / (SEGMENTS + 1)))
    frequency, power = density(residual, rate, max(length, 16))
    lowest = ABOVE * bandwidth(q, rate)
    peaks, powers = np.array([_line(frequency, spectrum, lowest) for spectrum in power.T]).T
    shares = np.sqrt(powers) / np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)
    k = int(np.argmax(shares))
    if shares[k] < LEAST:
        return _RINGS.good("no line in what the model leaves of the torques")
    same = (shares >= LEAST) & (np.abs(peaks / peaks[k] - 1) < _NARROW)
    seen = f"a line at {peaks[k]:.3g} Hz with {percent(shares[k])} of {drives[k]}'s largest torque"
    subject = "" if same.all() else listed(np.array(drives)[same].tolist())
    return _RINGS.judged(seen, subject, float(peaks[k]))


def _line(
    frequency: Float[np.ndarray, " bins"], power: Float[np.ndarray, " bins"], lowest: float
) -> tuple[float, float]:
    """Frequency and power of the most prominent line; zeros without any line."""
    inner = np.flatnonzero((frequency > lowest) & (frequency < 0.9 * frequency[-1]))
    peaks = inner[power[inner] >= power[np.maximum(inner - 1, 0)]]
    for i in peaks[np.argsort(-power[peaks])]:
        near = np.abs(frequency / frequency[i] - 1) < _NEAR
        around = np.sort(power[near])  # np.median's checks take longer
        level = 0.5 * float(around[(len(around) - 1) // 2] + around[len(around) // 2])
        if power[i] < max(_STANDS * level, 1e-300):
            continue
        high, wide = np.flatnonzero(near & (power > 0.5 * power[i])), _NARROW * frequency[i]
        if frequency[high[-1]] - frequency[high[0]] > wide + 2 * frequency[1]:
            continue
        band = np.abs(frequency - frequency[i]) <= 0.5 * wide + 2 * frequency[1]
        total = float(np.sum(np.maximum(power[band] - level, 0.0)) * frequency[1])
        return float(frequency[i]), total
    return 0.0, 0.0


def _rest(study: Study, *, rings: bool) -> Verdict:
    """Verdict on the unexplained residual of the drive with most of it; a resonance (`rings`)
    explains it, and a residual below any measurement shows computed torques."""
    if (computed := _computed(study)) is not None:
        return computed
    every = sorted(rest_of_each_drive(study), key=lambda rest: rest.systematic, reverse=True)
    rest = next((rest for rest in every if rest.is_unexplained), None)
    if rings or rest is None:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        return Verdict("residual", Grade.GOOD, seen, number=every[0].times, unit="times the noise")
    drive = study.fit.drives[rest.drive]
    squares = np.sort(study.fit.rows.of_drives(study.account.left)[rest.drive] ** 2)
    if rest.follows:
        words = f"it varies with {rest.follows.words} ({percent(rest.follows.share)} of it)", "", ""
    elif squares[-max(len(squares) // 10, 1) :].sum() > _BURSTS * squares.sum():
        cause = "knocks: contact with something, backlash that closes, or stops"
        words = "in short bursts", cause, f"{_LOOK}, and exclude what was no free motion"
    else:
        cure = f"{_LOOK}; check play and stiffness of the gears"
        words = "it varies with neither speed, place, time nor load", "", cure
    varies, cause, cure = words
    seen = in_words(rest.part, drive, varies)
    grade = Grade.DOUBTFUL if rest.part > ADEQUATE else Grade.CANNOT_TELL
    return _REST.judged(seen, drive, 100 * rest.part, grade=grade, cause=cause, cure=cure)


def _computed(study: Study) -> Verdict | None:
    """A verdict on torques that the model explains better than any measured ones; None without
    such torques."""
    model, drives = study.fit.model, np.array(study.fit.drives)
    left = study.fit.rows.of_drives(study.account.left)
    largest, moves = np.abs(model).max(axis=1), model.any(axis=1)
    shares = np.sqrt(np.mean(left**2, axis=1)) / np.where(moves, largest, 1.0)
    exact = moves & (shares < EXACT)
    if not exact.any():
        return None
    subject = "" if np.array_equal(exact, moves) else listed(drives[exact].tolist())
    share = float(shares[exact].max())
    return _REST.judged(
        f"the model explains {f'the torque of {subject}' if subject else 'all torques'} to "
        f"{percent(share)} of the largest; measured ones have noise of 0.3 to 3 %",
        subject,
        100 * share,
        cause="the column holds a computed torque, a feed-forward or a simulation without noise: "
        "what is identified is the model behind it, and not the robot",
        cure="record the torque that the drives measure",
    )
