"""Identification with a package that lacks some effects."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import pytest

from deltaid.effects.point import TracePoint, UnknownEffect
from deltaid.identification import contest, contest_outcome, contest_stage, contest_sweeps, study

SPRINGS = frozenset({"isotropic-spring", "anisotropic-spring", "cable"})
# Names and kinds of effects that model the same cause, by its row in `causes.py`.
CAUSES_OF: dict[str, frozenset[str]] = {
    "homing-0.5": frozenset({"zero", "homing-or-tilt"}),
    "gear-ratio": frozenset({"gear-ratio"}),
    "long-limb": frozenset({"length"}),
    "tilt": frozenset({"tilt"}),
    "falling-gain": frozenset({"torque-constant"}),
    "ripple": frozenset({"ripple"}),
    "balancer": frozenset({"drive-spring"}),
    "hose": frozenset({"platform-force", "platform-drag", *SPRINGS}),
    "askew": frozenset({"structure"}),
    "heavy-limb": frozenset({"limb"}),
    "presliding": frozenset({"presliding"}),
    "ball-joints": frozenset({"joint-friction"}),
}


@contextmanager
def without(missing: Collection[str]) -> Iterator[None]:
    """Remove effects of some names and kinds from studies and contests.

    Args:
        missing: names and kinds, such as 'gear-ratio' or 'ripple'.
    """
    known = tuple(unknown for unknown in contest_sweeps.UNKNOWNS if unknown.name not in missing)
    searched = tuple(effect for effect in study.EFFECTS if effect.kind not in missing)
    unknowns = contest_sweeps.unknowns_at

    def others(point: TracePoint) -> tuple[UnknownEffect, ...]:
        return tuple(unknown for unknown in unknowns(point) if unknown.name not in missing)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contest_stage, "UNKNOWNS", known)
        patch.setattr(contest_sweeps, "UNKNOWNS", known)
        patch.setattr(contest_outcome, "UNKNOWNS", known)
        patch.setattr(contest_sweeps, "unknowns_at", others)
        patch.setattr(study, "EFFECTS", searched)
        if "ripple" in missing:
            patch.setattr(contest.Contest, "with_ripples", lambda self: self)
        yield
