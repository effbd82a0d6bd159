"""The lag of torques behind positions as a verdict, with what it does to the inertia."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deltaid.identification.study import Study, spoilt
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed, percent

# A lag is wrong, and not only doubtful, where it spoils an inertia by this share.
_SPOILT = 0.05
# A smaller lag [s] that spoils no inertia by this share is left unsaid.
_LARGE, _HARMS = 2e-4, 0.003
# Nothing is said of a lag whose interval is wider than the one [s], and of one that is wider than
# the other only where it is so many times as large: a slow motion shows a lag at its reversals
# alone, where encoders and friction near rest play in.
_UNKNOWN, _WIDE, _CLEAR = 1e-3, 3e-4, 4.0
# Lags of drives differ by more than this at least [ms].
_APART = 0.3


def lag_verdict(study: Study, *, unknown: bool = False) -> Verdict:
    """Whether torques and positions are of the same instant, as far as that can be told.

    Args:
        unknown: whether the fit had to leave a lag open.
    """
    key, unit, drives = "torque-lag", "ms", study.fit.drives
    lag, half = (float(1e3 * x[0]) for x in (study.common.values, study.common.interval))
    if study.hidden:
        seen = f"torques look {abs(lag):.2g} ± {half:.1g} ms {_late(lag)}, but another cause "
        seen += "explains more of what that leaves"
        cause = "a lag beside the causes below, or these alone, which imitate one"
        cure = "mend the causes below first, and check again"
        return Verdict(key, Grade.CANNOT_TELL, seen, "", cause, cure, number=lag, unit=unit)
    harm = spoilt(study, study.fit.p)
    if not study.late or not _matters(study, harm):
        if unknown:
            seen = f"the lag of torques behind positions is hardly known, {lag:.2g} ± {half:.2g} ms"
            seen += "; none has been put right, and intervals allow for it"
            cause = "noise that a controller feeds back, or gears that wind up, hide the steps of "
            cause += "friction that tell a lag best"
            cure = "give the lag if it is known (--lag), or record with lower gains"
        elif half > 1e3 * (_WIDE if study.late else _UNKNOWN):
            seen = f"the lag of torques behind positions is known to ±{half:.2g} ms only"
            cause = "the motion is too slow, or the torque too noisy, to see it"
            cure = "record a faster motion with more reversals"
        else:
            return Verdict(key, Grade.GOOD, _agreement(study), number=lag, unit=unit)
        return Verdict(key, Grade.CANNOT_TELL, seen, "", cause, cure, number=half, unit=unit)
    worst = int(np.argmax(np.abs(harm)))
    grade = Grade.WRONG if abs(harm[worst]) > _SPOILT else Grade.DOUBTFUL
    words = f"; left alone, it makes the inertia of {drives[worst]} {percent(abs(harm[worst]))} "
    words += "too large" if harm[worst] > 0 else "too small"
    if study.alike:
        rows = 1e-3 * lag * study.fit.trace.low_pass.rate
        seen = f"torques come {abs(lag):.3g} ± {half:.1g} ms {_late(lag)} against positions{words}"
        cause = "torque and position are not of the same instant: a filter in the torque's way, a "
        cause += "bus cycle, or two clocks"
        cure = "record both in the same cycle of the controller and without filter, or shift the "
        cure += f"torque columns by {-rows:+.2g} rows ({-lag:+.3g} ms)"
        return Verdict(key, grade, seen, "", cause, cure, number=lag, unit=unit)
    values, halves = 1e3 * study.each.values, 1e3 * study.each.interval
    told = [f"{abs(x):.2g} ± {by:.1g} ms {_late(x)}" for x, by in zip(values, halves, strict=True)]
    seen = f"torques and positions do not agree in time, and drives differ: {_of(drives, told)}"
    apart = np.abs(values - lag) > np.maximum(halves, _APART)
    odd = "" if apart.all() else listed([drives[i] for i in np.flatnonzero(apart)])
    cause = "drives with filters or bus cycles of their own; otherwise a sign of a wrong friction "
    cause += "law or torque constant, which a lag imitates"
    cure = "set the torque filters of all drives alike and record in one cycle; check the friction "
    cure += "law and torque constant of those that differ"
    number = float(values[int(np.argmax(np.abs(values)))])
    return Verdict(key, grade, seen + words, odd, cause, cure, number=number, unit=unit)


def _agreement(study: Study) -> str:
    """That torques and positions agree in time, perhaps after a lag has been put right."""
    left = f"{1e3 * study.common.values[0]:.2g} ± {1e3 * study.common.interval[0]:.2g} ms"
    applied = study.fit.trace.recording.repairs.delay
    if not any(applied):
        return f"torques and positions agree in time: {left}"
    told = [f"{1e3 * abs(delay):.3g} ms {_late(delay)}" * bool(delay) for delay in applied]
    said = told[0] if len(set(applied)) == 1 else _of(study.fit.drives, told)
    return f"torques came {said} against positions, which has been corrected: {left} are left"


def _of(drives: Sequence[str], told: Sequence[str]) -> str:
    """Each drive with what is told of it, if anything is."""
    return ", ".join(f"{drive} {x}" for drive, x in zip(drives, told, strict=True) if x)


def _matters(study: Study, harm: Float[np.ndarray, " dof"]) -> bool:
    """Whether a lag is clear of its interval, and large or harmful."""
    lag = study.common if study.alike else study.each
    size = np.abs(lag.values)
    clear = size > lag.interval * np.where(lag.interval > _WIDE, _CLEAR, 1.0)
    largest = np.max(size, where=clear, initial=0.0)
    return bool(largest > _LARGE or (largest > 0 and np.abs(harm).max() > _HARMS))


def _late(value: float) -> str:
    return "late" if value > 0 else "early"
