"""What no effect explains of the torques: how much it is, and what it varies with.

What a study leaves of a drive's torque is white noise and the rest; the rest is compared with
smooth functions of what it might follow, beside all parameters and effects. Nothing is concluded
about its cause.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebvander

from deltaid.effects.cause import SHARE, Cause
from deltaid.effects.contest import SEEN
from deltaid.estimation.chance import surprise
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.problem import level_along
from deltaid.estimation.span import independent, lengths
from deltaid.identification.study import Study
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import percent

# A residual is far above noise at so many times the noise and this share of the largest torque; it
# comes in bursts when a tenth of the time has so much of it.
_FAR, _SEEN, _BURSTS = 3.0, 0.01, 0.7
_FLOOR = 1e-5  # least noise, as a share of the largest torque
# Degree of the smooth functions of one quantity.
_SMOOTH = 8
_LOOK = "look at the residual over time in the report"

Values = Float[np.ndarray, " samples"]


class _Trend(NamedTuple):
    """What a smooth function of some quantity explains of a drive's residual.

    Attributes:
        share: of its power.
        surprise: that chance would explain as much [decades].
    """

    words: str
    share: float
    surprise: float


_NOTHING = _Trend("", 0.0, 0.0)


class _Rest(NamedTuple):
    """What neither parameters nor effects explain of a drive's torque.

    Attributes:
        times: its rms, in units of the noise.
        systematic: its rms beyond the noise, as a share of the largest torque.
        follows: what it varies with; none if that is chance or the first order of an effect.
        is_far: whether it is far above noise, whatever it follows.
    """

    drive: int
    times: float
    systematic: float
    follows: _Trend | None
    is_far: bool


def checked_rest(
    study: Study, causes: Sequence[Cause], noise: Float[np.ndarray, " dof"], *, rings: bool
) -> Verdict:
    """Verdict on what neither parameters nor effects explain, by the drive that has most of it.

    Args:
        causes: effects that were detected, whose columns hold to first order.
        noise: of the torques after the filter, where it is white.
        rings: whether a resonance explains it.
    """
    rests = _rests(study, causes, noise)
    unexplained = [rest for rest in rests if rest.follows or rest.is_far]
    if rings or not unexplained:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        times = max(rests, key=lambda rest: rest.systematic).times
        return Verdict("residual", Grade.GOOD, seen, number=times, unit="times the noise")
    rest = max(unexplained, key=lambda rest: rest.systematic)
    drive, model = study.fit.drives[rest.drive], study.fit.model[rest.drive]
    part = rest.systematic * np.abs(model).max() / max(float(model.std()), 1e-300)
    amount = f"unexplained: {percent(part)} of {drive}'s torque"
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
        "residual", Grade.DOUBTFUL, seen, drive, cause, cure, number=100 * part, unit="%"
    )


def _rests(study: Study, causes: Sequence[Cause], noise: Float[np.ndarray, " dof"]) -> list[_Rest]:
    """Of each drive."""
    residual = study.fit.rows.of_drives(study.account.left)
    largest = np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)
    first_order = SHARE * np.sum([np.zeros(len(largest)), *(c.rms**2 for c in causes)], axis=0)
    rests = []
    for drive, power in enumerate(np.mean(residual**2, axis=1).tolist()):
        trend = max(_trends(study, drive), key=lambda trend: trend.share, default=_NOTHING)
        explained = trend.share * power
        least = max(first_order[drive], (POSITION_ERROR * largest[drive]) ** 2)
        follows = trend.surprise > SEEN and explained > least
        beyond = max(power - noise[drive] ** 2, explained if follows else 0.0)
        times = np.sqrt(power) / max(noise[drive], _FLOOR * largest[drive])
        is_far = times > _FAR and power > max(first_order[drive], (_SEEN * largest[drive]) ** 2)
        size = float(np.sqrt(beyond) / largest[drive])
        rests.append(_Rest(drive, float(times), size, trend if follows else None, bool(is_far)))
    return rests


def _is_brief(residual: Values) -> bool:
    short = np.sort(residual**2)[-max(len(residual) // 10, 1) :].sum()
    return bool(short > _BURSTS * np.sum(residual**2))


def _trends(study: Study, drive: int) -> Iterator[_Trend]:
    """What smooth functions of each quantity explain of a drive's residual."""
    fit, left = study.fit, study.account.left
    rows = slice(drive * fit.rows.samples, (drive + 1) * fit.rows.samples)
    total = float(left[rows] @ left[rows])
    tries = float(np.log10(len(_QUANTITIES)))
    freedom = len(left) - study.account.span.rank
    for words, quantity in _QUANTITIES.items():
        values = quantity(study, drive)
        A = np.zeros((len(left), _SMOOTH))
        A[rows] = chebvander(_between(values), _SMOOTH)[:, 1:]
        A = study.account.span.without(A / lengths(A))
        U = A @ independent(A)
        gain = float(np.sum((U.T @ left) ** 2))
        if not U.shape[1] or not total:
            continue
        after = left - U @ (U.T @ left)
        level = level_along(U, after, fit.rows.groups, max(freedom - U.shape[1], 1))
        own = surprise(gain / level, U.shape[1]) - tries
        yield _Trend(words.format(drive=fit.drives[drive]), gain / total, own)


def _between(values: Values) -> Values:
    """As numbers from −1 to 1."""
    low, high = values.min(), values.max()
    return 2.0 * (values - low) / max(high - low, np.finfo(float).tiny) - 1.0


# What a residual may follow: of a drive's own motion and torque, and time.
_QUANTITIES = {
    "the speed of {drive}": lambda study, drive: study.fit.motion.qd[:, drive],
    "the position of {drive}": lambda study, drive: study.fit.q[:, drive],
    "the acceleration of {drive}": lambda study, drive: study.fit.motion.qdd[:, drive],
    "the torque of {drive}": lambda study, drive: study.fit.model[drive],
    "time": lambda study, drive: study.fit.motion.time,
}
