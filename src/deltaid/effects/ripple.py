"""Torques that ripple over a drive's position: cogging of a motor, teeth of a gear."""

from collections.abc import Callable, Iterable

import numpy as np

from deltaid.effects.effect import DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.effects.ripple_search import waves_of
from deltaid.estimation.problem import Rows

# Numbers of waves over a drive's stroke that are searched.
_COUNTS = np.arange(1.0, 81.0, 0.5)


class PositionRipple(DescribedEffect):
    """For each drive the largest ripple in the residual.

    The filter passes k waves over the stroke as far as their frequency, k q̇ / stroke.
    """

    kind = "ripple"
    is_contested = True
    likeliest = "cogging of the motor, or teeth of the gear"
    fix = "let the drive compensate it, or take a lower --cutoff"

    @property
    def key(self) -> str:
        return "geometry-or-cogging"

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        strokes = np.ptp(fit.q, axis=0).tolist()
        waves = {
            i: waves_of(fit, i, 2 * np.pi / stroke * _COUNTS)
            for i, stroke in enumerate(strokes) if stroke > 0
        }  # fmt: skip

        def candidates_in(residual: Rows) -> Iterable[EffectCandidate]:
            for i, pairs in waves.items():
                power = np.maximum(np.sum(pairs**2, axis=(0, 2)), 1e-300)
                along = np.tensordot(fit.rows.of_drives(residual)[i], pairs, axes=1)
                k = int(np.argmax(np.sum(along**2, axis=1) / power))
                columns = np.zeros((fit.dof, len(pairs), 2))
                columns[i] = pairs[:, k]
                words = f"a ripple of {_COUNTS[k]:.3g} waves over the stroke"
                tries = float(np.log10(len(_COUNTS)))
                rows = fit.rows.stack(columns)
                yield EffectCandidate(self.kind, fit.drives[i], rows, words, tries, bends=True)

        return candidates_in
