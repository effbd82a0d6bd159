"""Motors whose torque constant falls with current, as their iron saturates."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit, TracePoint
from deltaid.effects.unknown import Deviations, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.estimation.problem import Columns
from deltaid.model.corrections import Correction
from deltaid.model.verdict import percent
from deltaid.recording.columns import LEAST_SLOPE
from deltaid.robot.description import RobotDescription

# Currents at which a torque has to grow.
_CURRENTS = 21


class Saturation(UnknownEffect):
    """β_2, β_4 of each drive as of `Readings`, with the columns τ_m u² and τ_m u⁴."""

    name = "torque-constant"
    corrects = "readings"
    deviation = 0.05
    is_of_parts = False  # how far motors are driven into saturation is no matter of tolerances
    kind, unit = "torque-constant", "%"
    text = "its torque constant falls with current: the joint lacks this at its largest torque"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        recording, torque = point.trace.recording, point.model
        if (readings := recording.repairs.readings) is not None:  # as amplifiers say it
            torque = readings.recorded(torque.T).T
        highest = np.maximum(point.highest or recording.log.torque_max, np.finfo(float).tiny)
        squared = (torque / highest[:, None]) ** 2
        return of_own_drives(np.stack([torque * squared, torque * squared**2], axis=2))

    def is_possible(self, values: Deviations) -> bool:
        """Torque constants fall with current; where they would grow, something else does."""
        lacking = values.reshape(-1, 2).sum(axis=1)
        return bool(np.sum(lacking * np.abs(lacking)) >= 0.0)

    def possible(self, values: Deviations) -> Deviations:
        """Torques grow with current, up to the largest."""
        u = np.linspace(0.0, 1.0, _CURRENTS)
        pairs = values.reshape(-1, 2)
        falls = (pairs @ np.stack([3.0 * u**2, 5.0 * u**4])).max(axis=1)
        share = (1.0 - LEAST_SLOPE) / np.maximum(falls, 1.0 - LEAST_SLOPE)
        return np.ravel(pairs * share[:, None])

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        lacking, wide = values.reshape(-1, 2).sum(axis=1), half.reshape(-1, 2).max(axis=1)
        return super().corrections(robot, lacking, wide)


class FallingGain(DescribedEffect):
    """A recorded torque τ_r of which the joint gets τ = τ_r (1 − β (τ_r/τ_max)²).

    To first order in β, τ_r = Y p + β τ³/τ_max² with the torques τ of the model and their largest
    size τ_max, where the joint lacks the share β.
    """

    kind = "torque-constant"
    likeliest = "the motor saturates, so that its torque constant falls with current"
    fix = (
        "record torques by the motor's curve of torque over current, not by one constant; or move "
        "more gently"
    )

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        return self.of_each(fit.drives, _cubes(fit))

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        fit, others = cause.fit, cause.others
        lacking = np.linalg.lstsq(others.without(_cubes(fit)), others.without(fit.tau))[0]
        worst = fit.drives.index(subject) if subject else int(np.argmax(np.abs(lacking)))
        beta = float(lacking[worst])
        size = f"{percent(abs(beta))} too {'large' if beta > 0 else 'small'}"
        return 100 * beta, "%", f"{fit.drives[worst]}'s largest torques are {size}, small ones not"


def _cubes(fit: RigidFit) -> Columns:
    """τ³/τ_max², one column a drive."""
    return fit.rows.per_drive(fit.model * (fit.model / fit.largest[:, None]) ** 2)
