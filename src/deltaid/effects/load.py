"""A load that is picked up or put down during a recording."""

from collections.abc import Callable, Iterable

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.load_times import Held, refined, two_levels
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.problem import Columns, Rows
from deltaid.model.verdict import Proposal
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.inertia import INERTIA_NAMES

# What may be missing of a completely inspected recording at once [s].
_GONE = 1.0
# How far a span that lasts to the end of a recording goes beyond it [s].
_BEYOND = 0.01


class LoadChange(DescribedEffect):
    """Parameters of a body that change between two sets of values.

    The times come from its mass alone at first; then times and all identifiable parameters of the
    load are estimated by turns.
    """

    kind = "load-change"

    def why(self, cause: Cause) -> str:
        if _shifts(cause):
            return f"something on {cause.first.words} is loose, or opens, turns or slides"
        return "a load is picked up or put down while recording goes on"

    def cure(self, cause: Cause) -> str:
        if _shifts(cause):
            return "fasten it, or identify the parts before and after as recordings of two robots"
        return (
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
                if (better := refined(fit, columns, residual, held)) is not None:
                    yield self._load(fit, body, columns, better)

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
        if _shifts(cause):
            words = f"{first.words}'s centre or inertia changes, and its mass does not, at {when}"
            return mass, "kg", words
        return mass, "kg", f"the mass of {first.words} changes by {mass:.2g} kg, at {when}"

    def held(self, cause: Cause, recording: PreparedRecording) -> Load | None:
        """The load and when it is held; None where not all of the recording was inspected, where a
        load is declared already, or where it is none."""
        first, time, log = cause.first, cause.fit.motion.time, recording.log
        start, end = log.clock.stamps(np.array([0, log.samples - 1])).tolist()
        if log.columns.loads or np.diff(time, prepend=start, append=end).max() > _GONE:
            return None
        if _shifts(cause):
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
        carrier = cause.fit.dynamics.robot.load_carrier
        return Load(spans=spans, body=None if first.words == carrier else first.words)

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
    return {
        body: np.stack([fit.rows.stack(fit.column(f"{body}.{x}")) for x in _shown(fit, body)], 1)
        for body in free
        if fit.shows(f"{body}.m")
    }


def _shown(fit: RigidFit, body: str) -> list[str]:
    """Those of a body's ten parameters that torques show."""
    return [name for name in INERTIA_NAMES if fit.shows(f"{body}.{name}")]


def _change(cause: Cause) -> dict[str, float]:
    """How much more each parameter of the carrier is in the second of a load's two states."""
    alone = cause.fit.span.without(cause.first.columns)
    change = np.linalg.lstsq(alone, cause.fit.tau, rcond=1e-6)[0].tolist()
    # The times fit the mass alone better than all of a load at times: then that is the only column.
    shown = _shown(cause.fit, cause.first.words)[: len(change)]
    return dict(zip(shown, change, strict=True))


def _mass(cause: Cause) -> float:
    """How much heavier the robot is in the second of a load's two states [kg]."""
    return _change(cause)["m"]


def _shifts(cause: Cause) -> bool:
    """Whether what changes is no body that comes and goes: its mass would have to be farther away
    than a limb reaches."""
    change, limbs = _change(cause), cause.fit.dynamics.robot.limbs
    if limbs is None:
        return False
    reach = max(limb.strut for limb in limbs.geometry())
    moment = np.linalg.norm([change.get(name, 0.0) for name in INERTIA_NAMES[1:4]])
    inertia = max(abs(change.get(name, 0.0)) for name in INERTIA_NAMES[4:])
    return bool(max(moment, inertia / reach) > reach * abs(change["m"]))
