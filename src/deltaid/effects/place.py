"""Torques that vary with the place of the platform: lengths, zeros, mounting, springs, cables."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.account import DETECTED
from deltaid.effects.effect import DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit


class PlaceDependence(DescribedEffect):
    """Polynomials of the task coordinates, alone and times the drive's torque."""

    kind = "geometry-or-cogging"
    is_contested = True
    likeliest = (
        "lengths, zeros or mounting are not as described, a spring or cable pulls, or gears have "
        "play"
    )
    fix = "measure arms, struts and radii, set the drives' zeros anew, and inspect for play"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        w, dof = fit.motion, fit.dof
        x = ((w.z - w.z.mean(axis=0)) / np.maximum(np.ptp(w.z, axis=0), 1e-12)).T
        shapes = [*x, *(x[i] * x[j] for i in range(dof) for j in range(i, dof))]
        blocks = [fit.rows.per_drive(w.weights.T * shape) for shape in shapes]
        blocks += [fit.rows.per_drive(fit.model * shape) for shape in x]
        words = "it bends with the place of the platform"
        for i, drive in enumerate(fit.drives):
            columns = np.stack([block[:, i] for block in blocks], axis=1)
            yield EffectCandidate(self.kind, drive, columns, words, DETECTED / dof, bends=True)
        yield EffectCandidate(self.kind, "", np.hstack(blocks), words, DETECTED, bends=True)
