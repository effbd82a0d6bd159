"""Times at which a load is picked up or put down, as a course between two levels (Viterbi)."""

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.rigid_fit import RigidFit
from deltaid.estimation.span import Rows

# Length of the windows in which a load is searched [s], and their largest number.
_WINDOW, _WINDOWS = 0.1, 4000
# A load is held for so long at least [s]; shorter ones are knocks.
_HELD = 0.4
# Shares of the windows that the search begins with as the lower level, and its rounds.
_SPLITS, _ROUNDS = (0.02, 0.2, 0.5, 0.8, 0.98), 4


def refined(
    fit: RigidFit, columns: Float[np.ndarray, "rows columns"], residual: Rows, held: np.ndarray
) -> Int[np.ndarray, " samples"] | None:
    """The course of a load and its coefficients by turns; None where it is not held long enough."""
    dof, count = len(fit.drives), len(held)
    for _ in range(_ROUNDS):
        carried = columns * np.tile(held, dof)[:, None]
        bare = fit.span.without(carried)
        theta = np.linalg.lstsq(bare, residual, rcond=1e-6)[0]
        remaining = residual - bare @ theta
        load = columns @ theta
        # What the torques would be of, were parameters those that go with this load.
        torque = remaining + np.tile(held, dof) * load
        gain = (load * (2 * torque - load)).reshape(dof, -1).sum(axis=0)
        noise = float(remaining @ remaining) / len(remaining)
        course = _course(np.stack([np.zeros(count), -gain]), 4.0 * noise * np.log(count))
        if np.array_equal(course, held):
            break
        held = course
    step = float(np.median(np.diff(fit.motion.time)))
    return held if min(held.sum(), count - held.sum()) * step >= _HELD else None


def two_levels(fit: RigidFit, column: Rows, residual: Rows) -> Int[np.ndarray, " samples"] | None:
    """For each sample 0 or 1, the lower or higher of two levels of a column's coefficient.

    Means of two levels by turns with the most likely course between them (Viterbi), where each
    change costs as much as chance makes of one.
    """
    time, dof = fit.motion.time, len(fit.drives)
    step = float(np.median(np.diff(time)))
    length = max(round(_WINDOW / step), 1, -(-len(time) // _WINDOWS))
    window = np.arange(len(time)) // length
    count = int(window[-1]) + 1
    u = np.bincount(window, (column * residual).reshape(dof, -1).sum(axis=0), count)
    d = np.bincount(window, (column**2).reshape(dof, -1).sum(axis=0), count)
    noise = float(residual @ residual) / len(residual)
    order = np.argsort(u / np.maximum(d, 1e-300))
    share = np.cumsum(d[order]) / max(float(d.sum()), 1e-300)
    cost, best, lowest = 4.0 * noise * np.log(count), None, np.inf
    for split in _SPLITS:
        levels = [_mean(u, d, order[part]) for part in (share <= split, share > split)]
        course, errors = np.zeros(count, dtype=int), np.zeros((2, count))
        for _ in range(_ROUNDS):
            errors = np.stack([d * level**2 - 2 * u * level for level in levels])
            course = _course(errors, cost)
            levels = [_mean(u, d, course == k) for k in (0, 1)]
        changes = int(np.sum(np.diff(course) != 0))
        if min(course.sum(), count - course.sum()) * length * step < _HELD:
            continue
        total = float(errors[course, np.arange(count)].sum()) + cost * changes
        if changes and total < lowest:
            best, lowest = course[window], total
    return best


def _mean(u: np.ndarray, d: np.ndarray, part: np.ndarray) -> float:
    return float(np.sum(u[part]) / max(float(np.sum(d[part])), 1e-300))


def _course(errors: Float[np.ndarray, "2 windows"], cost: float) -> Int[np.ndarray, " windows"]:
    """The course of least error between two levels, each change of which costs something."""
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
