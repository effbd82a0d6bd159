"""Patterns that are searched for: ripples over the position, and steps of load over time."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from deltaid.estimation.span import Rows
from deltaid.identification.patterns import Pattern, Scene

# Waves of a ripple over a drive's stroke.
_WAVES = np.arange(1.0, 81.0, 0.5)
# Windows in which a load is looked at [s], and at most so many.
_WINDOW, _WINDOWS = 0.1, 4000
# A load is held for so long at least [s]; what is shorter is a knock.
_HELD = 0.4
# Shares of the windows that the search begins with as the lower level, and how often it goes round.
_SPLITS, _ROUNDS = (0.02, 0.2, 0.5, 0.8, 0.98), 4


def ripples(scene: Scene, left: Rows) -> Iterator[Pattern]:
    """For each drive the ripple over its position that is seen best in what is left.

    A ripple of k waves over the stroke passes the filter as far as its frequency, k q̇ / stroke,
    does.
    """
    w, low_pass = scene.motion, scene.trace.low_pass
    q = scene.trace.dynamics.kinematics.inverse(w.z)
    response = low_pass.response
    frequency = np.fft.rfftfreq(1 << 14, 1 / low_pass.rate)
    passed = np.abs(np.fft.rfft(response, 1 << 14))
    residual = scene.rows.of_drives(left)
    for i, drive in enumerate(scene.drives):
        stroke = np.ptp(q[:, i])
        if stroke == 0:
            continue
        turns = np.outer(_WAVES, (q[:, i] - q[:, i].min()) / stroke)
        speeds = np.abs(np.outer(_WAVES, w.qd[:, i] / stroke))
        size = np.interp(speeds, frequency, passed) * w.weights[:, i]
        pair = np.stack([size * np.sin(2 * np.pi * turns), size * np.cos(2 * np.pi * turns)])
        u = pair @ residual[i]
        power = np.sum(pair**2, axis=(0, 2))
        k = int(np.argmax(np.sum(u**2, axis=0) / np.maximum(power, 1e-300)))
        columns = [scene.rows.own(_only(x, i, len(scene.drives)))[:, i] for x in pair[:, k]]
        waves = float(_WAVES[k])
        yield Pattern(
            "geometry-or-cogging",
            drive,
            np.stack(columns, axis=1),
            f"a ripple of {waves:.3g} waves over the stroke",
            float(np.log10(len(_WAVES))),
            (float(stroke / waves),),
        )


def _only(x: np.ndarray, i: int, dof: int) -> np.ndarray:
    full = np.zeros((dof, len(x)))
    full[i] = x
    return full


def load_steps(scene: Scene, left: Rows) -> Iterator[Pattern]:
    """A load that comes and goes: parameters of a body that change between two sets of values.

    The times come from its mass alone at first; then times and all that shows of the load, mass,
    moments and inertia, are found by turns.
    """
    for body in _holders(scene):
        mass = scene.rows.stack(scene.column(f"{body}.m"))
        found = _two_levels(scene, mass, left) if np.any(mass) else None
        if found is None:
            continue
        yield _load(scene, body, mass[:, None], found)
        whole = _columns_of(scene, body)
        if (better := _refined(scene, whole, left, found)) is not None:
            yield _load(scene, body, whole, better)


def _holders(scene: Scene) -> list[str]:
    """The tool or, where there is none, the bodies that limbs carry, as far as their mass shows."""
    robot, bodies = scene.trace.dynamics.robot, scene.trace.dynamics.layout.bodies
    limbs = 0 if robot.limbs is None else robot.limbs.count
    arms = {name for i in range(limbs) for name in robot.limb_bodies(i)}
    free = ["EE"] if "EE" in bodies else [body for body in bodies if body not in arms]
    return [body for body in free if scene.shows(f"{body}.m")]


def _load(
    scene: Scene,
    body: str,
    columns: Float[np.ndarray, "rows columns"],
    held: Int[np.ndarray, " samples"],
) -> Pattern:
    """Columns while the load is held, the mass's first."""
    at = np.flatnonzero(np.diff(held))
    tries = float(np.log10(len(held))) * len(at)
    rows = np.tile(held, len(scene.drives))[:, None]
    time = scene.motion.time
    times = tuple((0.5 * (time[at] + time[at + 1])).tolist())
    return Pattern("load-change", "", columns * rows, body, tries, times)


def _columns_of(scene: Scene, body: str) -> Float[np.ndarray, "rows columns"]:
    """Those of a body's ten parameters that show, the mass first."""
    names = [one.name for one in scene.trace.dynamics.layout.parameters if one.owner == body]
    columns = [scene.column(name) for name in names if scene.shows(name)]
    return np.stack([scene.rows.stack(x) for x in columns if np.any(x)], axis=1)


def _refined(
    scene: Scene, columns: Float[np.ndarray, "rows columns"], left: Rows, held: np.ndarray
) -> Int[np.ndarray, " samples"] | None:
    """The course of a load and its coefficients by turns; None where it is not held long enough."""
    dof, count = len(scene.drives), len(held)
    for _ in range(_ROUNDS):
        carried = columns * np.tile(held, dof)[:, None]
        bare = scene.span.without(carried)
        theta = np.linalg.lstsq(bare, left, rcond=1e-6)[0]
        rest = left - bare @ theta
        load = columns @ theta
        # What the torques would be of, were parameters those that go with this load.
        torque = rest + np.tile(held, dof) * load
        gain = (load * (2 * torque - load)).reshape(dof, -1).sum(axis=0)
        noise = float(rest @ rest) / len(rest)
        course = _course(np.stack([np.zeros(count), -gain]), 4.0 * noise * np.log(count))
        if np.array_equal(course, held):
            break
        held = course
    step = float(np.median(np.diff(scene.motion.time)))
    return held if min(held.sum(), count - held.sum()) * step >= _HELD else None


def _two_levels(scene: Scene, column: Rows, left: Rows) -> Int[np.ndarray, " samples"] | None:
    """For each sample 0 or 1, the lower or higher of two levels of a column's coefficient.

    Means of two levels by turns with the most likely course between them (Viterbi), where each
    change costs as much as chance makes of one.
    """
    time, dof = scene.motion.time, len(scene.drives)
    step = float(np.median(np.diff(time)))
    length = max(round(_WINDOW / step), 1, -(-len(time) // _WINDOWS))
    window = np.arange(len(time)) // length
    count = int(window[-1]) + 1
    u = np.bincount(window, (column * left).reshape(dof, -1).sum(axis=0), count)
    d = np.bincount(window, (column**2).reshape(dof, -1).sum(axis=0), count)
    noise = float(left @ left) / len(left)
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
    """A level, of some windows."""
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
