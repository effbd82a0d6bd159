"""Detect contacts of the robot: significance, place and force.

The residual ρ is the difference of measured and model torques through a filter of corner K
(`online.momentum`); external forces put −ρ on the drives. Without contact,

    ρ ~ N(0, S) + d,   |d_i| ≤ b_i,

where b is friction that the speed does not determine, at rest and at reversals, and S is the sum of
the validation residual, noise of speeds, and the uncertainty of model and load. b is subtracted
first, ρ_i → sign(ρ_i) max(|ρ_i| − b_i, 0), and

    χ² = ρᵀ S⁻¹ ρ,   contact where χ > u.

After the filter χ is the length of an Ornstein–Uhlenbeck process: it exceeds a high u about
K u f(u) times a second, with f the density of χ with one degree of freedom per drive. So u follows
from the accepted rate of false alarms, and correlated samples do not count twice.

Without a gripper's signal, the likeliest load within the payload is subtracted first, and the place
is determined with that load as noise.

A contact is at drive i's limb if that drive's torque alone explains ρ, otherwise at the platform.
The smallest force on the platform along a unit vector n that is detected in 95 % of cases is
(u + 1.645) / √(nᵀ A n) with A = T S⁻¹ Tᵀ and T = ∂(platform point)/∂q, if the load is known.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.stats import chi, chi2, norm

from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.errors import within
from deltaid.estimation.scatter import NORMAL
from deltaid.mechanism.rotation import reciprocal

# Largest ratio of static to Coulomb friction.
_BREAKAWAY = 1.3
# A contact continues while χ is above this share of the threshold.
_HOLDS = 0.5
# Probability of detection of the smallest force: the level of intervals, 95 %.
_SURE = 2 * norm.cdf(NORMAL) - 1
# A limb explains a residual if the rest of χ² is below this quantile plus this share of it.
_EXPLAINED, _SHARE = 0.7, 0.002
# Allowed rates of false alarms [1/h].
FALSE_ALARMS = (1e-6, 1e3)


def threshold(false_alarms: float, corner: float, dof: int) -> float:
    """Threshold u of χ for a contact.

    Args:
        false_alarms: accepted rate [1/h].
        corner: K [1/s].
        dof: number of drives.

    Raises:
        DeltaidError: the number is not within `FALSE_ALARMS`.
    """
    within("false alarms an hour", false_alarms, FALSE_ALARMS)

    def excess(u: float) -> float:
        return float(np.log(3600.0 * corner * u / false_alarms) + chi.logpdf(u, dof))

    # f falls beyond √dof, and with it the rate.
    return float(brentq(excess, np.sqrt(dof + 1.0), 40.0))


def least_force(
    information: Float[np.ndarray, "samples moves moves"], u: float
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Smallest force [N] detected in 95 % of cases, along the best and the worst direction.

    Args:
        information: A of each sample.
        u: threshold.
    """
    eigenvalues = np.linalg.eigvalsh(information)
    needed = u + norm.ppf(_SURE)
    with np.errstate(divide="ignore", invalid="ignore"):
        return needed / np.sqrt(eigenvalues[:, -1]), needed / np.sqrt(eigenvalues[:, 0])


@dataclass(frozen=True)
class ContactResidual:
    """A residual with its distribution at one instant, as expressions.

    Attributes:
        value: ρ, one entry per drive.
        covariance: S.
        bound: b.
        levers: T, directions of the platform point × drives.
        lifted: filtered torque of an additional unit of mass.
        light, heavy: bounds of the mass that a load without a signal may add.
    """

    value: ca.SX
    covariance: ca.SX
    bound: ca.SX
    levers: ca.SX
    lifted: ca.SX
    light: ca.SX
    heavy: ca.SX


@dataclass(frozen=True)
class Contact:
    """Contact estimate from a residual, as expressions.

    Attributes:
        size: χ / u; a contact where it is above 1.
        detected: 1 during a contact, else 0.
        limb: drive whose limb is pushed, from 1 on; 0 for the platform, −1 without a contact.
        force: on the platform, if that is pushed [N].
        effort: external torque on each drive [N m or N].
        information: A.
    """

    size: ca.SX
    detected: ca.SX
    limb: ca.SX
    force: ca.SX
    effort: ca.SX
    information: ca.SX


def contact(
    residual: ContactResidual, before: ca.SX, u: float, live: ca.SX | float = 1.0
) -> Contact:
    """Contact estimate of a residual.

    Args:
        before: whether there was a contact in the previous cycle.
        u: threshold.
        live: 0 where the filter has no history, so that nothing is detected.
    """
    r, T, bound = residual, residual.levers, _BREAKAWAY * residual.bound
    dof = bound.numel()
    # χ of ρ without the likeliest unsignalled load. Undetermined friction counts as noise of size
    # b: where all joints rest the load is hardly known.
    weighted = cholesky_solve(r.covariance + ca.diag(bound * bound), r.lifted)
    share = ca.dot(weighted, r.lifted)
    mass = ca.dot(weighted, r.value) * share / (share * share + 1e-30)
    beyond = _outside(r.value - r.lifted * ca.fmin(ca.fmax(mass, r.light), r.heavy), bound)
    solved = cholesky_solve(r.covariance, ca.horzcat(beyond, T.T))
    length, information = ca.dot(beyond, solved[:, 0]), T @ solved[:, 1:]
    size = ca.if_else(live, ca.sqrt(ca.fmax(length, 0.0)) / u, 0.0)
    detected = ca.if_else(size > ca.if_else(before > 0.5, _HOLDS, 1.0), 1.0, 0.0)
    # The place, with an unsignalled load as noise: subtracting the likeliest load would subtract a
    # part of a push as well.
    whole = r.lifted * (r.heavy - r.light)
    rho = _outside(r.value, bound)
    solved = cholesky_solve(r.covariance + whole @ whole.T, ca.horzcat(rho, T.T, ca.SX.eye(dof)))
    weighted, of_levers, inverse = solved[:, 0], solved[:, 1 : 1 + T.shape[0]], solved[:, -dof:]
    force = -cholesky_solve(T @ of_levers, T @ weighted)
    limb = _limb(weighted, inverse, ca.dot(rho, weighted))
    return Contact(
        size=size,
        detected=detected,
        limb=ca.if_else(detected > 0.5, limb, -1.0),
        force=ca.if_else(ca.logic_and(detected > 0.5, limb < 0.5), force, 0.0),
        effort=-rho,
        information=information,
    )


def _outside(x: ca.SX, bound: ca.SX) -> ca.SX:
    return ca.fmax(x - bound, 0.0) + ca.fmin(x + bound, 0.0)


def _limb(weighted: ca.SX, inverse: ca.SX, squared: ca.SX) -> ca.SX:
    """The drive, from 1 on, whose torque alone explains a residual; 0 if none does."""
    dof = weighted.numel()
    best, limb = ca.SX(0.0), ca.SX(0.0)
    for i in range(dof):
        explained = weighted[i] * weighted[i] * reciprocal(inverse[i, i])
        limb = ca.if_else(explained > best, i + 1.0, limb)
        best = ca.fmax(explained, best)
    usual = float(chi2.ppf(_EXPLAINED, max(dof - 1, 1)))
    return ca.if_else(squared - best < usual + _SHARE * squared, limb, 0.0)
