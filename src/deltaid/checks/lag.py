"""Verdicts on the lag between torques and positions."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import Evidence
from deltaid.effects.lag_columns import APART, UnknownLag
from deltaid.identification.study import Study, spoilt
from deltaid.model.verdict import Fault, Grade, Verdict, graded, listed, percent, plus_minus
from deltaid.recording.recording import PreparedRecording

# Bias of an inertia from which a lag is wrong instead of doubtful, as a share.
_SPOILT = 0.05
# Least bias of an inertia by a lag that is reported, as a share.
_HARMS = 0.003
# Least ratio of a lag to its interval, where this is wider than `APART`: slow motions determine
# lags only at reversals, where encoder steps and friction near rest interfere.
CLEAR = 4.0
# Half width of a 95 % interval from which a lag counts as unknown [s].
_UNKNOWN = 1e-3
_LAG = Fault("torque-lag", "ms")


def checked_lag(evidence: Evidence, study: Study, recording: PreparedRecording) -> Verdict:
    """Verdict on the lag between torques and positions."""
    lag, half = _common_lag(study)
    harm, lags = spoilt(study), study.common if study.alike else study.each
    widest = lags.interval * np.where(lags.interval > APART, CLEAR, 1.0)
    is_clear, bias = bool(np.any(np.abs(lags.values) > widest)), float(np.abs(harm).max())
    cost = _cost(study, harm, _why_left(evidence, study, recording))
    if study.hidden:
        return _LAG.judged(
            f"torques look {plus_minus(abs(lag), half, 2)} ms {_late(lag)}, but a fault listed "
            f"below can mimic a lag; {cost}",
            "",
            lag,
            grade=Grade.CANNOT_TELL,
            cure="fix the fault first, and check again",
        )
    if study.late and is_clear and bias > _HARMS:
        common_or_each = _common if study.alike else _differing_lags
        return common_or_each(study, cost, graded(bias, -np.inf, _SPOILT))
    added = () if evidence.problem is None else evidence.problem.additions
    if any(isinstance(term, UnknownLag) and term.is_of(recording) for term in added):
        return _LAG.judged(
            f"the lag of torques behind positions is hardly known, {lag:.2g} ± {half:.2g} ms; none "
            "has been corrected, and intervals allow for it",
            "",
            half,
            grade=Grade.CANNOT_TELL,
            cause="noise that a controller feeds back, or gears that wind up, hide the steps of "
            "friction that determine a lag best",
            cure="give the lag if it is known (--lag), or record with lower gains",
        )
    if half > 1e3 * (APART if study.late else _UNKNOWN):
        return _LAG.judged(
            f"the lag of torques behind positions is known to ±{half:.2g} ms only",
            "",
            half,
            grade=Grade.CANNOT_TELL,
            cause="the motion is too slow, or the torque too noisy, to see it",
            cure="record a faster motion with more reversals",
        )
    small = f", too little to bias an inertia by {percent(_HARMS)}" if is_clear else ""
    return _LAG.good(_agreement(study) + small, lag)


def _common_lag(study: Study) -> tuple[float, float]:
    """Lag of all drives and half its interval [ms]."""
    return 1e3 * float(study.common.values[0]), 1e3 * float(study.common.interval[0])


def _cost(study: Study, harm: Float[np.ndarray, " dof"], why: str) -> str:
    """Bias of the inertia that a lag harms most, and why the lag is not corrected."""
    worst = int(np.argmax(np.abs(harm)))
    size = f"{percent(abs(harm[worst]))} too {'large' if harm[worst] > 0 else 'small'}"
    cost = f"uncorrected, it makes the inertia of {study.fit.drives[worst]} {size}"
    return f"{cost}; not corrected: {why}" if why else cost


def _common(study: Study, cost: str, grade: Grade) -> Verdict:
    lag, half = _common_lag(study)
    rows = 1e-3 * lag * study.fit.trace.low_pass.rate
    return _LAG.judged(
        f"torque {'lags' if lag > 0 else 'leads'} position by {plus_minus(abs(lag), half)} ms; "
        f"{cost}",
        "",
        lag,
        grade=grade,
        cause="torque and position are sampled at different instants: a torque filter, a bus "
        "cycle, or two clocks",
        cure="record both in the same cycle of the controller and without filter, or shift the "
        f"torque columns by {-rows:+.2g} rows ({-lag:+.3g} ms)",
    )


def _differing_lags(study: Study, cost: str, grade: Grade) -> Verdict:
    drives, (common, _) = study.fit.drives, _common_lag(study)
    values, halves = 1e3 * study.each.values, 1e3 * study.each.interval
    lags = [
        f"{plus_minus(abs(lag), half, 2)} ms {_late(lag)}"
        for lag, half in zip(values, halves, strict=True)
    ]
    differing = np.abs(values - common) > np.maximum(halves, 1e3 * APART)
    return _LAG.judged(
        "torques and positions do not agree in time, and drives differ: "
        f"{_by_drive(drives, lags)}; {cost}",
        "" if differing.all() else listed(np.array(drives)[differing].tolist()),
        float(values[np.argmax(np.abs(values))]),
        grade=grade,
        cause="drives with filters or bus cycles of their own; otherwise a sign of a wrong "
        "friction law or torque constant, which a lag imitates",
        cure="give all drives the same torque filter and record in one cycle; check the "
        "friction law and torque constant of those that differ",
    )


def _agreement(study: Study) -> str:
    """Text for torques and positions that agree in time, after a correction if there was one."""
    lag = f"{1e3 * study.common.values[0]:.2g} ± {1e3 * study.common.interval[0]:.2g} ms"
    applied = study.fit.trace.recording.repairs.lag
    if not any(applied):
        return f"torques and positions agree in time: {lag}"
    corrected = [f"{1e3 * abs(delay):.3g} ms {_late(delay)}" * bool(delay) for delay in applied]
    shift = corrected[0] if len(set(applied)) == 1 else _by_drive(study.fit.drives, corrected)
    return f"torques were {shift} relative to positions; corrected, {lag} remain"


def _by_drive(drives: Sequence[str], texts: Sequence[str]) -> str:
    return ", ".join(f"{drive} {text}" for drive, text in zip(drives, texts, strict=True) if text)


def _late(value: float) -> str:
    return "late" if value > 0 else "early"


def _why_left(evidence: Evidence, study: Study, recording: PreparedRecording) -> str:
    """Why an identification did not correct a detected lag; empty before an identification."""
    chosen = evidence.settings.lag
    reasons = {
        "": evidence.problem is None,
        "lags were not to be corrected (--lag none)": chosen == "none",
        "torques were read by the lag that was given (--lag)": not isinstance(chosen, str),
        "a load that comes and goes explains more of the torques, and may look like a lag": (
            study.is_disturbed
        ),
        "a fault listed below explains more of the torques, and may look like a lag": study.hidden,
        "it is in addition to the lag that was corrected, which steps of friction determine": any(
            recording.repairs.lag
        ),
        "the fit of all parameters does not confirm it; something undescribed may look like it": (
            True
        ),
    }
    return next(reason for reason, holds in reasons.items() if holds)
