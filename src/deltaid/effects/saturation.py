"""Motors whose torque constant falls with current, as their iron saturates."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from deltaid.effects.account import DETECTED
from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.point import Deviations, EffectCandidate, RigidFit, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.estimation.problem import Columns
from deltaid.estimation.scatter import surprise
from deltaid.model.verdict import percent
from deltaid.recording.columns import LEAST_SLOPE


class Saturation(UnknownEffect, DescribedEffect):
    """A recorded torque τ_r of which the joint gets τ = τ_r (1 − β (τ_r/τ_max)²).

    To first order in β, τ_r = Y p + β τ³/τ_max² with the model's torques τ and their largest size
    τ_max. In the contest each drive has the coefficients β_2, β_4 of `Readings` with the columns
    τ u² and τ u⁴, u = τ/τ_max.
    """

    name = "torque-constant"
    corrects = "readings"
    deviation = 0.05
    is_of_parts = False  # no tolerance of manufacture bounds how far motors saturate
    kind = corrected_as = "torque-constant"
    is_contested = True
    unit = "%"
    text = "its torque constant falls with current: this is missing at its largest torque"
    likeliest = "the motor saturates, so that its torque constant falls with current"
    fix = (
        "record torques by the motor's curve of torque over current, not by one constant; or move "
        "more gently"
    )

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        recording, torque = point.trace.recording, point.model
        if (readings := recording.repairs.readings) is not None:  # as amplifiers say it
            torque = readings.recorded(torque.T).T
        highest = np.maximum(point.highest or recording.log.torque_max, np.finfo(float).tiny)
        squared = (torque / highest[:, None]) ** 2
        return of_own_drives(np.stack([torque * squared, torque * squared**2], axis=2))

    def is_possible(
        self, values: Deviations, covariance: Float[np.ndarray, "coefficients coefficients"]
    ) -> bool:
        """Torque constants fall with current and do not rise again, beyond chance, up to its peak:
        β_2 + 2 β_4 ≥ 0."""
        pairs, count = values.reshape(-1, 2), len(values) // 2
        lacking, falling = pairs.sum(axis=1), np.kron(np.eye(count), [1.0, 2.0])
        deviation = np.sqrt(np.diag(falling @ covariance @ falling.T))
        rising = np.sum(np.minimum(falling @ values / deviation, 0.0) ** 2)
        falls = float(np.sum(lacking * np.abs(lacking))) >= 0.0
        return falls and surprise(float(rising), count) < DETECTED

    def possible(self, values: Deviations) -> Deviations:
        """Reduced so that torques grow with current up to the largest."""
        u = np.linspace(0.0, 1.0, num=21)
        pairs = values.reshape(-1, 2)
        falls = (pairs @ np.stack([3.0 * u**2, 5.0 * u**4])).max(axis=1)
        share = (1.0 - LEAST_SLOPE) / np.maximum(falls, 1.0 - LEAST_SLOPE)
        return np.ravel(pairs * share[:, None])

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        return self.of_each(fit.drives, _cubes(fit))

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        fit, others = cause.fit, cause.others
        lacking = np.linalg.lstsq(others.without(_cubes(fit)), others.without(fit.tau))[0]
        worst = fit.drives.index(subject) if subject else int(np.argmax(np.abs(lacking)))
        beta = float(lacking[worst])
        size = f"{percent(abs(beta))} too {'large' if beta > 0 else 'small'}"
        return (
            100 * beta,
            "%",
            f"{fit.drives[worst]}'s largest torques are {size}; small ones are right",
        )


def _cubes(fit: RigidFit) -> Columns:
    """τ³/τ_max², one column a drive."""
    return fit.rows.per_drive(fit.model * (fit.model / fit.largest[:, None]) ** 2)
