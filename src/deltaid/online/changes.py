"""When a load was taken or left: told by the gripper, or found by itself.

A load that changes by Δ at a time θ moves the filter's innovations by G Δ and its estimates by F Δ,

    G = ψ − h F,   F ← F + gain · G,   F = 0 at θ,

for a measurement with the row h that shows the change by ψ: by the load's filtered column, less
what the filters remember of it from before θ, when nothing was there. Innovations ν are white with
variances s as long as nothing changed, so

    D = Σ G ν / s,   C = Σ G² / s,   score D / √C,   Δ = D / C  with variance 1 / C

is the likelihood ratio of a change at θ, whatever the filter has made of it since (Willsky and
Jones). A few times θ are kept in turn, so memory and work are bounded. When one is believed, what
the change did to the other estimates is taken back, and the load begins with Δ.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.online.graph import Field, StateField
from deltaid.online.kalman import Estimate
from deltaid.online.onsets import Onset
from deltaid.online.settings import OnlineSettings

# Of the load held, what may be left after a release.
_LEFT = 0.6
# A change must be likely for so long, in time constants of the filter: it does not show all of it
# at first.
_CONFIRMED = 1.0
# A load that may be none, and is surely less than this share of the largest, is none.
_SMALL = 0.05
# The variance of what a change begins with is larger than 1/C by this factor, and by the square of
# this share of it: its onset is a guess, and of a load that is taken while the robot moves filters
# show little at first. So it is nearly free as well, by this share of the mass's prior variance.
_WIDER, _ROUGH, _FREE = 4.0, 0.5, 0.05


@dataclass(frozen=True, eq=False)
class Change:
    """What is held behind a cycle.

    Attributes:
        changed: 1 where it is another load, or none, from now on.
        held: 1 while a load is held.
        told: 1 where the gripper told the change.
        seen: 1 where the change was found in residuals.
        kept: fields of the state.
    """

    changed: ca.SX
    held: ca.SX
    told: ca.SX
    seen: ca.SX
    kept: tuple[StateField, ...]


def gripper_differs(held: ca.SX, gripper: ca.SX) -> ca.SX:
    """1 where the gripper has told something else than what is held."""
    return ca.logic_and(gripper > -0.5, (gripper > 0.5) != held)


def judge_change(
    seen: Onset,
    held: ca.SX,
    gripper: ca.SX,
    mass: ca.SX,
    spread: ca.SX,
    least: float,
    settings: OnlineSettings,
) -> Change:
    """Whether the load changes.

    Args:
        held: 1 where a load was held in the cycle before.
        gripper: 1 holds, 0 empty, -1 not told.
        mass, spread: of the load held, in units of the largest mass.
        least: mass that is looked for, in the same units.
    """
    waited, alert = ca.SX.sym("waited"), ca.SX.sym("alert")
    silent, wanted, differs = gripper <= -0.5, gripper > 0.5, gripper_differs(held, gripper)
    waiting = ca.if_else(differs, waited + settings.period, 0)
    by_gripper = ca.logic_and(differs, waiting > settings.grip_time)
    score, size = seen.score, seen.size
    more = ca.logic_and(silent, ca.logic_and(score > settings.alarm, size > least))
    less = ca.logic_and(silent, ca.logic_and(score < -settings.alarm, size < -least))
    less = ca.logic_and(less, held)
    alerted = ca.if_else(ca.logic_or(more, less), alert + settings.period, 0)
    sure = alerted > _CONFIRMED / settings.corner
    more, less = ca.logic_and(more, sure), ca.logic_and(less, sure)
    small = ca.logic_and(mass < 2 * spread, mass + 2 * spread < ca.fmax(least, _SMALL))
    nothing = ca.logic_and(ca.logic_and(held, silent), small)
    left = ca.logic_and(less, mass + size > ca.fmax(_LEFT * mass, least))
    now = ca.if_else(ca.logic_or(nothing, less), left, ca.logic_or(held, more))
    now = ca.if_else(by_gripper, wanted, ca.if_else(silent, now, held))
    changed = ca.logic_or(by_gripper, ca.logic_or(more, ca.logic_or(less, nothing)))
    since = Field("waited", 1, "time since the gripper's signal", "s")
    kept = (
        StateField(Field("held", 1, "1 while a load is held"), held, now),
        StateField(since, waited, waiting * (1 - by_gripper)),
        StateField(
            Field("alert", 1, "time for which a change was likely", "s"),
            alert,
            alerted * (1 - sure),
        ),
    )
    return Change(changed, now, by_gripper, ca.logic_or(more, less), kept)


def estimate_after(estimate: Estimate, seen: Onset, change: Change, n_load: int) -> Estimate:
    """Estimates behind a cycle in which the load may have changed.

    Told by the gripper, nothing is known of a new load. Found by itself, it begins with the mass
    that was found, and what the change had done to the other estimates is taken back:

        x ← x − F Δ,   P ← P + F Fᵀ / C.
    """
    n = estimate.x.numel()
    mine = ca.vertcat(ca.SX.ones(n_load), ca.SX.zeros(n - n_load))
    by_itself = change.seen
    mass = ca.fmax(estimate.x[0] + (1 - seen.moved[0]) * seen.size, 0) * by_itself * change.held
    variance = _WIDER / (seen.information + 1.0) + (_ROUGH * seen.size) ** 2
    others = ca.vertcat(ca.SX(n_load, 1), seen.moved[n_load:]) * by_itself
    first = ca.vertcat(change.held * by_itself, ca.SX(n - 1, 1))
    along = ca.densify(first - others) * ca.sqrt(variance)
    x = estimate.x * (1 - mine * change.changed) - others * seen.size + first * mass
    kept = 1 - mine * change.changed
    own = change.told + _FREE * change.seen
    fresh = ca.vertcat(own, ca.SX.ones(n_load - 1), ca.SX.zeros(n - n_load))
    fresh = fresh * (change.changed * change.held)
    P = estimate.P * (kept @ kept.T) + ca.diag(fresh) + along @ along.T
    return Estimate(x, ca.tril2symm(ca.tril(P)))
