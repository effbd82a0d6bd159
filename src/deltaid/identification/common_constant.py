"""Constant torques of drives of identical limbs.

They are friction that differs by direction, or offsets of the measured torques. Their mean looks
like weight of all limbs, so a recording may neither show nor exclude it. With a column of this mean
beside all others, its size κ is κ̂ ± s by rows, and 0 ± σ by its prior:

    κ ~ N(ρ κ̂, ρ s²),    ρ = σ² / (σ² + s²),    odds = exp(ρ (κ̂/s)²/2) √(1 − ρ)

for it is as likely as not to be there, or certain where another drive has a constant. Intervals
count the root of P(κ ≠ 0) E[κ²], and what parameters lose by it.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int
from scipy.special import expit

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import ONE_WAY, FrictionJoint, of_term, one_way
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Columns, Explanation, Rows, Span
from deltaid.identification.friction_rows import FrictionRows, Variant, options
from deltaid.levels import HARDLY, UNLIKELY
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.sensors.weighings import weighings


def missing_offsets(rows: FrictionRows, laws: Mapping[str, Friction]) -> list[Variant]:
    """Offsets of drives of identical limbs without a constant, where a chosen law of another has
    one."""
    robot = rows.dynamics.robot
    drives, now = robot.identical_drives, dict(robot.friction) | dict(laws)
    missing = {drive for drive in drives if drive in now and not now[drive].has_constant}
    if not set(drives) & laws.keys() - missing:
        return []
    offsets = [variants[0] for variants in options(rows) if variants[0].kind == "offset"]
    return [variant for variant in offsets if variant.joint.name in missing]


def undetected_constant(rows: FrictionRows, robot: RobotDescription) -> dict[str, float]:
    """Changes of parameters, by name, by one standard deviation of the common constant, with the
    drives' offsets; empty where it is detected or almost excluded (99 %).

    Args:
        robot: with the chosen friction laws.
    """
    joints = _alike(rows)
    if all(robot.friction[joint.name].has_constant for joint in joints):
        return {}
    described = set(rows.dynamics.robot.friction_terms)
    terms = [term for term in robot.friction_terms if term not in described]
    added = rows.columns([(rows.joints[term.joint], of_term(term)) for term in terms])
    facts, known = _measured(rows.dynamics)
    columns = np.hstack([rows.drive_rows.stack(rows.Y), added, rows.extra])
    facts = np.pad(facts, ((0, 0), (0, columns.shape[1] - facts.shape[1])))
    others = Span.of_columns(np.vstack([columns, facts]))
    column = rows.columns([(joint, one_way) for joint in joints]).sum(axis=1)
    column, tau = np.append(column, np.zeros(len(known))), np.append(rows.tau, known)
    own = rows.drive_rows.groups
    groups = np.append(own, own.max() + 1 + np.arange(len(known)))
    prior = ONE_WAY * float(np.mean(rows.points[0].coulomb(joints)))
    mean, deviation, probability = _size(others, column, tau, groups, prior)
    if any(robot.friction[joint.name].has_constant for joint in joints):
        probability = 1.0
    if probability < UNLIKELY:
        return {}
    size = float(np.sqrt(probability) * np.hypot(mean, deviation))
    active, response = active_columns(rows.dynamics), -size * others.coefficients(column)
    p = np.zeros(len(rows.dynamics.layout.names))
    p[active] = response[: len(active)]
    moves = rows.dynamics.layout.named(p)
    moves |= zip((term.name for term in terms), response[len(active) :].tolist(), strict=False)
    for joint in joints:
        offset = f"offset.{joint.name}"
        moves[offset] = moves.get(offset, 0.0) + size
    return moves


def of_laws(moves: Mapping[str, float], robot: RobotDescription) -> dict[str, float]:
    """Changes of parameters with those of offsets as the robot's laws have them: by direction where
    each direction has its own friction."""
    changed = dict(moves)
    for drive, law in robot.friction.items():
        if not law.both_ways:
            constant = changed.pop(f"offset.{drive}", 0.0)
            for name, sign in (f"coulomb.{drive}", 1.0), (f"coulomb_back.{drive}", -1.0):
                changed[name] = changed.get(name, 0.0) + sign * constant
    return changed


def _alike(rows: FrictionRows) -> list[FrictionJoint]:
    """The drives of identical limbs that have friction."""
    drives = rows.dynamics.robot.identical_drives
    return [rows.joints[drive] for drive in drives if drive in rows.joints]


def _measured(dynamics: Dynamics) -> tuple[Columns, Rows]:
    """Rows of the active columns for measured values that these determine, in units of their
    standard deviations: a scale knows weight."""
    active = active_columns(dynamics)
    others = np.delete(np.arange(len(dynamics.layout.names)), active)
    facts = [f for f in weighings(dynamics.robot) if not np.any(f.coefficients[others])]
    rows = [fact.coefficients[active] / fact.std for fact in facts]
    return np.reshape(rows, (len(facts), len(active))), np.array([f.value / f.std for f in facts])


def _size(
    others: Span, column: Rows, tau: Rows, groups: Int[np.ndarray, " rows"], prior: float
) -> tuple[float, float, float]:
    """Mean and standard deviation of a column's coefficient beside others, and the probability that
    it is not zero."""
    beside = others.without(column)
    length = float(np.linalg.norm(beside))
    if length <= HARDLY * np.linalg.norm(column):
        return 0.0, prior, 0.5
    U, residual = beside[:, None] / length, others.without(tau)
    shown = Explanation.by_columns(U, residual, groups, others.rank)
    squared = shown.level / length**2
    share = prior**2 / (prior**2 + squared)
    odds = 0.5 * (share * shown.gain / shown.level + np.log1p(-share))
    mean = share * float(U[:, 0] @ residual) / length
    return mean, float(np.sqrt(share * squared)), float(expit(odds))
