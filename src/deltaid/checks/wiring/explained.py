"""A recording under the columns that explain it best, the input of all verdicts on wiring.

A scale common to all drives follows only from the ratio of torques to the prior's.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from deltaid.checks.evidence import WRONG_SCALE, Evidence
from deltaid.checks.wiring.candidate import (
    ALONG,
    ALONG_LOOSE,
    SENSIBLE,
    WiringHypothesis,
    named_units,
)
from deltaid.checks.wiring.residual import LEAST, OFFSET, UNIT, FilteredMotion, Map
from deltaid.dynamics.dynamics import Dynamics
from deltaid.identification.fit import row_at_home
from deltaid.model.verdict import listed, percent

# Cost of an additional explanation, in natural logarithms of ratios.
_MORE = 0.3
# A speed at which only Coulomb friction acts, as a share of the usual one.
_CREEP = np.finfo(float).eps ** 0.5
# Components: inertia, gravity, viscous and Coulomb friction.
INERTIA, VISCOUS = 0, 2


@dataclass(frozen=True, eq=False)
class RemappedRecording:
    """A recording under the columns that explain it best."""

    evidence: Evidence
    motion: FilteredMotion  # the evaluated stretch
    # equally good hypotheses, simplest first; none if no loops close
    good: tuple[WiringHypothesis, ...]

    @property
    def best(self) -> WiringHypothesis:
        return self.good[0]

    @property
    def rivals(self) -> tuple[WiringHypothesis, ...]:
        """The best hypothesis and equally good ones that are as simple."""
        return tuple(other for other in self.good if other.changes == self.best.changes)

    @property
    def names(self) -> tuple[str, ...]:
        return self.evidence.robot.drives

    @property
    def least_correlation(self) -> float:
        """Least correlation of a moving drive's torque with that of the prior."""
        return float(self.best.correlations[~self.best.residual.still].min(initial=1.0))

    @property
    def unrelated(self) -> bool:
        """Whether no drive's torque goes with its motion, whatever the robot's masses."""
        most = float(self.best.correlations[~self.best.residual.still].max(initial=-1.0))
        return (
            self.best.unexplained > SENSIBLE[1]
            and self.least_correlation < SENSIBLE[0]
            and most < ALONG
        )

    @cached_property
    def components(self) -> Float[np.ndarray, "2 drives components"]:
        """Torques of inertia, gravity, viscous and Coulomb friction: estimated, and of the prior.

        For the root mean squares of speeds and accelerations.
        """
        best, motion, residual = self.best, self.motion, self.best.residual
        p = np.stack([residual.span.coefficients(best.torques), residual.prior], axis=1)
        pace = [np.sqrt(np.mean(best.map.rates(x) ** 2, axis=0)) for x in (motion.qd, motion.qdd)]
        rows = [
            _components(self.evidence.dynamics, i, speed, acceleration)[:, residual.columns]
            for i, (speed, acceleration) in enumerate(zip(*pace, strict=True))
        ]
        return np.moveaxis(np.stack(rows) @ p, 2, 0)

    @cached_property
    def ratios(self) -> Float[np.ndarray, "drives components"]:
        """Estimated components over those of the prior; NaN for components below the usual offset,
        expected or estimated: next to bodies described far too heavy, friction looks small. For an
        untied drive, and for expected torques, small is what no model explains."""
        estimated, expected = self.components
        share = np.where(self.best.loose, LEAST, OFFSET)[:, None]
        large = _large(estimated, OFFSET) & _large(expected, LEAST)
        large |= _large(expected, share)
        return np.divide(estimated, expected, out=np.full_like(estimated, np.nan), where=large)

    @property
    def untied(self) -> list[int]:
        """Drives that no limb ties to others; a telescope's if its torque follows the prior's."""
        last, robot = len(self.names) - 1, self.evidence.robot
        turns = robot.telescope is not None and self.best.loose[last]
        return [last] if last == 0 or (turns and self.best.correlations[last] > ALONG_LOOSE) else []

    @cached_property
    def units(self) -> dict[int, float]:
        """Unit factors of untied drives, which only the prior determines."""
        factors = {
            i: _unit_of(self.ratios[i], self._beyond(i), named_units(self.evidence.robot, i))
            for i in self.untied
        }
        return {i: unit for i, unit in factors.items() if unit != 1}

    def _beyond(self, i: int) -> float:
        """Largest ratio of a drive's speed or range to the described one."""
        robot, motion = self.evidence.robot, self.motion
        limits, beyond = robot.limits_of(self.names[i]), 0.0
        if limits.top_speed:
            beyond = float(np.abs(motion.qd[:, i]).max()) / limits.top_speed
        if len(self.names) == 1 and self.linear(i):
            _, half = robot.within(0.0)
            beyond = max(beyond, float(np.ptp(motion.q[:, i]) / (2 * half[0])))
        return abs(self.best.map.scale[i]) * beyond

    @property
    def map(self) -> Map:
        scale = [factor * self.units.get(i, 1.0) for i, factor in enumerate(self.best.map.scale)]
        return replace(self.best.map, scale=tuple(scale))

    def linear(self, drive: int) -> bool:
        return self.evidence.robot.is_linear(self.names[drive])

    def whose(self, drives: list[int]) -> str:
        """Subject of a verdict: empty for all drives."""
        return "" if len(drives) == len(self.names) else ", ".join(self.names[i] for i in drives)

    def all_or(self, drives: list[int]) -> str:
        """Names of drives in a sentence."""
        every = len(drives) == len(self.names) > 1
        return "all drives" if every else listed([self.names[i] for i in drives])

    @property
    def fits(self) -> str:
        return f"leaves {percent(self.best.unexplained)} of the torques unexplained"

    def of_motors(self, factor: float) -> bool:
        """Whether torques are too small by the gear that positions are too large by."""
        size = overall(self.ratios)
        return size < 1 / UNIT and 1 / WRONG_SCALE < size / factor < WRONG_SCALE


def _large(
    torques: Float[np.ndarray, "drives components"], share: float | Float[np.ndarray, "drives 1"]
) -> Bool[np.ndarray, "drives components"]:
    """Components that are larger than a share of their drive's largest."""
    size = np.abs(torques)
    return size > share * size.max(axis=1, keepdims=True)


def _components(
    dynamics: Dynamics, i: int, speed: float, acceleration: float
) -> Float[np.ndarray, "4 parameters"]:
    """Rows c with c p the torque components of drive i at home."""
    zero, e = np.zeros(dynamics.dof), np.eye(dynamics.dof)[i]
    speeds = [sign * size * e for size in (speed, _CREEP * speed) for sign in (1.0, -1.0)]
    forth, back, creep, creep_back = (row_at_home(dynamics, i, qd, zero) for qd in speeds)
    friction, coulomb = 0.5 * (forth - back), 0.5 * (creep - creep_back)  # Coriolis is even
    still = row_at_home(dynamics, i, zero, zero)
    inertia = row_at_home(dynamics, i, zero, e) - still
    return np.stack([acceleration * inertia, still, friction - coulomb, coulomb])


def overall(ratios: Float[np.ndarray, "..."]) -> float:
    """The median ratio: a prior is rarely wrong by one factor in most of its components.

    Friction and the other components must agree to a half of its logarithm: the result is then the
    median, else the ratio nearer to 1, and 1 where they lie on different sides of it.
    """
    parts = ratios[..., :VISCOUS], ratios[..., VISCOUS:]
    logs = [float(np.median(_logs(part))) for part in parts if np.any(part > 0)]
    usual = float(np.median(_logs(ratios)))
    nearest = min(logs, key=abs, default=usual)
    if len(logs) < 2 or 2 * abs(nearest) > abs(usual):
        nearest = usual
    elif np.sign(logs[0]) != np.sign(logs[1]):
        nearest = 0.0
    return float(np.exp(nearest))


def _unit_of(ratio: Float[np.ndarray, " components"], pace: float, units: Iterable[float]) -> float:
    """The factor of a position unit that makes a drive's components agree best with the prior.

    1 where the torque's scale, or nothing, explains them as well. Angles too large by a factor make
    inertia and viscous friction too small by it; Coulomb friction does not change. `pace` is the
    drive's largest speed over the largest described one; 0 where none is described.
    """

    def odd(logs: np.ndarray, pace: float) -> float:
        return float(np.abs(logs).sum()) + max(0.0, float(np.log(max(pace, 1e-9))))

    usual = _logs(ratio)
    oddness = {unit: odd(_logs(in_unit(ratio, unit)), pace * unit) + _MORE for unit in units}
    as_is = min(odd(usual, pace), odd(usual - np.median(usual), pace) + _MORE)
    return min({1.0: as_is, **oddness}.items(), key=lambda item: item[1])[0]


def in_unit(ratios: Float[np.ndarray, "*_ components"], unit: float) -> np.ndarray:
    """Ratios with the position in another unit."""
    out = ratios.copy()
    out[..., [INERTIA, VISCOUS]] /= unit
    return out


def _logs(ratios: np.ndarray) -> np.ndarray:
    positive = ratios[ratios > 0]  # a wrong sign is noise, or reported by sign checks
    return np.log(positive) if positive.size else np.zeros(1)
