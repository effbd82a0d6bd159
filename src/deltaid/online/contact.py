"""Whether somebody or something pushes the robot: how surely, where, and how hard.

The residual ρ is what the measured torques have beyond the model's, through a filter of corner K
(`online.momentum`); outside forces put −ρ on the drives. Without any,

    ρ ~ N(0, S) + d,   |d_i| ≤ b_i,

where b is friction that no speed tells, at rest and where joints turn round, and S is the sum of
what validation left, noise of speeds, the model's uncertainty and that of the load. b is taken out
first, ρ_i → sign(ρ_i) max(|ρ_i| − b_i, 0), and

    χ² = ρᵀ S⁻¹ ρ,   contact where χ > u.

Behind the filter χ is the length of an Ornstein–Uhlenbeck process: it exceeds a high u about
K u f(u) times a second, f the density of χ with as many degrees of freedom as there are drives.
So u follows from how many false alarms an hour are accepted, and neighbouring samples, which say
the same thing, do not count twice.

Where nobody tells what is held, the likeliest load within the payload is taken out before, and the
place is looked for with that load as noise.

A contact is at drive i's limb if that drive's torque alone explains ρ, at the platform if not.
The smallest force on the platform along a unit vector n that is told, in 95 of 100 cases, is
(u + 1.645) / √(nᵀ A n) with A = T S⁻¹ Tᵀ and T = ∂(platform point)/∂q, where it is told what is
held.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.stats import chi, chi2, norm

from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.errors import within
from deltaid.mechanism.rotation import reciprocal

# Friction at rest may exceed Coulomb friction, by so much at most.
_BREAKAWAY = 1.3
# A contact goes on while χ is above this share of the threshold.
_HOLDS = 0.5
# How sure a force is found that counts as one that can be told.
_SURE = 0.95
# A limb explains a residual if what it leaves is below this quantile of noise, or this share of χ².
_EXPLAINED, _SHARE = 0.7, 0.002
# False alarms an hour that may be asked for.
FALSE_ALARMS = (1e-6, 1e3)


def threshold(false_alarms: float, corner: float, dof: int) -> float:
    """u: how large χ must be for a contact.

    Args:
        false_alarms: accepted in an hour.
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
    """Smallest force [N] told in 95 % of cases: along the best and along the worst direction.

    Args:
        information: A, one a sample.
        u: threshold.
    """
    eigenvalues = np.linalg.eigvalsh(information)
    needed = u + norm.ppf(_SURE)
    with np.errstate(divide="ignore", invalid="ignore"):
        return needed / np.sqrt(eigenvalues[:, -1]), needed / np.sqrt(eigenvalues[:, 0])


@dataclass(frozen=True)
class ContactResidual:
    """What is known of a residual at one instant, as expressions.

    Attributes:
        value: ρ, a column with one entry a drive.
        covariance: S.
        bound: b.
        levers: T, directions of the platform point × drives.
        lifted: filtered torque of a kilogram more, and
        light, heavy: the least and the most that an untold load may add to the mass.
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
    """What a residual says, as expressions.

    Attributes:
        size: χ / u; a contact where it is above 1.
        found: 1 while there is a contact, else 0.
        limb: drive whose limb is pushed, from 1 on; 0 for the platform, −1 without a contact.
        force: on the platform, if it is that that is pushed [N].
        effort: on each drive, from outside [N m or N].
        information: A.
    """

    size: ca.SX
    found: ca.SX
    limb: ca.SX
    force: ca.SX
    effort: ca.SX
    information: ca.SX


def contact(
    residual: ContactResidual, before: ca.SX, u: float, live: ca.SX | float = 1.0
) -> Contact:
    """Judge a residual.

    Args:
        before: whether there was a contact a cycle ago.
        u: threshold.
        live: 0 where the filter has no past, so that nothing can be told.
    """
    r, T, bound = residual, residual.levers, _BREAKAWAY * residual.bound
    dof = bound.numel()
    # χ of ρ beyond the likeliest load that nobody told and friction that no speed tells, the latter
    # as noise of size b: where all joints rest the load is hardly known, and b hides what is left.
    weighted = cholesky_solve(r.covariance + ca.diag(bound * bound), r.lifted)
    share = ca.dot(weighted, r.lifted)
    mass = ca.dot(weighted, r.value) * share / (share * share + 1e-30)
    beyond = _outside(r.value - r.lifted * ca.fmin(ca.fmax(mass, r.light), r.heavy), bound)
    solved = cholesky_solve(r.covariance, ca.horzcat(beyond, T.T))
    length, information = ca.dot(beyond, solved[:, 0]), T @ solved[:, 1:]
    size = ca.if_else(live, ca.sqrt(ca.fmax(length, 0.0)) / u, 0.0)
    found = ca.if_else(size > ca.if_else(before > 0.5, _HOLDS, 1.0), 1.0, 0.0)
    # The place, with a load that nobody told as noise: taking out the likeliest one would take out
    # a part of a push as well.
    whole = r.lifted * (r.heavy - r.light)
    rho = _outside(r.value, bound)
    solved = cholesky_solve(r.covariance + whole @ whole.T, ca.horzcat(rho, T.T, ca.SX.eye(dof)))
    weighted, of_levers, inverse = solved[:, 0], solved[:, 1 : 1 + T.shape[0]], solved[:, -dof:]
    force = -cholesky_solve(T @ of_levers, T @ weighted)
    limb = _limb(weighted, inverse, ca.dot(rho, weighted))
    return Contact(
        size=size,
        found=found,
        limb=ca.if_else(found > 0.5, limb, -1.0),
        force=ca.if_else(ca.logic_and(found > 0.5, limb < 0.5), force, 0.0),
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
    left = float(chi2.ppf(_EXPLAINED, max(dof - 1, 1)))
    return ca.if_else(squared - best < left + _SHARE * squared, limb, 0.0)
