"""Rows on an even grid: late ones are moved, repeated and impossible ones skipped.

Rows arrive as buses deliver them: late by parts of a cycle, repeated, or impossible. Filters need
an even grid. With stamps, `elapsed` since the last new row, a row that was taken δ after its cycle
is moved to the grid by the parabola through it and the two rows before, its speed by a straight
line. δ is the lead of stamps over cycles; the slow drift between both clocks is forgotten. Stamps
that leave the grid by half a cycle are a gap: all filters begin anew.

A repeated or impossible row is skipped: the motion continues with the same acceleration,
3 q₁ − 3 q₂ + q₃, and with the previous torques. The deviation of the next row from this motion,
over a period, counts as noise of speeds for as long as filters remember it; so does noise that the
parabola amplifies. Without stamps, a row that repeats the previous one bit for bit is not new, if
few rows repeat. A row is impossible if its torque exceeds ten times a drive's largest torque or
limit, whichever is more, or if its position needs such a torque in all drives at once. If this
lasts for 20 ms, filters begin anew with the present rows.
"""

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.model.model import Model
from deltaid.online.graph import CycleFields, Field, chosen, every
from deltaid.online.instant import UNKNOWN
from deltaid.online.settings import MOST_STALE, OnlineKnowledge, OnlineSettings
from deltaid.recording.masks.stuck import NO_TORQUE
from deltaid.recording.survey_checks import ENCODER_NOISE

# Longest time of skipped rows [s].
_LONGEST_SKIP = 0.02
# Rows over which the share of repeats is averaged: above `MOST_STALE` nothing changes, and repeated
# rows are new.
_ROWS = 20
# Time constant in which the drift between the clocks of stamps and cycles is forgotten [s].
_CLOCKS = 1.0
# Number of past rows that a motion is extrapolated from; differences and means of as many rows
# after a skipped one contain it.
_PAST = 3


def even_rows(
    fields: CycleFields,
    u: dict[str, ca.SX],
    finite: ca.SX,
    model: Model,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    waiting: int,
) -> tuple[dict[str, ca.SX], ca.SX, ca.SX, ca.SX, ca.SX]:
    """Move rows to an even grid, and skip repeated and impossible ones.

    Args:
        u: inputs.
        finite: 1 where all of them are.
        waiting: delay of signals, in cycles.

    Returns:
        Inputs by field; 1 where the row is skipped; 1 where filters begin anew, after rows were
        skipped for too long or after a gap; 1 where the cycle uses no skipped row; additional noise
        of speeds by skipped or late rows [rad/s or m/s].
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
    stamped = elapsed > 0.5 * UNKNOWN
    new = ca.logic_and(elapsed > 0, has_past)
    drift = late + elapsed - (missed + 1) * h
    hole = ca.logic_and(new, ca.fabs(drift) >= 0.5 * h)
    drift = ca.if_else(new, ca.if_else(hole, 0, drift * np.exp(-h / _CLOCKS)), late)
    at = ca.if_else(new, drift, 0.0)
    bend = ((u["q"] - q1) / (h + at) - (q1 - q2) / h) / (2 * h + at)
    q = chosen(new, 2 * q1 - q2 + 2 * h**2 * bend, u["q"])
    repeats = ca.sumsqr(u["q"] - read) + ca.sumsqr(u["tau"] - tau1) <= 0
    stale = every(has_past, repeats, repeating < MOST_STALE)
    old = ca.logic_and(finite, ca.if_else(stamped, elapsed <= 0, stale))
    torque, jump = _bounds(model, known, settings)
    beyond = ca.logic_or(
        ca.mmax(ca.fabs(u["tau"]) / ca.SX(torque)) > 1,
        ca.mmax(ca.fabs(q - ahead) / ca.SX(jump)) > 1,
    )
    bad = ca.logic_or(old, every(finite, has_past, beyond))
    over = ca.logic_or(missed + 1 > max(_LONGEST_SKIP / h, 1.0), ca.logic_not(has_past))
    anew = ca.logic_or(hole, ca.logic_and(bad, over))
    skipped = ca.logic_and(bad, ca.logic_not(anew))
    even = u | {"q": chosen(skipped, ahead, q), "tau": chosen(skipped, tau1, u["tau"])}
    behind = ca.logic_and(missed > 0, ca.logic_not(bad))
    # The parabola is a q + b q₁ + …: noise of a speed in addition to the differences' noise.
    a, b = 2 * h**2 / ((2 * h + at) * (h + at)), 2 * at / (h + at)
    stretched = ca.sqrt(ca.fmax(0.5 * (a**2 + (1 - b) ** 2) - 1, 0))
    added = chosen(behind, ca.fabs(q - ahead) / h, stretched * noise)
    off = ca.fmax(off * np.exp(-settings.corner * h), added)
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
    bridged = ca.if_else(skipped, float(waiting + _PAST), ca.fmax(rests - 1, 0))
    numbers = {  # a repeated row is not extrapolated from
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
    """Bounds of possible rows: reported torque of each drive, and deviation of its position from
    the extrapolated one."""
    efforts = [model.robot.limits_of(drive).effort or 0.0 for drive in model.robot.drives]
    bound = NO_TORQUE * np.maximum(known.largest, efforts)
    q = model.dynamics.kinematics.inverse(np.array(model.home))
    M = model.dynamics.terms(q, np.zeros_like(q), model.p).M
    jump = np.abs(np.linalg.inv(M)) @ bound * settings.period**2
    return bound / np.abs(model.gains), np.maximum(jump, ENCODER_NOISE)
