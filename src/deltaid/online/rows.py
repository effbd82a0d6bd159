"""Rows as buses deliver them: late by parts of a cycle, not new, or such as cannot be.

Filters take rows on an even grid. With stamps, `elapsed` since the last new row, a row that was
taken δ after its cycle is put there by the parabola through it and the two rows before, its speed
by the straight line. δ is what stamps run ahead of cycles; the difference of both clocks, which is
slow, is forgotten. Stamps that leave the grid by half a cycle are a hole: all begins anew.

A row that is not new, or cannot be, is skipped: in its place the motion goes on with the same
acceleration, 3 q₁ − 3 q₂ + q₃, and the torques of the row before. By how much the next row is off
that, over a cycle, counts as noise of speeds for as long as filters remember it; so does what the
parabola makes of noise. Where nobody says whether a row is new, one that repeats the row before bit
for bit is not, if few rows do.
A row cannot be whose torque is ten times the largest that a drive takes or is limited to, or whose
position needs such a torque in all drives at once. What goes on for 20 ms ends the motion: filters
begin anew with what is read then.
"""

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.model.model import Model
from deltaid.online.graph import CycleFields, Field, chosen, every
from deltaid.online.instant import NOT_TOLD
from deltaid.online.settings import OnlineKnowledge, OnlineSettings

# Torques that no drive has, in units of its largest, and for how long rows are skipped at most [s].
_BEYOND, _LONGEST = 10.0, 0.02
# Rows repeat where nothing changes, and are new, if more than this share of so many did.
_REPEATS, _ROWS = 0.2, 20
# A jump is larger than what steps of a coarse encoder may look like [rad or m].
_COARSE = 1e-3
# Over which the clocks of stamps and of cycles are taken for one [s].
_CLOCKS = 1.0
# Rows of the past that a motion goes on from; positions behind a skipped one that still have a
# share of it, as differences and means do.
_PAST, _BEHIND = 3, 3


def even_rows(
    fields: CycleFields,
    u: dict[str, ca.SX],
    finite: ca.SX,
    model: Model,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    waiting: int,
) -> tuple[dict[str, ca.SX], ca.SX, ca.SX, ca.SX, ca.SX]:
    """Put rows on an even grid, and skip those that are not new or cannot be.

    Args:
        u: what is read.
        finite: 1 where all of it is.
        waiting: cycles for which signals wait.

    Returns:
        What is read, by field; 1 where the row is not used, as it is not new or cannot be; 1 where
        rows were skipped for too long, or behind a hole: all begins anew; 1 where no row that was
        skipped is in what the cycle uses; further noise of speeds by rows that were skipped or late
        [rad/s or m/s].
    """
    noise = ca.DM(np.array(settings.speed_noise or np.zeros(u["q"].numel())))
    h, dof, measured = settings.period, u["q"].numel(), "qd" in u
    names = ("q1", "q2", "q3", "tau1", "read", "off", *(("qd1", "qd2") if measured else ()))
    rows, missed, late, rests, repeating = fields.keep(
        Field("rows", 1, "rows in a row that were used, up to 3"),
        Field("missed", 1, "rows skipped in a row"),
        Field("late", 1, "by which the last row was taken after its cycle", "s"),
        Field("bridged", 1, "cycles in which a skipped row still has a share"),
        Field("repeating", 1, "share of rows that repeat the one before"),
    )
    past = fields.keep(*(Field(f"{name}_row", dof, "of rows before") for name in names))
    q1, q2, q3, tau1, read, off, *speeds = past
    has_past, elapsed, ahead = rows > _PAST - 0.5, u["elapsed"], 3 * q1 - 3 * q2 + q3
    stamped = elapsed > 0.5 * NOT_TOLD
    new = ca.logic_and(elapsed > 0, has_past)
    drift = late + elapsed - (missed + 1) * h
    hole = ca.logic_and(new, ca.fabs(drift) >= 0.5 * h)
    drift = ca.if_else(new, ca.if_else(hole, 0, drift * np.exp(-h / _CLOCKS)), late)
    at = ca.if_else(new, drift, 0.0)
    bend = ((u["q"] - q1) / (h + at) - (q1 - q2) / h) / (2 * h + at)
    q = chosen(new, 2 * q1 - q2 + 2 * h**2 * bend, u["q"])
    repeats = ca.sumsqr(u["q"] - read) + ca.sumsqr(u["tau"] - tau1) <= 0
    stale = every(has_past, repeats, repeating < _REPEATS)
    old = ca.logic_and(finite, ca.if_else(stamped, elapsed <= 0, stale))
    torque, jump = _bounds(model, known, settings)
    beyond = ca.logic_or(
        ca.mmax(ca.fabs(u["tau"]) / ca.SX(torque)) > 1,
        ca.mmax(ca.fabs(q - ahead) / ca.SX(jump)) > 1,
    )
    bad = ca.logic_or(old, every(finite, has_past, beyond))
    over = ca.logic_or(missed + 1 > max(_LONGEST / h, 1.0), ca.logic_not(has_past))
    anew = ca.logic_or(hole, ca.logic_and(bad, over))
    skipped = ca.logic_and(bad, ca.logic_not(anew))
    even = u | {"q": chosen(skipped, ahead, q), "tau": chosen(skipped, tau1, u["tau"])}
    behind = ca.logic_and(missed > 0, ca.logic_not(bad))
    # the parabola has a q + b q₁ + …, a and b of at: noise of a speed beyond that of differences
    a, b = 2 * h**2 / ((2 * h + at) * (h + at)), 2 * at / (h + at)
    stretched = ca.sqrt(ca.fmax(0.5 * (a**2 + (1 - b) ** 2) - 1, 0))
    found = chosen(behind, ca.fabs(q - ahead) / h, stretched * noise)
    off = ca.fmax(off * np.exp(-settings.corner * h), found)
    following = {
        "q1": even["q"],
        "q2": q1,
        "q3": q2,
        "tau1": even["tau"],
        "read": u["q"],
        "off": off,
    }
    if measured:
        qd1, qd2 = speeds
        qd = chosen(new, qd1 + (u["qd"] - qd1) * (h / (h + at)), u["qd"])
        even["qd"] = chosen(skipped, 2 * qd1 - qd2, qd)
        following |= {"qd1": even["qd"], "qd2": qd1}
    bridged = ca.if_else(skipped, float(waiting + _BEHIND), ca.fmax(rests - 1, 0))
    numbers = {  # a row that is not new is no past
        "rows": ca.if_else(anew, ca.if_else(old, 0, 1), ca.fmin(rows + 1, _PAST)),
        "missed": ca.if_else(skipped, missed + 1, 0),
        "late": drift,
        "bridged": bridged,
        "repeating": repeating + (ca.if_else(repeats, 1.0, 0.0) - repeating) / _ROWS,
    }
    fields.following |= numbers | {f"{name}_row": x for name, x in following.items()}
    fields.spoilt |= dict.fromkeys(numbers, ca.SX(0))
    fields.spoilt |= {f"{name}_row": x for name, x in zip(names, past, strict=True)}
    return even, ca.logic_or(skipped, old), ca.logic_or(anew, rows < 0.5), bridged < 0.5, off


def _bounds(
    model: Model, known: OnlineKnowledge, settings: OnlineSettings
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """Torque of each drive as it reports it, and by how much its position may be off what the rows
    before let expect, beyond which a row cannot be."""
    robot, largest = model.robot, known.largest.copy()
    for i, drive in enumerate(robot.drives):
        largest[i] = max(largest[i], robot.limits_of(drive).effort or 0.0)
    q = model.dynamics.kinematics.inverse(np.array(model.home))
    M = model.dynamics.terms(q, np.zeros_like(q), model.p).M
    bound = _BEYOND * largest
    jump = np.abs(np.linalg.inv(M)) @ bound * settings.period**2
    return bound / np.abs(model.gains), np.maximum(jump, _COARSE)
