"""Bodies that may hold a load, and times at which it is picked up or put down, as a path between
two levels (Viterbi)."""

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.point import RigidFit
from deltaid.estimation.problem import Columns, Rows
from deltaid.levels import ROUNDS
from deltaid.robot.inertia import INERTIA_NAMES

# Length of the windows over which the search averages [s], and their largest number.
_WINDOW, _WINDOWS = 0.1, 4000
# Shortest time for which a load is held [s]; a shorter one is a knock.
_HELD = 0.4
# Start values of the search: shares of the windows that are at the lower level.
_SPLITS = (0.02, 0.2, 0.5, 0.8, 0.98)

# For each sample or window 0 or 1, the lower or higher of two levels.
Held = Int[np.ndarray, " samples"]


def holders(fit: RigidFit) -> dict[str, Columns]:
    """Columns of the identifiable parameters, the mass first, of each body that may hold a load:
    the tool or, without a tool, the bodies that limbs carry."""
    robot, layout = fit.dynamics.robot, fit.dynamics.layout
    limbs = 0 if robot.limbs is None else robot.limbs.count
    arms = {name for i in range(limbs) for name in robot.limb_bodies(i)}
    free = ["EE"] if "EE" in layout.bodies else [body for body in layout.bodies if body not in arms]
    return {
        body: np.stack([fit.rows.stack(fit.column(f"{body}.{x}")) for x in shown_of(fit, body)], 1)
        for body in free
        if fit.shows(f"{body}.m")
    }


def shown_of(fit: RigidFit, body: str) -> list[str]:
    """Those of a body's ten parameters that torques determine."""
    return [name for name in INERTIA_NAMES if fit.shows(f"{body}.{name}")]


def refined(fit: RigidFit, columns: Columns, residual: Rows, held: Held) -> Held | None:
    """Times of a load, estimated by turns with its coefficients; None if held too short a time."""
    count = len(held)
    for _ in range(ROUNDS):
        is_held = np.tile(held, fit.dof)
        bare = fit.span.without(columns * is_held[:, None])
        theta = np.linalg.lstsq(bare, residual, rcond=1e-6)[0]
        remaining = residual - bare @ theta
        load = columns @ theta
        # Torques of the load, beside parameters that are fitted with it.
        torque = remaining + is_held * load
        gain = (load * (2 * torque - load)).reshape(fit.dof, -1).sum(axis=0)
        noise = float(remaining @ remaining) / len(remaining)
        course = _course(np.stack([np.zeros(count), -gain]), 4.0 * noise * np.log(count))
        if np.array_equal(course, held):
            break
        held = course
    return held if _is_long(held, float(np.median(np.diff(fit.motion.time)))) else None


def two_levels(fit: RigidFit, column: Rows, residual: Rows) -> Held | None:
    """Times at which a column's coefficient is at the higher of two levels; None without any.

    Levels are means, by turns with the most likely path between them (Viterbi); each change costs
    as much as chance gains by one.
    """
    time = fit.motion.time
    step = float(np.median(np.diff(time)))
    length = max(round(_WINDOW / step), 1, -(-len(time) // _WINDOWS))
    window = np.arange(len(time)) // length
    u = np.bincount(window, (column * residual).reshape(fit.dof, -1).sum(axis=0))
    d = np.bincount(window, (column**2).reshape(fit.dof, -1).sum(axis=0))
    order, count = np.argsort(u / np.maximum(d, 1e-300)), len(d)
    share = np.empty(count)
    share[order] = np.cumsum(d[order]) / max(float(d.sum()), 1e-300)
    cost = 4.0 * float(residual @ residual) / len(residual) * np.log(count)
    best, lowest = None, np.inf
    for split in _SPLITS:
        course, errors = (share > split).astype(int), np.zeros((2, count))
        for _ in range(ROUNDS):
            parts = course == 0, course == 1
            levels = [np.sum(u[part]) / max(np.sum(d[part]), 1e-300) for part in parts]
            errors = np.stack([d * level**2 - 2 * u * level for level in levels])
            before, course = course, _course(errors, cost)
            if np.array_equal(course, before):
                break
        changes = int(np.sum(np.diff(course) != 0))
        total = float(errors[course, np.arange(count)].sum()) + cost * changes
        if changes and total < lowest and _is_long(course, length * step):
            best, lowest = course[window], total
    return best


def _is_long(course: Held, step: float) -> bool:
    """Whether both levels last long enough in total; `step` is the time between samples [s]."""
    return bool(min(course.sum(), len(course) - course.sum()) * step >= _HELD)


def _course(errors: Float[np.ndarray, "2 samples"], cost: float) -> Held:
    """The path between two levels with the least sum of errors and costs of changes."""
    count = errors.shape[1]
    came = np.zeros((2, count), dtype=int)
    total = errors[:, 0].copy()
    for k in range(1, count):
        change = total[::-1] + cost
        came[:, k] = np.where(change < total, [1, 0], [0, 1])
        total = np.minimum(total, change) + errors[:, k]
    course = np.empty(count, dtype=int)
    course[-1] = int(np.argmin(total))
    for k in range(count - 1, 0, -1):
        course[k - 1] = came[course[k], k]
    return course
