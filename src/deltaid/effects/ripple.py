"""Torques that ripple over a drive's position: cogging of a motor, teeth of a gear."""

from collections.abc import Callable, Iterable

import numpy as np

from deltaid.effects.effect import DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.effects.ripple_search import passed
from deltaid.estimation.problem import Rows

# Waves of a ripple over a drive's stroke.
_COUNTS = np.arange(1.0, 81.0, 0.5)


class PositionRipple(DescribedEffect):
    """For each drive the largest ripple in the residual.

    One of k waves over the stroke passes the filter as far as its frequency, k q̇ / stroke, does.
    """

    kind = "ripple"
    likeliest = "cogging of the motor, or teeth of the gear"
    fix = "let the drive compensate it, or take a lower --cutoff"

    @property
    def key(self) -> str:
        return "geometry-or-cogging"

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        waves = dict[int, np.ndarray]()
        for i, stroke in enumerate(np.ptp(fit.q, axis=0).tolist()):
            if stroke > 0:
                orders = 2 * np.pi / stroke * _COUNTS
                turns, size = np.outer(orders, fit.q[:, i]), passed(fit, i, orders)
                waves[i] = np.stack([size * np.sin(turns), size * np.cos(turns)])

        def candidates_in(residual: Rows) -> Iterable[EffectCandidate]:
            for i, pair in waves.items():
                power = np.maximum(np.sum(pair**2, axis=(0, 2)), 1e-300)
                along = pair @ fit.rows.of_drives(residual)[i]
                k = int(np.argmax(np.sum(along**2, axis=0) / power))
                columns = np.zeros((fit.dof, pair.shape[2], 2))
                columns[i] = pair[:, k].T
                words = f"a ripple of {_COUNTS[k]:.3g} waves over the stroke"
                tries = float(np.log10(len(_COUNTS)))
                rows = fit.rows.stack(columns)
                yield EffectCandidate(self.kind, fit.drives[i], rows, words, tries, bends=True)

        return candidates_in
