"""When a load was taken or left: told by the gripper, or found by itself.

Over a short window that forgets, innovations ν_k (residual less all that was expected) say how much
more mass there is than was thought, Δ = η / Λ with

    η ← γ η + ψᵀW ν,   Λ ← γ Λ + ψᵀW ψ,   ψ the mass's column.

If nothing changed, η has the variance Λ₂ + SᵀP S, with Λ₂ ← γ² Λ₂ + ψᵀW ψ by noise and
S ← γ S + (all columns)ᵀW ψ by what is not known (covariance P) of model, friction and load. A
change is one that is many of these deviations away, is worth a load, and explains more than half
of the window's innovations; a push in another direction does not. Bounded memory, no list of
onsets: with a window of 30 ms what is lost is less than that.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.online.graph import Kept
from deltaid.online.layout import Field

# Memory of the window [s].
_WINDOW = 0.03
# Share of the innovations that a mass has to explain.
_EXPLAINED = 0.5
# Share of the information that is used while the window speaks for a change.
_DOUBTED = 0.02
# Of the load held, what may be left after a release.
_LEFT = 0.5


@dataclass(frozen=True, eq=False)
class Window:
    """The window of one cycle.

    Attributes:
        mass: Δ, in units of the largest mass.
        score: by how many deviations it differs from 0.
        explained: share of the innovations that it explains.
        kept: fields of the state.
    """

    mass: ca.SX
    score: ca.SX
    explained: ca.SX
    kept: tuple[Kept, ...]


def window(
    rows: ca.SX, innovations: ca.SX, variances: ca.SX, P: ca.SX, period: float, anew: ca.SX
) -> Window:
    """One cycle of the window.

    Args:
        rows: what each drive shows of the states, the mass first; δ × n.
        innovations: ν of each drive.
        variances: of their noise.
        P: covariance of the states.
        anew: 1 where it begins anew behind this cycle.
    """
    n, gamma = rows.shape[1], float(np.exp(-period / _WINDOW))
    eta, info, square, power = (ca.SX.sym(name) for name in ("eta", "info", "square", "power"))
    cross = ca.SX.sym("cross", n)
    weighed = rows[:, 0] / variances
    parts = {
        "window_mass": (eta, gamma * eta + ca.dot(weighed, innovations)),
        "window_information": (info, gamma * info + ca.dot(weighed, rows[:, 0])),
        "window_noise": (square, gamma**2 * square + ca.dot(weighed, rows[:, 0])),
        "window_power": (power, gamma * power + ca.dot(innovations / variances, innovations)),
        "window_cross": (cross, gamma * cross + rows.T @ weighed),
    }
    kept = tuple(
        Kept(Field(name, now.numel(), "window in which a change of load is looked for"), symbol,
             now * (1 - anew), symbol * 0)
        for name, (symbol, now) in parts.items()
    )  # fmt: skip
    eta, info, square, power, cross = (now for _, now in parts.values())
    S = ca.densify(cross)
    deviation = ca.sqrt(square + ca.dot(S, P @ S) + 1e-12)
    explained = eta * eta / (info * power + 1e-12)
    return Window(eta / (info + 1.0), eta / deviation, explained, kept)


@dataclass(frozen=True, eq=False)
class Change:
    """What is held behind a cycle.

    Attributes:
        changed: 1 where it is another load, or none, from now on.
        held: 1 while a load is held.
        trust: share of this cycle's information that is used.
        kept: fields of the state.
    """

    changed: ca.SX
    held: ca.SX
    trust: ca.SX
    kept: tuple[Kept, ...]


def change(
    seen: Window,
    held: ca.SX,
    gripper: ca.SX,
    mass: ca.SX,
    spread: ca.SX,
    least: float,
    alarm: float,
    grip_time: float,
    period: float,
) -> Change:
    """Whether the load changes.

    Args:
        held: 1 where a load was held in the cycle before.
        gripper: 1 holds, 0 empty, -1 not told.
        mass, spread: of the load held, in units of the largest mass.
        least: mass that is looked for, in the same units.
        alarm: score of a change.
        grip_time: [s] from the gripper's signal to the change.
    """
    waited = ca.SX.sym("waited")
    told, wanted = gripper > -0.5, gripper > 0.5
    differs = ca.logic_and(told, wanted != held)
    waiting = ca.if_else(differs, waited + period, 0)
    by_gripper = ca.logic_and(differs, waiting > grip_time)
    clear = ca.logic_and(seen.explained > _EXPLAINED, ca.logic_not(told))
    more = ca.logic_and(clear, ca.logic_and(seen.score > alarm, seen.mass > least))
    less = ca.logic_and(clear, ca.logic_and(seen.score < -alarm, seen.mass < -least))
    less = ca.logic_and(less, held)
    nothing = ca.logic_and(ca.logic_and(held, ca.logic_not(told)), mass + 2 * spread < least)
    left = ca.logic_and(less, mass + seen.mass > ca.fmax(_LEFT * mass, least))
    now = ca.if_else(ca.logic_or(nothing, less), left, ca.logic_or(held, more))
    now = ca.if_else(by_gripper, wanted, ca.if_else(told, held, now))
    changed = ca.logic_or(by_gripper, ca.logic_or(more, ca.logic_or(less, nothing)))
    doubt = ca.logic_and(ca.fabs(seen.score) > 0.5 * alarm, ca.logic_not(told))
    trust = ca.if_else(differs, 0.0, ca.if_else(doubt, _DOUBTED, 1.0))
    since = Field("waited", 1, "time since the gripper's signal", "s")
    kept = (
        Kept(Field("held", 1, "1 while a load is held"), held, now),
        Kept(since, waited, waiting * (1 - by_gripper)),
    )
    return Change(changed, now, trust, kept)
