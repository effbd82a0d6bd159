"""Friction of drives whose description has none."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Effect
from deltaid.effects.rigid_fit import Candidate, RigidFit


class MissingFriction(Effect):
    """Viscous and Coulomb friction; a verdict on the description reports it."""

    kind = "friction-missing"

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        robot = fit.trace.dynamics.robot
        without = [i for i, drive in enumerate(fit.drives) if drive not in robot.friction]
        if not without:
            return
        drives = np.arange(len(fit.drives))
        signs = fit.trace.filtered(lambda w: np.sign(w.qd).T, drives)
        speeds = fit.trace.filtered(lambda w: w.qd.T, drives)
        columns = np.hstack([fit.rows.own(rates)[:, without] for rates in (signs, speeds)])
        yield Candidate(self.kind, "", columns, is_preferred=True)
