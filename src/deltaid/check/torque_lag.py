"""The lag of torques behind positions as a verdict, with what it does to the inertia."""

from collections.abc import Iterator

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


def lag_verdicts(study: Study, *, unknown: bool = False) -> Iterator[Verdict]:
    """Whether torques and positions are of the same instant, as far as that can be told.

    Args:
        unknown: whether the fit had to leave a lag open.
    """
    common, each, drives = study.common, study.each, study.fit.drives
    lag, half = 1e3 * common.values[0], 1e3 * common.interval[0]
    if study.hidden:
        yield Verdict(
            "torque-lag",
            Grade.CANNOT_TELL,
            f"torques look {abs(lag):.2g} ± {half:.1g} ms {_late(lag)}, but another cause explains "
            "more of what that leaves",
            cause="a lag beside the causes below, or these alone, which imitate one",
            cure="mend the causes below first, and check again",
            number=lag,
            unit="ms",
        )
        return
    harm = spoilt(study)
    if not study.late or not _matters(study, harm):
        if unknown:
            yield Verdict(
                "torque-lag",
                Grade.CANNOT_TELL,
                f"the lag of torques behind positions is hardly known, {lag:.2g} ± {half:.2g} ms; "
                "none has been put right, and intervals allow for it",
                cause="noise that a controller feeds back, or gears that wind up, hide the "
                "steps of friction that tell a lag best",
                cure="give the lag if it is known (--lag), or record with lower gains",
                number=half,
                unit="ms",
            )
            return
        if half > 1e3 * (_WIDE if study.late else _UNKNOWN):
            yield Verdict(
                "torque-lag",
                Grade.CANNOT_TELL,
                f"the lag of torques behind positions is known to ±{half:.2g} ms only",
                cause="the motion is too slow, or the torque too noisy, to see it",
                cure="record a faster motion with more reversals",
                number=half,
                unit="ms",
            )
            return
        yield Verdict("torque-lag", Grade.GOOD, _agreement(study), number=lag, unit="ms")
        return
    grade = Grade.WRONG if np.abs(harm).max() > _SPOILT else Grade.DOUBTFUL
    worst = int(np.argmax(np.abs(harm)))
    words = f"; left alone, it makes the inertia of {drives[worst]} {_changed(harm[worst])}"
    rate = study.fit.trace.low_pass.rate
    if study.alike:
        rows = 1e-3 * lag * rate
        yield Verdict(
            "torque-lag",
            grade,
            f"torques come {abs(lag):.3g} ± {half:.1g} ms {_late(lag)} against positions{words}",
            cause="torque and position are not of the same instant: a filter in the torque's way, "
            "a bus cycle, or two clocks",
            cure="record both in the same cycle of the controller and without filter, or shift the "
            f"torque columns by {-rows:+.2g} rows ({-lag:+.3g} ms)",
            number=lag,
            unit="ms",
        )
        return
    values, halves = 1e3 * each.values, 1e3 * each.interval
    told = ", ".join(
        f"{drive} {abs(value):.2g} ± {half:.1g} ms {_late(value)}"
        for drive, value, half in zip(drives, values, halves, strict=True)
    )
    odd = [d for d, v, h in zip(drives, values, halves, strict=True) if abs(v - lag) > max(h, 0.3)]
    yield Verdict(
        "torque-lag",
        grade,
        f"torques and positions do not agree in time, and drives differ: {told}{words}",
        subject=listed(odd) if len(odd) < len(drives) else "",
        cause="drives with filters or bus cycles of their own; otherwise a sign of a wrong "
        "friction law or torque constant, which a lag imitates",
        cure="set the torque filters of all drives alike and record in one cycle; check the "
        "friction law and torque constant of those that differ",
        number=float(values[int(np.argmax(np.abs(values)))]),
        unit="ms",
    )


def _agreement(study: Study) -> str:
    """That torques and positions agree in time, perhaps after a lag has been put right."""
    left = f"{1e3 * study.common.values[0]:.2g} ± {1e3 * study.common.interval[0]:.2g} ms"
    applied = study.fit.trace.recording.repairs.delay
    if not any(applied):
        return f"torques and positions agree in time: {left}"
    if len(set(applied)) == 1:
        told = f"{1e3 * abs(applied[0]):.3g} ms {_late(applied[0])}"
    else:
        told = ", ".join(
            f"{drive} {1e3 * abs(one):.3g} ms {_late(one)}"
            for drive, one in zip(study.fit.drives, applied, strict=True)
            if one
        )
    return f"torques came {told} against positions, which has been corrected: {left} are left"


def _matters(study: Study, harm: Float[np.ndarray, " dof"]) -> bool:
    """Whether a lag is clear of its interval, and large or harmful."""
    lag = study.common if study.alike else study.each
    size = np.abs(lag.values)
    clear = size > lag.interval * np.where(lag.interval > _WIDE, _CLEAR, 1.0)
    largest = np.max(size, where=clear, initial=0.0)
    return bool(largest > _LARGE or (largest > 0 and np.abs(harm).max() > _HARMS))


def _late(value: float) -> str:
    return "late" if value > 0 else "early"


def _changed(share: float) -> str:
    return f"{percent(abs(share))} too {'large' if share > 0 else 'small'}"
