"""Zeros of drives that are off, and a tilted base, which looks much the same."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from deltaid.effects.effect import Effect
from deltaid.effects.point import Candidate, RigidFit

# Steps [rad or m] that the slope by a drive's zero is taken with.
_STEP = 1e-4


class Zero(Effect):
    """The zero of a drive or of all; verdicts on wiring report how far they are off."""

    kind = "homing-or-tilt"

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        """Slopes of the torques by each zero."""
        w, dynamics = fit.motion, fit.dynamics
        before, slopes = dynamics.torque(w.z, w.qd, w.qdd, fit.p), list[np.ndarray]()
        for step in _STEP * np.eye(fit.dof):
            z, good = dynamics.kinematics.forward_unchecked(fit.q + step)
            slope = (dynamics.torque(z, w.qd, w.qdd, fit.p) - before) / _STEP
            slopes.append(np.where(good[:, None], slope, 0.0).T)
        for candidate in self.of_each(fit.drives, fit.rows.stack(fit.weighted(slopes))):
            yield replace(candidate, is_preferred=True, bends=True)
