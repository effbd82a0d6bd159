"""Constant torques of drives of identical limbs.

They are friction that differs by direction, or offsets of the measured torques. Their mean looks
like weight of all limbs, so a recording may neither show nor exclude it. With a column of this mean
beside all others, its size κ is κ̂ ± s by rows, and 0 ± σ by its prior:

    κ ~ N(ρ κ̂, ρ s²),    ρ = σ² / (σ² + s²),    odds = exp(ρ (κ̂/s)²/2) √(1 − ρ)

for it is as likely as not to be there, or certain where another drive has a constant. Intervals
count the root of P(κ ≠ 0) E[κ²], and what parameters lose by it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import expit

from deltaid.effects.joint import ONE_WAY, FrictionJoint, of_term, one_way
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Explanation, LinearProblem, Rows
from deltaid.identification.friction_rows import FrictionRows, Variant, options
from deltaid.levels import HARDLY, UNLIKELY
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import FrictionTerm
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
    others = _others(rows, terms)
    constant = rows.columns([(joint, one_way) for joint in joints]).sum(axis=1)
    constant = np.pad(constant, (0, len(others.b) - len(constant)))
    prior = ONE_WAY * float(np.mean(rows.points[0].coulomb(joints)))
    mean, deviation, probability = _size(others, constant, prior)
    if any(robot.friction[joint.name].has_constant for joint in joints):
        probability = 1.0
    if probability < UNLIKELY:
        return {}
    size = float(np.sqrt(probability) * np.hypot(mean, deviation))
    active, response = active_columns(rows.dynamics), -size * others.span.coefficients(constant)
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


def _others(rows: FrictionRows, terms: Sequence[FrictionTerm]) -> LinearProblem:
    """All other columns: those of the rows and of added terms. Measured values that active columns
    determine are rows too: a scale knows weight."""
    added = rows.columns([(rows.joints[term.joint], of_term(term)) for term in terms])
    columns = np.hstack([rows.drive_rows.stack(rows.Y), added, rows.extra])
    active = active_columns(rows.dynamics)
    idle = np.delete(np.arange(len(rows.dynamics.layout.names)), active)
    known = [w for w in weighings(rows.dynamics.robot) if not np.any(w.coefficients[idle])]
    facts = np.zeros((len(known), columns.shape[1]))
    for fact, weighing in zip(facts, known, strict=True):
        fact[: len(active)] = weighing.coefficients[active] / weighing.std
    values = [weighing.value / weighing.std for weighing in known]
    problem = LinearProblem(columns, rows.tau, rows.drive_rows.groups)
    return problem.with_known(facts, np.array(values))


def _size(others: LinearProblem, column: Rows, prior: float) -> tuple[float, float, float]:
    """Mean and standard deviation of a column's coefficient beside others, and the probability that
    it is not zero."""
    beside = others.span.without(column)
    length = float(np.linalg.norm(beside))
    if length <= HARDLY * np.linalg.norm(column):
        return 0.0, prior, 0.5
    U, residual = beside[:, None] / length, others.span.without(others.b)
    shown = Explanation.by_columns(U, residual, others.groups, others.span.rank)
    squared = shown.level / length**2
    share = prior**2 / (prior**2 + squared)
    odds = 0.5 * (share * shown.gain / shown.level + np.log1p(-share))
    mean = share * float(U[:, 0] @ residual) / length
    return mean, float(np.sqrt(share * squared)), float(expit(odds))
