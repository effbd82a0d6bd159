"""Positions of motors behind gears that are not declared: the factor that explains torques best."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deltaid.check.wiring.candidate import (
    CLOSED,
    SLIDING,
    TURNING,
    Candidate,
    closed_share,
    tried,
)
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map
from deltaid.dynamics.dynamics import Dynamics

# Torques that go with the prior's like this need no search for the gears of other drives.
_SURE = 0.9
# Factors that positions of a motor are looked for by, and how many.
_SMALLEST, _LARGEST, _GRID, _HALVINGS = 1 / 3000, 1 / 1.5, 16, 9
# The longest lead of a linear drive [m per rad]: half a metre per revolution.
_LONGEST = 0.5 / (2 * np.pi)


def groups(dynamics: Dynamics) -> Iterator[list[int]]:
    """Drives that may have a fault in common: all of a kind, or each alone.

    A drive that turns a telescope shows no unit by its loops, so it is not tried alone.
    """
    robot = dynamics.robot
    linear = [robot.is_linear(drive) for drive in robot.drives]
    for kind in sorted(set(linear)):
        same = [i for i, slides in enumerate(linear) if slides == kind]
        if len(same) > 1:
            yield same
    limbs = dynamics.dof if robot.telescope is None else 3
    yield from ([i] for i in range(limbs))


def only(dof: int, drives: list[int], factor: float) -> tuple[float, ...]:
    """A factor of some drives, and 1 of the others."""
    return tuple(factor if i in drives else 1.0 for i in range(dof))


def of_motors(dynamics: Dynamics, motion: Motion) -> Iterator[Candidate]:
    """Positions of motors, by the factor that explains the torques best."""
    for drives in groups(dynamics):
        best = _best_factor(dynamics, motion, drives)
        if best is not None:
            yield best
        if best is not None and best.clear and best.along.min() > _SURE:
            return


def _best_factor(dynamics: Dynamics, motion: Motion, drives: list[int]) -> Candidate | None:
    dof, plain = dynamics.dof, Map.identity(dynamics.dof)

    def at(factor: float) -> Map:
        return replace(plain, scale=only(dof, drives, factor))

    def closes(factor: float) -> bool:
        return closed_share(dynamics, motion, at(factor)) >= CLOSED

    linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
    low, high = _SMALLEST, _LONGEST if linear else _LARGEST
    if not closes(high):
        if not closes(low):
            return None
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        high = low
        low = max(_SMALLEST, high / 30)
    grid = np.geomspace(low, high, _GRID)
    found = [next(tried(dynamics, motion, [at(float(f))], as_is=True), None) for f in grid]
    left = np.array([np.inf if one is None else one.left for one in found])
    k = int(np.argmin(left))
    if not np.isfinite(left[k]):
        return None
    one = found[k]
    if one is None:
        return None
    best = _narrowed(dynamics, motion, one, float(grid[1] / grid[0]))
    lead = abs(best.map.scale[drives[0]])
    return None if linear and lead > _LONGEST else best


def refined(dynamics: Dynamics, motion: Motion, rough: Candidate) -> Iterator[Candidate]:
    """The same drives in a unit that has a name, and by the best factor near the rough one."""
    scale = rough.map.scale
    drives = [i for i, factor in enumerate(scale) if abs(factor) != 1]
    linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
    best = _narrowed(dynamics, motion, rough, 1.04)
    yield best
    factor = abs(best.map.scale[drives[0]])
    near = [unit for unit in (SLIDING if linear else TURNING) if 0.7 < unit / factor < 1.4]
    signs = np.sign(scale)
    for unit in near:
        named = tuple(float(s) * (unit if i in drives else 1.0) for i, s in enumerate(signs))
        yield from tried(dynamics, motion, [replace(rough.map, scale=named)])


def _narrowed(dynamics: Dynamics, motion: Motion, rough: Candidate, step: float) -> Candidate:
    """The factor of the scaled positions that leaves least, from a rough one, by parabolas."""
    best = rough
    for _ in range(3):
        beside = [_times(dynamics, motion, best, by) for by in (1 / step, step)]
        lower, higher = ((np.inf if one is None else one.left**2) for one in beside)
        if np.isfinite(lower + higher) and lower + higher > 2 * best.left**2:
            bend = lower + higher - 2 * best.left**2
            shift = float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))
            beside.append(_times(dynamics, motion, best, step**shift))
        best = min((best, *(one for one in beside if one is not None)), key=lambda one: one.left)
        step = float(np.sqrt(step))
    return best


def _times(dynamics: Dynamics, motion: Motion, one: Candidate, by: float) -> Candidate | None:
    """The same with the scaled positions times a factor more."""
    scale = tuple(f if abs(f) == 1 else float(f * by) for f in one.map.scale)
    return next(tried(dynamics, motion, [replace(one.map, scale=scale)], as_is=True), None)
