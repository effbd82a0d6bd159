"""What a body's change is: a load that weighs as it resists acceleration, a shift, or a force."""

import numpy as np
from jaxtyping import Float

from deltaid.effects.effect import Cause
from deltaid.effects.load_search import shown_of
from deltaid.estimation.problem import scatter
from deltaid.levels import FAINT, SURE
from deltaid.robot.inertia import INERTIA_NAMES

# Gravity and acceleration of one mass agree, those of a force are unrelated: a load is what is
# nearer to the first.
_NEARER = 0.5


def changes_of(cause: Cause) -> dict[str, float]:
    """Change of each parameter of the carrier from the first to the second of two states: of "m",
    its mass [kg], and of the others that torques determine."""
    alone = cause.fit.span.without(cause.first.columns)
    change = np.linalg.lstsq(alone, cause.fit.tau, rcond=FAINT)[0].tolist()
    # A candidate by its mass alone has only the first column.
    shown = shown_of(cause.fit, cause.first.words)[: len(change)]
    return dict(zip(shown, change, strict=True))


def shifts(cause: Cause) -> bool:
    """Whether the change is no load that comes and goes: for its moments, its mass would have to be
    farther away than a limb reaches."""
    change, limbs = changes_of(cause), cause.fit.dynamics.robot.limbs
    if limbs is None:
        return False
    reach = max(limb.strut for limb in limbs.geometry())
    moment = np.linalg.norm([change.get(name, 0.0) for name in INERTIA_NAMES[1:4]])
    inertia = max(abs(change.get(name, 0.0)) for name in INERTIA_NAMES[4:])
    return bool(max(moment, inertia / reach) > reach * abs(change["m"]))


def is_weight(cause: Cause) -> bool:
    """Whether it weighs what it resists acceleration by, as far as the recording determines both.

    A force that comes and goes may look like either, hardly like both.
    """
    (weight, inertia), covariance = weighed(cause)
    apart = abs(weight - inertia)
    deviation = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1])
    return bool(apart < max(SURE * deviation, _NEARER * max(abs(weight), abs(inertia))))


def weighed(cause: Cause) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]:
    """The change of the mass by gravity alone and by acceleration alone [kg], beside all other
    causes, and their covariance."""
    fit, (mass, *others) = cause.fit, cause.first.columns.T
    dynamics, name = fit.dynamics, f"{cause.first.words}.m"
    kilogram = (np.array(dynamics.layout.names) == name).astype(float)
    at_rest = fit.trace.filtered(
        lambda w: dynamics.torque(w.z, 0.0 * w.qd, 0.0 * w.qdd, kilogram).T, np.arange(fit.dof)
    )
    whole = fit.rows.of_drives(fit.rows.stack(fit.column(name)))
    along = np.sum(fit.rows.of_drives(mass) * whole, axis=0)
    course = along / np.maximum(np.sum(whole**2, axis=0), np.finfo(float).tiny)
    weight = fit.rows.stack(at_rest) * np.tile(course, fit.dof)
    bare = cause.others.without(np.stack([weight, mass - weight, *others], axis=1))
    influence = np.linalg.pinv(bare, rcond=FAINT).T
    theta = influence.T @ fit.tau
    residual = cause.others.without(fit.tau) - bare @ theta
    freedom = max(len(residual) - cause.others.rank - len(theta), 1)
    return theta[:2], scatter(influence, residual, fit.rows.groups, freedom)[:2, :2]
