"""The verdict on what no effect explains of the torques; nothing is concluded about its cause."""

import numpy as np

from deltaid.identification.rest import Values, rests
from deltaid.identification.study import Study
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import percent

# A residual comes in bursts when a tenth of the time has this share of it.
_BURSTS = 0.7
_LOOK = "look at the residual over time in the report"


def checked_rest(study: Study, *, rings: bool) -> Verdict:
    """Verdict on what neither parameters nor effects explain, by the drive that has most of it.

    Args:
        rings: whether a resonance explains it.
    """
    every = rests(study)
    unexplained = [rest for rest in every if rest.is_unexplained]
    if rings or not unexplained:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        times = max(every, key=lambda rest: rest.systematic).times
        return Verdict("residual", Grade.GOOD, seen, number=times, unit="times the noise")
    rest = max(unexplained, key=lambda rest: rest.systematic)
    drive = study.fit.drives[rest.drive]
    amount = f"unexplained: {percent(rest.part)} of {drive}'s torque"
    cause, cure = "no known effect, and what is corrected may stand for a part of it", _LOOK
    if rest.follows:
        seen = f"{amount}, it varies with {rest.follows.words}"
        seen += f" ({percent(rest.follows.share)} of it)"
    elif _is_brief(study.fit.rows.of_drives(study.account.left)[rest.drive]):
        seen = f"{amount}, in short bursts"
        cause = "knocks: contact with something, backlash that closes, or stops"
        cure = f"{_LOOK}, and exclude what was no free motion"
    else:
        seen = f"{amount}, it varies with neither speed, place, time nor load"
        cure = f"{_LOOK}; check play and stiffness of the gears"
    return Verdict(
        "residual", Grade.DOUBTFUL, seen, drive, cause, cure, number=100 * rest.part, unit="%"
    )


def _is_brief(residual: Values) -> bool:
    short = np.sort(residual**2)[-max(len(residual) // 10, 1) :].sum()
    return bool(short > _BURSTS * np.sum(residual**2))
