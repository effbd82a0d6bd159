"""What no effect explains of the torques: how much it is, and what it varies with.

What a study leaves of a drive's torque is white noise and the rest; the rest is compared with
smooth functions of what it might follow, beside all parameters and effects. Nothing is concluded
about its cause.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebvander

from deltaid.effects.contest import SEEN
from deltaid.effects.effect import SHARE, causes_of
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.problem import level_along
from deltaid.estimation.scatter import surprise
from deltaid.estimation.span import independent, lengths
from deltaid.estimation.spectra import white_noise
from deltaid.identification.study import Study
from deltaid.recording.windows import Samples

# A residual is far above noise at so many times the noise and this share of the largest torque.
_FAR, _SEEN = 3.0, 0.01
_FLOOR = 1e-5  # least noise, as a share of the largest torque
# Degree of the smooth functions of one quantity.
_SMOOTH = 8

# Corrections that leave this share of a drive's torque are not those of what acts on it.
ADEQUATE = 0.01

Values = Float[np.ndarray, " samples"]


class Trend(NamedTuple):
    """What a smooth function of some quantity explains of a drive's residual.

    Attributes:
        share: of its power.
        surprise: that chance would explain as much [decades].
    """

    words: str
    share: float
    surprise: float


_NOTHING = Trend("", 0.0, 0.0)


class Rest(NamedTuple):
    """What neither parameters nor effects explain of a drive's torque.

    Attributes:
        times: its rms, in units of the noise.
        systematic: its rms beyond the noise, as a share of the largest torque.
        part: the same as a share of the rms torque without its mean.
        follows: what it varies with; none if that is chance or the first order of an effect.
        is_far: whether it is far above noise, whatever it follows.
    """

    drive: int
    times: float
    systematic: float
    part: float
    follows: Trend | None
    is_far: bool

    @property
    def is_unexplained(self) -> bool:
        """Whether it is more than noise and the first order of effects."""
        return self.is_far or self.follows is not None


def rests(study: Study) -> tuple[Rest, ...]:
    """Of each drive; columns of effects that were detected hold to first order."""
    low_pass, causes = study.fit.trace.low_pass, causes_of(study.fit, study.account)
    noise = white_noise(unexplained(study), low_pass.rate) * low_pass.noise_gain
    residual = study.fit.rows.of_drives(study.account.left)
    largest = np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)
    first_order = SHARE * np.sum([np.zeros(len(largest)), *(c.rms**2 for c in causes)], axis=0)
    rests = list[Rest]()
    for drive, power in enumerate(np.mean(residual**2, axis=1).tolist()):
        trend = max(_trends(study, drive), key=lambda trend: trend.share, default=_NOTHING)
        explained = trend.share * power
        least = max(first_order[drive], (POSITION_ERROR * largest[drive]) ** 2)
        follows = trend.surprise > SEEN and explained > least
        beyond = max(power - noise[drive] ** 2, explained if follows else 0.0)
        times = np.sqrt(power) / max(noise[drive], _FLOOR * largest[drive])
        is_far = times > _FAR and power > max(first_order[drive], (_SEEN * largest[drive]) ** 2)
        part = np.sqrt(beyond) / max(float(study.fit.model[drive].std()), 1e-300)
        size = np.sqrt(beyond) / largest[drive]
        found = trend if follows else None
        rests.append(Rest(drive, float(times), float(size), float(part), found, bool(is_far)))
    return tuple(rests)


def unexplained(study: Study) -> Float[np.ndarray, "samples dof"]:
    """Torques less those of the model over the longest stretch, unfiltered."""
    w, dynamics = longest(study), study.fit.trace.dynamics
    residual = w.tau - dynamics.torque(w.z, w.qd, w.qdd, study.fit.p)
    return np.where(w.weights > 0, residual, 0.0)


def longest(study: Study) -> Samples:
    """The longest stretch without a gap."""
    return max(study.fit.trace.stretches, key=lambda stretch: len(stretch.time))


def _trends(study: Study, drive: int) -> Iterator[Trend]:
    """What smooth functions of a drive's own motion and torque, and of time, explain of its
    residual."""
    fit, left, span = study.fit, study.account.left, study.account.span
    quantities = {
        f"the speed of {fit.drives[drive]}": fit.motion.qd[:, drive],
        f"the position of {fit.drives[drive]}": fit.q[:, drive],
        f"the acceleration of {fit.drives[drive]}": fit.motion.qdd[:, drive],
        f"the torque of {fit.drives[drive]}": fit.model[drive],
        "time": fit.motion.time,
    }
    rows = slice(drive * fit.rows.samples, (drive + 1) * fit.rows.samples)
    total, freedom = float(left[rows] @ left[rows]), len(left) - span.rank
    for words, values in quantities.items():
        low, high = values.min(), values.max()
        between = 2.0 * (values - low) / max(high - low, np.finfo(float).tiny) - 1.0
        A = np.zeros((len(left), _SMOOTH))
        A[rows] = chebvander(between, _SMOOTH)[:, 1:]
        A = span.without(A / lengths(A))
        U = A @ independent(A)
        gain = float(np.sum((U.T @ left) ** 2))
        if not U.shape[1] or not total:
            continue
        after = left - U @ (U.T @ left)
        level = level_along(U, after, fit.rows.groups, max(freedom - U.shape[1], 1))
        own = surprise(gain / level, U.shape[1]) - np.log10(len(quantities))
        yield Trend(words, gain / total, float(own))
