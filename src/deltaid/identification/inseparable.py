"""Causes that a recording does not separate, and how far parameters may be off by them.

A constant of a drive's friction, by an offset or by Coulomb's friction of each direction, is the
same torque as an offset of what measures it: the truth lies anywhere between both. No limb ties a
telescope's drive to the others, and its torque constant scales all that it turns.
"""

from collections.abc import Iterator

from deltaid.identification.fit import FittedProblem
from deltaid.model.inseparable import Inseparable


def inseparable(problem: FittedProblem, *, absolute: bool) -> Iterator[Inseparable]:
    """Pairs of causes of a fit.

    Args:
        absolute: whether the scale of its torques is known.
    """
    if drives := tuple(constants(problem)):
        yield Inseparable(
            causes=("a constant of friction", "an offset of the measured torque"), subjects=drives
        )
    robot = problem.dynamics.robot
    if robot.telescope is not None and not absolute:
        last = robot.drives[-1]
        causes = f"inertia and friction that {last} turns", "its torque constant"
        yield Inseparable(causes=causes, is_counted=False)


def constants(problem: FittedProblem) -> dict[str, float]:
    """The part of each drive's friction that does not change its sign with the speed [N m or N].

    Only of drives whose law has one.
    """
    robot, names = problem.dynamics.robot, problem.layout.names
    values = dict(zip(names, problem.values.tolist(), strict=True))
    out = dict[str, float]()
    for drive in robot.drives:
        law = robot.friction.get(drive)
        if law is None:
            continue
        if law.offset is not None:
            out[drive] = values[f"offset.{drive}"]
        elif not law.both_ways:
            out[drive] = 0.5 * (values[f"coulomb.{drive}"] - values[f"coulomb_back.{drive}"])
    return out


def ambiguous(problem: FittedProblem) -> dict[str, float]:
    """By how much a parameter changes where these constants are offsets of what was measured."""
    moved = {"offset": -1.0, "coulomb": -1.0, "coulomb_back": 1.0}
    return {
        f"{kind}.{drive}": sign * constant
        for drive, constant in constants(problem).items()
        for kind, sign in moved.items()
    }
