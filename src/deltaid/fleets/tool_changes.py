"""Undeclared tool changes: steps in the mass that recordings determine.

The undeclared mass of each recording is a series like friction's. Where it steps, a tool was
changed, and friction may step with it without being reported as drift.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.fleets.drift_evidence import Changes
from deltaid.fleets.drift_series import FLAT, ROBUST, evidence_of

# Years that a robot may run for one tool change that is none.
_YEARS = 40.0
# Steps are searched one after the other, so many at most; in so many recordings at least.
_MOST, _FEWEST = 8, 12
# A change of what is held by less than so many deviations of a day is none.
_SMALL = 3.0


@dataclass(frozen=True)
class ToolChange:
    """First day with what is held changed; how much heavier that became, with deviation [kg]."""

    day: float
    mass: float
    std: float


def tool_changes(
    days: Float[np.ndarray, " n"], mass: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
) -> tuple[ToolChange, ...]:
    """Steps of the mass that is held, in the order of time."""
    known = np.isfinite(mass) & np.isfinite(std) & (std > 0)
    days, mass, std = days[known], mass[known], std[known]
    if len(days) < _FEWEST:
        return ()
    daily = ROBUST * float(np.median(np.abs(np.diff(mass)))) / np.sqrt(2.0)
    unit = max(daily, float(np.median(std)))
    steps = list[float]()
    while len(steps) < _MOST and (day := _step(days, mass / unit, std / unit, steps)) is not None:
        steps.append(day)
    changes, ends = list[ToolChange](), [-np.inf, *sorted(set(steps)), np.inf]
    for first, day, last in zip(ends, ends[1:], ends[2:], strict=False):
        before, after = (days >= first) & (days < day), (days >= day) & (days < last)
        size = float(np.median(mass[after]) - np.median(mass[before]))
        spread = 1.25 * unit * float(np.sqrt(1.0 / before.sum() + 1.0 / after.sum()))
        if abs(size) > max(_SMALL * spread, 0.5 * unit):
            changes.append(ToolChange(day, size, spread))
    return tuple(changes)


def _step(
    days: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    std: Float[np.ndarray, " n"],
    steps: list[float],
) -> float | None:
    """The day of a further step; None if there is none."""
    X = np.stack([np.ones(len(days)), *((days >= day).astype(float) for day in steps)], axis=1)
    z, variance, changes = (y - np.median(y))[None], 0.5 + 0.5 * std[None] ** 2, Changes.steps(days)
    scale = np.full(1 + len(steps), FLAT)
    evidence = evidence_of(days, z, variance, X[None], changes, scale, scale, 1)
    if evidence.R[0] < _YEARS:
        return None
    return float(changes.onsets[np.argmax(evidence.of_changes.sum(axis=(0, 1))[0])])
