"""Recorded torques of drives that are off by a factor: a wrong torque constant or gear ratio."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, from_mean, of_own_drives
from deltaid.estimation.problem import scatter
from deltaid.levels import SURE
from deltaid.model.verdict import listed, percent

# A drive's factor is odd where it differs from the median by at least this, by this share of the
# largest difference, and by more than its uncertainty.
_ODD, _BESIDE = 0.01, 0.25
# Singular values of factors below this share count as zero: a common factor is not identifiable.
_SHOWN = 1e-4


class Gain(UnknownEffect, DescribedEffect):
    """A factor for one drive's torque, or for each.

    In the contest τ_m,i = (1 + g_i) τ_i with Σ g_i = 0 over the drives of limbs: a common factor
    is not identifiable.
    """

    kind = "drive-gain"
    name = "gain"
    deviation = 0.03
    likeliest = "a torque constant, rated torque or gear that differs from the mapping"
    fix = (
        "check torque constants and gears of these drives' torque columns; one recording "
        "determines only ratios of gains, a second one with a known load determines each"
    )

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        count = max(len(point.dynamics.robot.identical_drives), 1)
        ratios = np.zeros((point.dof, count - 1))
        ratios[:count] = from_mean(count)
        return of_own_drives(point.model[:, :, None]) @ ratios

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        return self.of_each(fit.drives, fit.rows.per_drive(fit.scaled_model))

    def subject(self, cause: Cause) -> str:
        odd = list(odd_gains(cause))
        return listed(odd) if len(odd) < len(cause.fit.drives) else ""

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        gains = odd_gains(cause)
        sizes = [
            f"{drive}'s {'torque is ' if k == 0 else ''}{percent(abs(gain))} too "
            f"{'large' if gain > 0 else 'small'}"
            for k, (drive, gain) in enumerate(gains.items())
        ]
        reference = "the other drives'" if len(gains) == 1 else "the mean of the limbs' drives"
        return 100 * max(gains.values(), key=abs), "%", f"{listed(sizes)} relative to {reference}"


def odd_gains(cause: Cause) -> dict[str, float]:
    """By which share the torques are too large of each drive whose factor differs from others'.

    A single drive is compared with the others, several with the mean of the limbs' drives, since a
    common factor is not identifiable.
    """
    fit, drives = cause.fit, cause.fit.drives
    named = {part.candidate.subject for part in cause.detected}
    factor, deviation = _factors(cause)
    apart = np.abs(factor / np.median(factor) - 1.0)
    least = np.maximum(SURE * deviation, max(_ODD, _BESIDE * float(apart.max())))
    odd = [drives.index(drive) for drive in named] if named != {""} and len(named) == 1 else []
    odd = odd or np.flatnonzero(apart > least).tolist() or [int(np.argmax(apart))]
    if len(odd) == 1:
        others = np.delete(factor, odd[0])
        return {drives[odd[0]]: float(factor[odd[0]] / np.median(others) - 1.0)}
    limbs = fit.dynamics.robot.limbs
    gains = factor / np.mean(factor[: limbs.count if limbs else None]) - 1.0
    clear = np.flatnonzero(np.abs(gains) > np.maximum(SURE * deviation, _ODD))
    return {drives[i]: float(gains[i]) for i in clear}


def _factors(cause: Cause) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
    """Each drive's recorded torque over the model's, up to a common factor, and its deviation."""
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
