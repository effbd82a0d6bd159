"""Drives whose torque is not what the recording calls 1 N m: a torque constant, which may fall with
current, a gear ratio."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.linalg import null_space

from deltaid.effects.effect import SEEN, Cause, DescribedEffect
from deltaid.effects.point import Deviations, EffectCandidate, RigidFit, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.estimation.problem import Columns, scatter
from deltaid.estimation.scatter import surprise
from deltaid.model.corrections import Correction
from deltaid.model.verdict import listed, percent
from deltaid.recording.columns import LEAST_SLOPE
from deltaid.robot.description import RobotDescription

# A drive's factor is odd where it is so many standard deviations, this much, and this share of the
# oddest one's away from the middle of all.
_CLEAR, _ODD, _BESIDE = 3.0, 0.01, 0.25
# Directions of factors below this share are excluded: one common to all is not identifiable.
_SHOWN = 1e-4
# Currents at which a torque has to grow.
_CURRENTS = 21


class Gain(UnknownEffect, DescribedEffect):
    """A factor for one drive's torque, or for each.

    In the contest τ_m,i = (1 + g_i) τ_i with Σ g_i = 0 over the drives of limbs: what is common to
    all is not identifiable.
    """

    kind = "drive-gain"
    name = "gain"
    deviation = 0.03
    likeliest = "a torque constant, rated torque or gear that is not what the mapping says"
    fix = (
        "check torque constants and gears of these drives' torque columns; a recording shows "
        "ratios of gains only, and a second one with a known load shows each of them"
    )

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        limbs = point.dynamics.robot.limbs
        count = limbs.count if limbs is not None and limbs.identical else 1
        ratios = np.zeros((point.dof, count - 1))
        ratios[:count] = null_space(np.ones((1, count)))
        return of_own_drives(point.model[:, :, None]) @ ratios

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        return self.of_each(fit.drives, fit.rows.per_drive(fit.scaled_model))

    def subject(self, cause: Cause) -> str:
        odd = list(odd_gains(cause))
        return listed(odd) if len(odd) < len(cause.fit.drives) else ""

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        gains = odd_gains(cause)
        sizes = [
            f"{drive}'s {'torque is ' if k == 0 else ''}{percent(abs(gain))} too "
            f"{'large' if gain > 0 else 'small'}"
            for k, (drive, gain) in enumerate(gains.items())
        ]
        reference = "the other drives'" if len(gains) == 1 else "the mean of the limbs' drives"
        return 100 * max(gains.values(), key=abs), "%", f"{listed(sizes)} against {reference}"


def odd_gains(cause: Cause) -> dict[str, float]:
    """By which share torques are too large, of the drives whose factor is not that of the others.

    Of a single drive against the others; of several against the mean of the limbs' drives, since
    a factor common to all does not show.
    """
    fit, drives = cause.fit, cause.fit.drives
    named = {part.candidate.subject for part in cause.found}
    factor, deviation = _factors(cause)
    apart = np.abs(factor / np.median(factor) - 1.0)
    least = np.maximum(_CLEAR * deviation, max(_ODD, _BESIDE * float(apart.max())))
    odd = [drives.index(drive) for drive in named] if named != {""} and len(named) == 1 else []
    odd = odd or np.flatnonzero(apart > least).tolist() or [int(np.argmax(apart))]
    if len(odd) == 1:
        others = np.delete(factor, odd[0])
        return {drives[odd[0]]: float(factor[odd[0]] / np.median(others) - 1.0)}
    limbs = fit.dynamics.robot.limbs
    gains = factor / np.mean(factor[: limbs.count if limbs else None]) - 1.0
    clear = np.flatnonzero(np.abs(gains) > np.maximum(_CLEAR * deviation, _ODD))
    return {drives[i]: float(gains[i]) for i in clear}


def _factors(cause: Cause) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
    """What each drive's torque is of the model's, up to a common factor, and its deviation."""
    fit, span = cause.fit, cause.others
    columns = fit.rows.per_drive(fit.scaled_model)
    bare = span.without(columns)
    influence = np.linalg.pinv(bare, rcond=_SHOWN).T
    theta = influence.T @ fit.tau
    p = span.coefficients(fit.tau - columns @ theta)
    common = float(np.sum((fit.Y @ p) * fit.scaled_model) / np.sum(fit.scaled_model**2))
    residual = span.without(fit.tau) - bare @ theta
    freedom = max(len(residual) - span.rank - len(theta), 1)
    errors = scatter(influence, residual, fit.rows.groups, freedom)
    return (common + theta) / common, np.sqrt(np.diag(errors)) / common


class Saturation(UnknownEffect, DescribedEffect):
    """A recorded torque τ_r of which the joint gets τ = τ_r (1 − β (τ_r/τ_max)²).

    To first order in β, τ_r = Y p + β τ³/τ_max² with the torques τ of the model and their largest
    size τ_max, where the joint lacks the share β. In the contest β_2, β_4 of each drive as of
    `Readings`, with the columns τ_m u² and τ_m u⁴.
    """

    name = "torque-constant"
    corrects = "readings"
    deviation = 0.05
    is_of_parts = False  # how far motors are driven into saturation is no matter of tolerances
    kind = corrected_as = "torque-constant"
    is_contested = True
    unit = "%"
    text = "its torque constant falls with current: the joint lacks this at its largest torque"
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
        """Torque constants fall with current, and do not rise again beyond chance up to its peak:
        β_2 + 2 β_4 ≥ 0. Where they would, something else does."""
        pairs, count = values.reshape(-1, 2), len(values) // 2
        lacking, falling = pairs.sum(axis=1), np.kron(np.eye(count), [1.0, 2.0])
        deviation = np.sqrt(np.diag(falling @ covariance @ falling.T))
        rising = np.sum(np.minimum(falling @ values / deviation, 0.0) ** 2)
        falls = float(np.sum(lacking * np.abs(lacking))) >= 0.0
        return falls and surprise(float(rising), count) < SEEN

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
