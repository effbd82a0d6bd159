"""Zeros of drives that are off, and a tilted base, which looks much the same."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Effect
from deltaid.effects.rigid_fit import Candidate, RigidFit

# Steps [rad or m] that the slope by a drive's zero is taken with.
_STEP = 1e-4


class Zero(Effect):
    """The zero of a drive or of all; verdicts on wiring report how far they are off."""

    kind = "homing-or-tilt"

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        """Slopes of the torques by each zero."""
        w, dynamics = fit.motion, fit.trace.dynamics
        before = dynamics.torque(w.z, w.qd, w.qdd, fit.p)
        columns = []
        for i, drive in enumerate(fit.drives):
            moved = fit.q.copy()
            moved[:, i] += _STEP
            z, good = dynamics.kinematics.forward_unchecked(moved)
            slope = (dynamics.torque(z, w.qd, w.qdd, fit.p) - before) / _STEP
            slope[~good] = 0.0
            columns.append(fit.rows.stack((slope * w.weights).T))
            yield self._candidate(drive, columns[-1][:, None])
        yield self._candidate("", np.stack(columns, axis=1))

    def _candidate(self, drive: str, columns: np.ndarray) -> Candidate:
        return Candidate(self.kind, drive, columns, is_preferred=True, bends=True)
