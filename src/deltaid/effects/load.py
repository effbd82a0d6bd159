"""A load that is picked up or put down during a recording, or that empties or fills steadily."""

from collections.abc import Callable, Iterable

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.load_change import changes_of, is_weight, shifts, weighed
from deltaid.effects.load_search import Held, holders, refined, two_levels
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.problem import Columns, Rows
from deltaid.model.verdict import Proposal
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording

# Longest gap in the rows of a recording that counts as completely inspected [s].
_GONE = 1.0
# How far a span that lasts to the end of a recording extends beyond it [s].
_BEYOND = 0.01


class LoadChange(DescribedEffect):
    """Parameters of a body that change to and fro between two sets of values, or steadily from one
    to the other.

    The first times come from its mass alone; then times and all identifiable parameters of the load
    are estimated by turns.
    """

    kind = "load-change"

    def why(self, cause: Cause) -> str:
        if not is_weight(cause):
            return (
                "a force that comes and goes, as of something that hangs from the robot and swings"
            )
        if shifts(cause):
            return f"something on {cause.first.words} is loose, or opens, turns or slides"
        if not cause.first.detail:
            return "what the robot holds runs out, as glue that it dispenses, or fills up"
        return "a load is picked up or put down while recording goes on"

    def cure(self, cause: Cause) -> str:
        if not is_weight(cause):
            return "fasten or remove what pulls at the robot, and record again"
        if shifts(cause):
            return "fasten it, or identify the parts before and after as recordings of two robots"
        how = "{spans: …}, or the gripper's column"
        if not cause.first.detail:
            how = "{spans: …, course: …}"
        return (
            f"declare it in the mapping (load: {how}), and it is identified with the robot; "
            "else record without load"
        )

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        """A mass that changes steadily."""
        course = fit.trace.recording.drifting().share(fit.motion.time) - 0.5
        for body, columns in holders(fit).items():
            yield EffectCandidate(
                self.kind, "", columns[:, :1] * np.tile(course, fit.dof)[:, None], body
            )

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        columns_of = holders(fit)

        def candidates_in(residual: Rows) -> Iterable[EffectCandidate]:
            for body, columns in columns_of.items():
                mass = columns[:, :1]
                held = two_levels(fit, mass[:, 0], residual) if np.any(mass) else None
                if held is None:
                    continue
                yield self._load(fit, body, mass, held)
                if (better := refined(fit, columns, residual, held)) is not None:
                    yield self._load(fit, body, columns, better)

        return candidates_in

    def _load(self, fit: RigidFit, body: str, columns: Columns, held: Held) -> EffectCandidate:
        changes, time = np.flatnonzero(np.diff(held)), fit.motion.time
        tries = float(np.log10(len(held))) * len(changes)
        rows = np.tile(held, fit.dof)[:, None]
        times = tuple((0.5 * (time[changes] + time[changes + 1])).tolist())
        return EffectCandidate(self.kind, "", columns * rows, body, tries, times)

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        first, mass, times = cause.first, abs(changes_of(cause)["m"]), cause.first.detail
        when = ", ".join(f"{t:.2f}" for t in times[:4]) + (
            f" s and {len(times) - 4} times more" if len(times) > 4 else " s"
        )
        when = f"at {when}" if times else "steadily"
        if not is_weight(cause):
            weight, inertia = np.abs(weighed(cause)[0])
            words = (
                f"a force at {first.words} changes, {when}; it is no load: it weighs "
                f"{weight:.2g} kg and resists acceleration as {inertia:.2g} kg"
            )
            return mass, "kg", words
        if shifts(cause):
            words = f"{first.words}'s centre or inertia changes, and its mass does not, {when}"
            return mass, "kg", words
        return mass, "kg", f"the mass of {first.words} changes by {mass:.2g} kg, {when}"

    def held(self, cause: Cause, recording: PreparedRecording) -> Load | None:
        """The load with its spans; None where not all of the recording was inspected, where a load
        is declared already, or where it is no weight or only centre or inertia change."""
        first, time, log = cause.first, cause.fit.motion.time, recording.log
        start, end = log.clock.stamps(np.array([0, log.samples - 1])).tolist()
        if log.columns.loads or np.diff(time, prepend=start, append=end).max() > _GONE:
            return None
        if shifts(cause) or not is_weight(cause):
            return None
        carrier = cause.fit.dynamics.robot.load_carrier
        body = None if first.words == carrier else first.words
        if not first.detail:
            course = "fills" if changes_of(cause)["m"] > 0 else "empties"
            whole = (round(start, 3), round(end + _BEYOND, 3))
            return Load(spans=(whole,), course=course, body=body)
        is_held = first.columns.reshape(cause.fit.dof, len(time), -1).any(axis=(0, 2))
        changes = np.array(first.detail)
        k = int(np.argmax(is_held))
        held_first = (np.searchsorted(changes, time[k]) % 2 == 0) == (changes_of(cause)["m"] > 0)
        ends = [*([start] if held_first else []), *changes.tolist()]
        ends += [end + _BEYOND] if len(ends) % 2 else []
        spans = tuple(
            (round(start, 3), round(end, 3))
            for start, end in zip(ends[::2], ends[1::2], strict=True)
        )
        return Load(spans=spans, body=body)

    def proposals(self, cause: Cause, recording: PreparedRecording) -> tuple[Proposal, ...]:
        """Lines of a mapping that declare the load, where its spans are known."""
        load = self.held(cause, recording)
        if load is None:
            return ()
        body = () if load.body is None else (("load.body", load.body),)
        spans = [list(span) for span in load.spans or ()]
        course = () if load.course is None else (("load.course", load.course),)
        named = ("load.name", load.name), *body, ("load.spans", spans), *course
        return (Proposal("mapping", named),)
