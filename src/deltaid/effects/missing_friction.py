"""Friction of drives whose description has none."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Effect
from deltaid.effects.point import EffectCandidate, RigidFit


class MissingFriction(Effect):
    """Viscous and Coulomb friction; the check of the description reports it."""

    kind = "friction-missing"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        friction = fit.dynamics.robot.friction
        without = [i for i, drive in enumerate(fit.drives) if drive not in friction]
        if without:
            every = np.arange(fit.dof)
            signs = fit.trace.filtered(lambda w: np.sign(w.qd).T, every)
            speeds = fit.trace.filtered(lambda w: w.qd.T, every)
            columns = np.hstack(
                [fit.rows.per_drive(rates)[:, without] for rates in (signs, speeds)]
            )
            yield EffectCandidate(self.kind, "", columns, is_preferred=True)
