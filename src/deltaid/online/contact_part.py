"""Contact as a part of the cycle: covariance of the residual, and what a cycle gives of it."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.mechanism import Mechanism
from deltaid.model.model import Model
from deltaid.online.contact import Contact, Residual, contact, threshold
from deltaid.online.cycle import Cycle, MorePart
from deltaid.online.graph import Given, Kept, Part
from deltaid.online.layout import Field
from deltaid.robot.description import RobotDescription

# A load that is let go may hang on for a moment: the share of it that may still be there falls with
# this time constant [s].
_HANGS_ON = 0.02
# Moments of a load that nobody told, as shares of the largest.
_ASIDE = 0.2
# A contact's time is counted up to here [s].
_FOREVER = 1e6
# While something pushes the robot, and filters remember it [s], nothing is learnt, for so long
# at most [s]: what stays is no push but something the model lacks, and estimates take it up.
_REMEMBERED, _LONGEST = 0.03, 1.0


# How much larger a residual is than expected, χ² of each drive, is learnt over [s] where it is
# larger and where it is smaller, from so much at most; what chance makes where all noise is known;
# and what is thought of speeds of unknown noise.
_GROWS, _FALLS, _MOST, _TOLERATED, _UNKNOWN = 2.0, 10.0, 25.0, 2.0, 9.0


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known of the residual before a cycle's own is used, as expressions.

    Attributes:
        z: pose.
        residual: filtered torque beyond the model's and beyond all that is estimated.
        columns: what it shows of the states that are estimated, δ × n, with
        covariance: of these.
        dry: filtered size of torques that no speed tells.
        mass: of the load held, in units of the largest one.
        lifted: columns of the load, the mass first, one for each entry's largest size.
        partly: of a load that was taken or let go just now, in the same units, what may be there.
        told: 1 where the gripper tells what it holds.
        lacking: size of torques that the model has not.
        live: 1 where the residual's filter has forgotten what it began with.
        M: mass matrix, with the load.
    """

    z: ca.SX
    residual: ca.SX
    columns: ca.SX
    covariance: ca.SX
    dry: ca.SX
    mass: ca.SX
    partly: ca.SX
    lifted: ca.SX
    told: ca.SX
    lacking: ca.SX
    live: ca.SX
    M: ca.SX


@dataclass(frozen=True)
class ContactSettings:
    """What a contact is judged with.

    Attributes:
        false_alarms: accepted in an hour.
        noise: standard deviation of one cycle's torque, drive by drive [N m or N].
        speed_noise: of one cycle's speed, drive by drive [rad/s or m/s]; None if it is not known.
        corner: K of the filter [1/s].
        period: of a cycle [s].
    """

    false_alarms: float
    noise: Float[np.ndarray, " drives"]
    speed_noise: Float[np.ndarray, " drives"] | None
    corner: float
    period: float

    @property
    def threshold(self) -> float:
        """u."""
        return threshold(self.false_alarms, self.corner, len(self.noise))


def residual_of(
    robot: RobotDescription, mechanism: Mechanism, e: Expected, settings: ContactSettings
) -> Residual:
    """The residual with its covariance: of what is estimated, of torques that the model has not,
    of torque noise behind the filter, and of noise of speeds in the momentum, K M v."""
    behind = e.lacking**2 + settings.noise**2 * (0.5 * settings.corner * settings.period)
    untold = 1 - e.told
    aside = ca.horzcat(e.lifted[:, 1:] * (_ASIDE * untold), e.lifted[:, 0] * e.partly)
    S = e.columns @ e.covariance @ e.columns.T + ca.diag(behind) + aside @ aside.T
    if settings.speed_noise is not None:
        speeds = settings.corner * e.M @ ca.diag(ca.DM(settings.speed_noise))
        S += speeds @ speeds.T
    T = mechanism.speeds.inverse_jacobian[robot.task.moves, :]
    levers = ca.Function("levers", [mechanism.z], [T])(e.z)
    return Residual(
        value=e.residual,
        covariance=S,
        bound=e.dry,
        levers=levers,
        lifted=e.lifted[:, 0],
        light=-e.mass * untold,
        heavy=(1 - e.mass) * untold,
    )


def contact_part(
    robot: RobotDescription, mechanism: Mechanism, e: Expected, settings: ContactSettings
) -> tuple[Contact, Part]:
    """Contact of one cycle, and the fields that it keeps and gives."""
    since, excess = ca.SX.sym("contact_time"), ca.SX.sym("excess")
    known = settings.speed_noise is not None
    larger = ca.fmax(excess / (_TOLERATED if known else 1.0), 1.0)
    residual = residual_of(robot, mechanism, e, settings)
    residual = replace(residual, covariance=residual.covariance * larger)
    seen = contact(residual, ca.if_else(since > 0, 1.0, 0.0), settings.threshold, e.live)
    lasts = ca.if_else(seen.found > 0.5, ca.fmin(since + settings.period, _FOREVER), 0.0)
    rests = ca.SX.sym("contact_rests")
    pushed = ca.logic_and(seen.found > 0.5, lasts < _LONGEST)
    waits = ca.if_else(pushed, _REMEMBERED, ca.fmax(rests - settings.period, 0.0))
    moves, dof = residual.levers.shape
    found = ca.fmin((seen.size * settings.threshold) ** 2 * larger / dof, _MOST)
    falls = _FALLS if known else 2 * _FALLS  # what is guessed is left slowly
    memory = ca.if_else(found > excess, _GROWS, falls)
    learns = ca.logic_and(e.live, seen.found < 0.5)
    learnt = excess + settings.period / memory * learns * (found - excess)
    unit = "N" if all(robot.is_linear(drive) for drive in robot.drives) else "N m"
    kept = (
        Kept(Field("contact_time", 1, "since a contact began, 0 without", "s"), since, lasts),
        Kept(Field("contact_rests", 1, "for which nothing is learnt yet", "s"), rests, waits),
        Kept(
            Field("excess", 1, "how much larger residuals are", initial=1 if known else _UNKNOWN),
            excess,
            learnt,
        ),
    )
    given = (
        Given(Field("contact", 1, "1 while there is a contact"), seen.found),
        Given(Field("contact_size", 1, "size of the residual, 1 at the threshold"), seen.size),
        Given(
            Field("contact_limb", 1, "drive whose limb is touched, 0 the platform, -1 no contact"),
            seen.limb,
        ),
        Given(Field("contact_force", moves, "force on the platform point", "N"), seen.force),
        Given(Field("contact_effort", dof, "torque from outside on each drive", unit), seen.effort),
        Given(
            Field(
                "contact_information",
                moves * moves,
                "A: along a unit vector n a force of (u + 1.645) / sqrt(n' A n) is found",
            ),
            ca.vec(seen.information),
        ),
    )
    return seen, Part(kept, given)


def standard_parts(model: Model) -> tuple[MorePart, ...]:
    """What a cycle looks for beside loads and friction: contacts, where the model is identified.

    Without the intervals of an identification nothing says what is a contact.
    """
    return () if model.identified is None else (contact_of,)


def contact_of(cycle: Cycle) -> Part:
    """The part of a cycle that looks for contact.

    Torques that the model has not are no longer than their own time taken for what they are: so
    they are left in the residual, and their whole size is in its covariance.
    """
    s, e, known, settings = cycle.signals, cycle.estimates, cycle.known, cycle.settings
    model, n = cycle.model, s.columns.shape[1]
    x = e.before.x[:n]
    partly, hung = _partly(cycle, ca.fmax(x[0], 0))
    noise = settings.speed_noise
    expected = Expected(
        z=s.z,
        residual=s.residual - s.columns @ x,
        columns=s.columns,
        covariance=e.before.P[:n, :n],
        dry=s.dry,
        mass=x[0],
        partly=partly,
        lifted=s.columns[:, s.at_load],
        told=ca.if_else(s.gripper > -0.5, 1.0, 0.0),
        lacking=e.lacking,
        live=s.settled,
        M=_mass_matrix(cycle, x),
    )
    of = ContactSettings(
        settings.false_alarms,
        known.noise,
        None if noise is None else np.array(noise),
        settings.corner,
        settings.period,
    )
    _, part = contact_part(model.robot, model.dynamics.kinematics.mechanism, expected, of)
    return Part((*part.kept, hung), part.given)


def _partly(cycle: Cycle, mass: ca.SX) -> tuple[ca.SX, Kept]:
    """How much of a load may be there that the gripper says is not, or not yet known, and what is
    kept for that.

    Args:
        mass: of the load held, in units of the largest one.
    """
    e, hung = cycle.estimates, ca.SX.sym("hangs_on")
    expected = ca.if_else(cycle.signals.gripper > 0.5, 1.0, mass)
    let_go = ca.logic_and(e.changed, ca.logic_not(e.held))
    left = ca.if_else(let_go, mass, hung * np.exp(-cycle.settings.period / _HANGS_ON))
    field = Field("hangs_on", 1, "of the load let go last, what may still be there")
    return ca.if_else(e.differs, expected, hung), Kept(field, hung, left)


def _mass_matrix(cycle: Cycle, x: ca.SX) -> ca.SX:
    """Of the robot with the load that is held, x in units of its largest entries."""
    momentum, known, model = cycle.signals.momentum, cycle.known, cycle.model
    p, first = ca.SX(model.p), model.layout.body(known.entries.body).start
    for i, k in enumerate(known.entries.shown):
        p[first + k] += known.load_scales[i] * x[i]
    M = ca.Function("M", [momentum.z, momentum.p], [momentum.M])
    return M(cycle.signals.z, p)
