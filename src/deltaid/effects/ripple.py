"""Torques that ripple over a drive's position: cogging of a motor, teeth of a gear."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.cause import Cause
from deltaid.effects.effect import Effect, torque_of
from deltaid.effects.scene import Candidate, Scene
from deltaid.estimation.span import Rows
from deltaid.model.words import percent

# Waves of a ripple over a drive's stroke.
_WAVES = np.arange(1.0, 81.0, 0.5)


class Ripple(Effect):
    """For each drive the ripple that is seen best in what is left.

    One of k waves over the stroke passes the filter as far as its frequency, k q̇ / stroke, does.
    """

    kind = "ripple"

    @property
    def key(self) -> str:
        return "geometry-or-cogging"

    def searched(self, scene: Scene, left: Rows) -> Iterable[Candidate]:
        w, low_pass = scene.motion, scene.trace.low_pass
        q = scene.trace.dynamics.kinematics.inverse(w.z)
        frequency = np.fft.rfftfreq(1 << 14, 1 / low_pass.rate)
        passed = np.abs(np.fft.rfft(low_pass.response, 1 << 14))
        for i, residual in enumerate(scene.rows.of_drives(left)):
            stroke = np.ptp(q[:, i])
            if stroke == 0:
                continue
            turns = np.outer(_WAVES, (q[:, i] - q[:, i].min()) / stroke)
            speeds = np.abs(np.outer(_WAVES, w.qd[:, i] / stroke))
            size = np.interp(speeds, frequency, passed) * w.weights[:, i]
            pair = np.stack([size * np.sin(2 * np.pi * turns), size * np.cos(2 * np.pi * turns)])
            power = np.sum(pair**2, axis=(0, 2))
            k = int(np.argmax(np.sum((pair @ residual) ** 2, axis=0) / np.maximum(power, 1e-300)))
            columns = np.zeros((len(scene.drives), len(residual), 2))
            columns[i] = pair[:, k].T
            yield Candidate(
                self.kind,
                scene.drives[i],
                scene.rows.stack(columns),
                f"a ripple of {_WAVES[k]:.3g} waves over the stroke",
                float(np.log10(len(_WAVES))),
                (float(stroke / _WAVES[k]),),
                bends=True,
            )

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        follows = f"{percent(share)} of {torque_of(subject)} follows the position"
        return 100 * share, "%", f"{follows} and is not explained: {cause.first.words}"

    def why(self, cause: Cause) -> str:
        del cause
        return "cogging of the motor, or teeth of the gear"

    def cure(self, cause: Cause) -> str:
        del cause
        return "let the drive compensate it, or take a lower --cutoff"
