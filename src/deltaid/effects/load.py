"""A load that is picked up or put down during a recording, and when: a course between two levels
(Viterbi)."""

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.problem import Columns, Rows
from deltaid.model.verdict import Proposal
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording

# What may be missing of a completely inspected recording at once [s].
_GONE = 1.0
# How far a span that lasts to the end of a recording goes beyond it [s].
_BEYOND = 0.01


# Length of the windows in which a load is searched [s], and their largest number.
_WINDOW, _WINDOWS = 0.1, 4000
# A load is held for so long at least [s]; shorter ones are knocks.
_HELD = 0.4
# Shares of the windows that the search begins with as the lower level, and its rounds.
_SPLITS, _ROUNDS = (0.02, 0.2, 0.5, 0.8, 0.98), 4

# For each sample or window 0 or 1: the lower or higher of two levels.
Held = Int[np.ndarray, " samples"]


class LoadChange(DescribedEffect):
    """Parameters of a body that change between two sets of values.

    The times come from its mass alone at first; then times and all identifiable parameters of the
    load are estimated by turns.
    """

    kind = "load-change"
    likeliest = "a load is picked up or put down while recording goes on"
    fix = (
        "declare it in the mapping (load: {spans: …}, or the gripper's column), and it is "
        "identified with the robot; else record without load"
    )

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        holders = _holders(fit)

        def candidates_in(residual: Rows) -> Iterable[EffectCandidate]:
            for body, columns in holders.items():
                mass = columns[:, :1]
                held = two_levels(fit, mass[:, 0], residual) if np.any(mass) else None
                if held is None:
                    continue
                yield self._load(fit, body, mass, held)
                shown = columns[:, columns.any(axis=0)]
                if (better := refined(fit, shown, residual, held)) is not None:
                    yield self._load(fit, body, shown, better)

        return candidates_in

    def _load(self, fit: RigidFit, body: str, columns: Columns, held: Held) -> EffectCandidate:
        changes, time = np.flatnonzero(np.diff(held)), fit.motion.time
        tries = float(np.log10(len(held))) * len(changes)
        rows = np.tile(held, fit.dof)[:, None]
        times = tuple((0.5 * (time[changes] + time[changes + 1])).tolist())
        return EffectCandidate(self.kind, "", columns * rows, body, tries, times)

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        first, mass, times = cause.first, abs(_mass(cause)), cause.first.detail
        when = ", ".join(f"{t:.2f}" for t in times[:4]) + (
            f" s and {len(times) - 4} times more" if len(times) > 4 else " s"
        )
        return mass, "kg", f"the mass of {first.words} changes by {mass:.2g} kg, at {when}"

    def held(self, cause: Cause, recording: PreparedRecording) -> Load | None:
        """The load and when it is held; None where not all of the recording was inspected, or where
        a load is declared already."""
        first, time, log = cause.first, cause.fit.motion.time, recording.log
        start, end = log.clock.stamps(np.array([0, log.samples - 1])).tolist()
        if log.columns.loads or np.diff(time, prepend=start, append=end).max() > _GONE:
            return None
        is_held = first.columns.reshape(cause.fit.dof, len(time), -1).any(axis=(0, 2))
        changes = np.array(first.detail)
        k = int(np.argmax(is_held))
        held_first = (np.searchsorted(changes, time[k]) % 2 == 0) == (_mass(cause) > 0)
        ends = [*([start] if held_first else []), *changes.tolist()]
        ends += [end + _BEYOND] if len(ends) % 2 else []
        spans = tuple(
            (round(start, 3), round(end, 3))
            for start, end in zip(ends[::2], ends[1::2], strict=True)
        )
        return Load(spans=spans, body=None if first.words in ("EE", "P") else first.words)

    def proposals(self, cause: Cause, recording: PreparedRecording) -> tuple[Proposal, ...]:
        """Lines of a mapping that declare a load; none where it is not known when it is held."""
        load = self.held(cause, recording)
        if load is None:
            return ()
        body = () if load.body is None else (("load.body", load.body),)
        spans = [list(span) for span in load.spans or ()]
        return (Proposal("mapping", (("load.name", load.name), *body, ("load.spans", spans))),)


def _holders(fit: RigidFit) -> dict[str, Columns]:
    """The tool or, where there is none, the bodies that limbs carry, as far as their mass shows:
    columns of those of their ten parameters that do, the mass first."""
    robot, layout = fit.dynamics.robot, fit.dynamics.layout
    limbs = 0 if robot.limbs is None else robot.limbs.count
    arms = {name for i in range(limbs) for name in robot.limb_bodies(i)}
    free = ["EE"] if "EE" in layout.bodies else [body for body in layout.bodies if body not in arms]
    shown = [entry for entry in layout.parameters if fit.shows(entry.name)]
    return {
        body: np.stack([fit.rows.stack(fit.column(e.name)) for e in shown if e.owner == body], 1)
        for body in free
        if fit.shows(f"{body}.m")
    }


def _mass(cause: Cause) -> float:
    """How much heavier the robot is in the second of a load's two states [kg]."""
    alone = cause.fit.span.without(cause.first.columns)
    return float(np.linalg.lstsq(alone, cause.fit.tau, rcond=1e-6)[0][0])


def refined(fit: RigidFit, columns: Columns, residual: Rows, held: Held) -> Held | None:
    """The course of a load and its coefficients by turns; None where it is not held long enough."""
    count = len(held)
    for _ in range(_ROUNDS):
        is_held = np.tile(held, fit.dof)
        bare = fit.span.without(columns * is_held[:, None])
        theta = np.linalg.lstsq(bare, residual, rcond=1e-6)[0]
        remaining = residual - bare @ theta
        load = columns @ theta
        # What the torques would be of, were parameters those that go with this load.
        torque = remaining + is_held * load
        gain = (load * (2 * torque - load)).reshape(fit.dof, -1).sum(axis=0)
        noise = float(remaining @ remaining) / len(remaining)
        course = _course(np.stack([np.zeros(count), -gain]), 4.0 * noise * np.log(count))
        if np.array_equal(course, held):
            break
        held = course
    return held if _is_long(held, float(np.median(np.diff(fit.motion.time)))) else None


def two_levels(fit: RigidFit, column: Rows, residual: Rows) -> Held | None:
    """For each sample 0 or 1, the lower or higher of two levels of a column's coefficient.

    Means of two levels by turns with the most likely course between them (Viterbi), where each
    change costs as much as chance makes of one.
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
        for _ in range(_ROUNDS):
            parts = course == 0, course == 1
            levels = [np.sum(u[part]) / max(np.sum(d[part]), 1e-300) for part in parts]
            errors = np.stack([d * level**2 - 2 * u * level for level in levels])
            course = _course(errors, cost)
        changes = int(np.sum(np.diff(course) != 0))
        total = float(errors[course, np.arange(count)].sum()) + cost * changes
        if changes and total < lowest and _is_long(course, length * step):
            best, lowest = course[window], total
    return best


def _is_long(course: Held, step: float) -> bool:
    """Whether both levels last long enough, for seconds from one to the next."""
    return bool(min(course.sum(), len(course) - course.sum()) * step >= _HELD)


def _course(errors: Float[np.ndarray, "2 samples"], cost: float) -> Held:
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
