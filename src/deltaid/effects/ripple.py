"""Torques that ripple over a drive's position: cogging of a motor, teeth of a gear."""

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float

from deltaid.effects.cause import Cause
from deltaid.effects.effect import DescribedEffect, torque_of
from deltaid.effects.rigid_fit import Candidate, RigidFit
from deltaid.estimation.span import Rows
from deltaid.model.words import percent

# Waves of a ripple over a drive's stroke.
_COUNTS = np.arange(1.0, 81.0, 0.5)

# Sine and cosine of each number of waves.
Waves = Float[np.ndarray, "2 counts samples"]


class Ripple(DescribedEffect):
    """For each drive the largest ripple in the residual.

    One of k waves over the stroke passes the filter as far as its frequency, k q̇ / stroke, does.
    """

    kind = "ripple"
    likeliest = "cogging of the motor, or teeth of the gear"
    fix = "let the drive compensate it, or take a lower --cutoff"

    @property
    def key(self) -> str:
        return "geometry-or-cogging"

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[Candidate]]:
        pairs = ((i, _waves(fit, i)) for i in range(len(fit.drives)))
        waves = {i: pair for i, pair in pairs if pair is not None}

        def candidates_in(residual: Rows) -> Iterable[Candidate]:
            residuals = fit.rows.of_drives(residual)
            return [self._best(fit, i, pair, residuals[i]) for i, pair in waves.items()]

        return candidates_in

    def _best(
        self, fit: RigidFit, i: int, pair: Waves, residual: Float[np.ndarray, " samples"]
    ) -> Candidate:
        """The largest ripple in a drive's residual."""
        power = np.maximum(np.sum(pair**2, axis=(0, 2)), 1e-300)
        k = int(np.argmax(np.sum((pair @ residual) ** 2, axis=0) / power))
        columns = np.zeros((len(fit.drives), len(residual), 2))
        columns[i] = pair[:, k].T
        return Candidate(
            self.kind,
            fit.drives[i],
            fit.rows.stack(columns),
            f"a ripple of {_COUNTS[k]:.3g} waves over the stroke",
            float(np.log10(len(_COUNTS))),
            bends=True,
        )

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        follows = f"{percent(share)} of {torque_of(subject)} follows the position"
        return 100 * share, "%", f"{follows} and is not explained: {cause.first.words}"


def _waves(fit: RigidFit, i: int) -> Waves | None:
    """Ripples of a drive as they pass the filter; None where it stands still."""
    w, low_pass, q = fit.motion, fit.trace.low_pass, fit.q[:, i]
    if (stroke := np.ptp(q)) == 0:
        return None
    frequency = np.fft.rfftfreq(1 << 14, 1 / low_pass.rate)
    passed = np.abs(np.fft.rfft(low_pass.response, 1 << 14))
    turns = 2 * np.pi * np.outer(_COUNTS, (q - q.min()) / stroke)
    speeds = np.abs(np.outer(_COUNTS, w.qd[:, i] / stroke))
    size = np.interp(speeds, frequency, passed) * w.weights[:, i]
    return np.stack([size * np.sin(turns), size * np.cos(turns)])
