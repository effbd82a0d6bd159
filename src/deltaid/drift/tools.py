"""Tools that were changed and nobody told: steps in what recordings say is held.

The mass that a recording shows beside what was told is a series like friction's. Where it steps,
the change has its day, and friction may step with it without being called drift.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.drift.evidence import Changes
from deltaid.drift.outliers import inflation
from deltaid.drift.series import FLAT
from deltaid.drift.shared import first_prior, together
from deltaid.drift.wander import Scatter, whitened_sums

# Years that a robot may run for one tool change that is none.
_YEARS = 40.0
# Steps are looked for one after the other, so many at most; on each side so many recordings.
_MOST, _LEAST = 8, 3
# A change of what is held by less than so many deviations of a day is none.
_SMALL = 3.0


@dataclass(frozen=True)
class ToolChange:
    """One change of what is held.

    Attributes:
        day: first recording with it.
        mass: by how much what is held became heavier [kg].
        std: of that.
    """

    day: float
    mass: float
    std: float


def tool_changes(
    days: Float[np.ndarray, " n"], mass: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
) -> tuple[ToolChange, ...]:
    """Steps of the mass that is held, in the order of time."""
    there = np.isfinite(mass) & np.isfinite(std) & (std > 0)
    days, mass, std = days[there], mass[there], std[there]
    found = list[float]()
    if len(days) < 4 * _LEAST:
        return ()
    daily = 1.4826 * float(np.median(np.abs(np.diff(mass)))) / np.sqrt(2.0)
    unit = max(daily, float(np.median(std)))
    for _ in range(_MOST):
        day = _step(days, mass / unit, std / unit, found)
        if day is None:
            break
        found.append(day)
    changes = list[ToolChange]()
    for day in sorted(found):
        before = (days < day) & (days >= max([x for x in found if x < day], default=-np.inf))
        after = (days >= day) & (days < min([x for x in found if x > day], default=np.inf))
        size = float(np.median(mass[after]) - np.median(mass[before]))
        spread = 1.25 * unit * float(np.sqrt(1.0 / before.sum() + 1.0 / after.sum()))
        if abs(size) > max(_SMALL * spread, 0.5 * unit):
            changes.append(ToolChange(day, size, spread))
    return tuple(changes)


def _step(
    days: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    std: Float[np.ndarray, " n"],
    known: list[float],
) -> float | None:
    """The day of a further step; None if there is none."""
    X = np.stack([np.ones(len(days)), *((days >= one).astype(float) for one in known)], axis=1)
    wide, z = X[None], (y - np.median(y))[None]
    variance = (0.5 + 0.5 * std[None] ** 2) * inflation(z, wide[..., 1:])
    base = np.concatenate([wide, z[..., None]], axis=2)
    changes, scatter = Changes.steps(days), Scatter.grid()
    sums = whitened_sums(days, variance, base, changes.columns, scatter)
    scale = np.full(1 + len(known), FLAT)
    found = together(sums, changes, first_prior(scale, scatter, 1), scale, 1)
    if found.R[0] < _YEARS:
        return None
    return float(changes.onsets[np.argmax(found.of_changes.sum(axis=(0, 1))[0])])
