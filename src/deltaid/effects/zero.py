"""Drives whose zeros are off, and a tilted base, which looks alike to first order."""

from collections.abc import Iterable
from dataclasses import replace

from deltaid.effects.effect import Effect
from deltaid.effects.geometry import Zeros
from deltaid.effects.point import EffectCandidate, RigidFit


class Zero(Effect):
    """The zero of a drive or of all; the check of the wiring reports by how much it is off."""

    kind = "homing-or-tilt"
    is_contested = True

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        for candidate in self.of_each(fit.drives, fit.rows.stack(Zeros().columns(fit))):
            yield replace(candidate, is_preferred=True, bends=True)
