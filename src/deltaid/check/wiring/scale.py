"""How large torques are beside those of the prior: the only yardstick of a scale that all share."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float

from deltaid.check.wiring.candidate import Candidate
from deltaid.check.wiring.motion import Motion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.signs import row_at_home

# Below this share of the largest of a drive's torques a component is too small to be compared, as
# expected and as told: beside bodies that are far too heavy in the description friction looks
# small. Of a drive that nothing ties to others, and as expected at least, below the other one.
_SMALL, _SMALLEST = 0.1, 0.003
# What an explanation more has to be worth, in natural logarithms of ratios.
_MORE = 0.3
# Where friction asks for so little of the usual factor's logarithm, or the rest, that is no unit.
_AGREED = 0.5
# A speed at which only steps of friction are left, as a share of the usual one.
_CREEP = 1e-6
# Components: inertia, gravity, viscous and Coulomb friction.
INERTIA, VISCOUS = 0, 2


def ratios(
    dynamics: Dynamics, motion: Motion, best: Candidate
) -> Float[np.ndarray, "drives components"]:
    """Torques of inertia, gravity, viscous and Coulomb friction, estimated over expected.

    NaN for components that are small.
    """
    found = best.residual
    p = found.span.coefficients(found.torques(best.order, best.gains))
    prior = prior_parameters(dynamics.robot)[found.columns]
    usual = [np.sqrt(np.mean(best.map.rates(x) ** 2, axis=0)) for x in (motion.qd, motion.qdd)]
    out = np.full((dynamics.dof, 4), np.nan)
    for i, (speed, acceleration) in enumerate(zip(*usual, strict=True)):
        rows = _components(dynamics, i, found.columns, speed, acceleration)
        told, expected = rows @ p, rows @ prior
        share = _SMALLEST if best.loose[i] else _SMALL
        large = _large(expected, share) | (_large(told, _SMALL) & _large(expected, _SMALLEST))
        out[i, large] = told[large] / expected[large]
    return out


def _large(torques: Float[np.ndarray, " components"], share: float) -> Bool[np.ndarray, " _"]:
    """Which components make up so much of the largest."""
    return np.abs(torques) > share * np.abs(torques).max()


def _components(
    dynamics: Dynamics, i: int, columns: np.ndarray, speed: float, acceleration: float
) -> Float[np.ndarray, "4 columns"]:
    """Rows c with c p = torque of drive i at home."""
    zero, e = np.zeros(dynamics.dof), np.eye(dynamics.dof)[i]

    def row(qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return row_at_home(dynamics, i, qd, qdd)[columns]

    def friction(speed: float) -> np.ndarray:
        return 0.5 * (row(speed * e, zero) - row(-speed * e, zero))  # Coriolis forces are even

    still, creep = row(zero, zero), friction(_CREEP * speed)
    inertia = row(zero, e) - still
    return np.stack([acceleration * inertia, still, friction(speed) - creep, creep])


def overall(found: Float[np.ndarray, "..."]) -> float:
    """The usual ratio: a prior may be wrong, but hardly most of its components alike.

    Friction and the rest must both ask for it: what the less distant of them says is taken, and 1
    where they point to different sides.
    """
    parts = found[..., :VISCOUS], found[..., VISCOUS:]
    logs = [float(np.median(_logs(part))) for part in parts if np.any(part > 0)]
    usual = float(np.median(_logs(found)))
    if len(logs) < 2 or min(map(abs, logs)) > _AGREED * abs(usual):
        return float(np.exp(usual))
    least = min(logs, key=abs)
    return float(np.exp(least)) if np.sign(logs[0]) == np.sign(logs[1]) else 1.0


def unit_of(found: Float[np.ndarray, " components"], pace: float, units: Iterable[float]) -> float:
    """The unit of a position, a factor, that makes a drive's components agree best with the prior.

    1 where the torque's scale, or nothing, explains them as well. Angles that are too large by a
    factor make inertia and viscous friction too small by it, and leave Coulomb friction.

    Args:
        pace: the drive's largest speed over the largest one that is described; 0 where none is.
        units: those that it may be in.
    """

    def odd(logs: np.ndarray, pace: float) -> float:
        return float(np.abs(logs).sum()) + max(0.0, float(np.log(max(pace, 1e-9))))

    usual = _logs(found)
    found_odd = {1.0: min(odd(usual, pace), odd(usual - np.median(usual), pace) + _MORE)}
    for unit in units:
        found_odd[unit] = odd(_logs(in_unit(found, unit)), pace * unit) + _MORE
    return min(found_odd, key=lambda unit: found_odd[unit])


def in_unit(found: Float[np.ndarray, "*_ components"], unit: float) -> np.ndarray:
    """The ratios where a position is in another unit."""
    out = found.copy()
    out[..., [INERTIA, VISCOUS]] /= unit
    return out


def _logs(found: np.ndarray) -> np.ndarray:
    told = found[found > 0]  # of the wrong sign is noise, or said by signs
    return np.log(told) if told.size else np.zeros(1)
