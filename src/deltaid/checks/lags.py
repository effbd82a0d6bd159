"""Verdicts on lags of torques: late, early, unknown, or different from drive to drive."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deltaid.effects.lag_columns import APART
from deltaid.identification.study import Study, spoilt
from deltaid.model.verdict import Fault, Grade, Verdict, listed, percent

# A lag is wrong, and not only doubtful, where it spoils an inertia by this share.
_SPOILT = 0.05
# A lag that biases no inertia by this share is not reported.
_HARMS = 0.003
# A lag is unknown with an interval beyond the first [s]; beyond the second it must be so many times
# as large: a slow motion determines a lag by its reversals alone, where encoder steps and friction
# near rest interfere.
_UNKNOWN, _WIDE, _CLEAR = 1e-3, 3e-4, 4.0
_LAG = Fault("torque-lag", "ms")


def checked_lag(study: Study, why: str, *, unknown: bool) -> Verdict:
    """Whether torques and positions are simultaneous.

    Args:
        why: an identification has not corrected a lag; empty before one.
        unknown: whether the fit had to leave it open.
    """
    lag, half = 1e3 * float(study.common.values[0]), 1e3 * float(study.common.interval[0])
    harm, shown = spoilt(study), study.common if study.alike else study.each
    sizes, halves = np.abs(shown.values), shown.interval
    clear = sizes > halves * np.where(halves > _WIDE, _CLEAR, 1.0)
    matters = bool(clear.any()) and np.abs(harm).max() > _HARMS
    if study.hidden:
        return _LAG.poor(
            f"torques look {abs(lag):.2g} ± {half:.1g} ms {_late(lag)}, but a fault listed below "
            f"can mimic a lag; {_cost(study, harm, why)}",
            "",
            lag,
            grade=Grade.CANNOT_TELL,
            cure="fix the fault first, and check again",
        )
    if study.late and matters:
        grade = Grade.WRONG if np.abs(harm).max() > _SPOILT else Grade.DOUBTFUL
        if not study.alike:
            return _differing_lags(study, _cost(study, harm, why), grade)
        rows = 1e-3 * lag * study.fit.trace.low_pass.rate
        return _LAG.poor(
            f"torques come {abs(lag):.3g} ± {half:.1g} ms {_late(lag)} against positions; "
            f"{_cost(study, harm, why)}",
            "",
            lag,
            grade=grade,
            cause="torque and position are not of the same instant: a filter in the torque's way, "
            "a bus cycle, or two clocks",
            cure="record both in the same cycle of the controller and without filter, or shift the "
            f"torque columns by {-rows:+.2g} rows ({-lag:+.3g} ms)",
        )
    if unknown:
        return _LAG.poor(
            f"the lag of torques behind positions is hardly known, {lag:.2g} ± {half:.2g} ms; none "
            "has been corrected, and intervals allow for it",
            "",
            half,
            grade=Grade.CANNOT_TELL,
            cause="noise that a controller feeds back, or gears that wind up, hide the steps of "
            "friction that determine a lag best",
            cure="give the lag if it is known (--lag), or record with lower gains",
        )
    if half > 1e3 * (_WIDE if study.late else _UNKNOWN):
        return _LAG.poor(
            f"the lag of torques behind positions is known to ±{half:.2g} ms only",
            "",
            half,
            grade=Grade.CANNOT_TELL,
            cause="the motion is too slow, or the torque too noisy, to see it",
            cure="record a faster motion with more reversals",
        )
    small = f", too little to bias an inertia by {percent(_HARMS)}" if clear.any() else ""
    return _LAG.good(_agreement(study) + small, lag)


def _cost(study: Study, harm: Float[np.ndarray, " dof"], why: str) -> str:
    """What a lag does to the inertia of the drive that it harms most, and why it is left."""
    worst = int(np.argmax(np.abs(harm)))
    size = f"{percent(abs(harm[worst]))} too {'large' if harm[worst] > 0 else 'small'}"
    cost = f"uncorrected, it makes the inertia of {study.fit.drives[worst]} {size}"
    return f"{cost}; not corrected: {why}" if why else cost


def _differing_lags(study: Study, cost: str, grade: Grade) -> Verdict:
    """The verdict on lags of which each drive has its own."""
    drives, common = study.fit.drives, 1e3 * float(study.common.values[0])
    values, halves = 1e3 * study.each.values, 1e3 * study.each.interval
    lags = [
        f"{abs(lag):.2g} ± {half:.1g} ms {_late(lag)}"
        for lag, half in zip(values, halves, strict=True)
    ]
    differing = np.abs(values - common) > np.maximum(halves, 1e3 * APART)
    return _LAG.poor(
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
    return f"torques came {shift} against positions, which has been corrected: {lag} remain"


def _by_drive(drives: Sequence[str], texts: Sequence[str]) -> str:
    return ", ".join(f"{drive} {text}" for drive, text in zip(drives, texts, strict=True) if text)


def _late(value: float) -> str:
    return "late" if value > 0 else "early"
