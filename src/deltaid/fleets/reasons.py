"""Text on the deviation of a robot that does not belong, or of its friction."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deltaid.fleets.belonging import AgainstOthers, Along, torques
from deltaid.fleets.coordinates import Coordinates
from deltaid.fleets.mixed_model import U

# Explanations that gain so much less than the best are as good; one more coefficient costs so much.
_CLOSE, _COST = 2.0, 4.0
# What holds tools and loads.
_CARRIERS = ("P", "EE")


@dataclass(frozen=True, eq=False)
class _Cause:
    """Something that may be different: the variables `at` of a body or joint, or all torques."""

    at: tuple[int, ...]
    owner: str
    part: Along

    @property
    def gain(self) -> float:
        """By how much the distance falls, less the cost of its coefficients."""
        return self.part.gain - _COST * self.part.rank


def reason(robot: AgainstOthers, coordinates: Coordinates, m: U, naming: float) -> str:
    """What is different in a robot that does not belong.

    Args:
        robot: against the others.
        m: mean of the type.
    """
    causes = list(_causes(robot, coordinates, m))
    best = max(causes, key=lambda cause: cause.gain)
    close = [cause for cause in causes if cause.gain >= best.gain - _CLOSE]
    chosen = close[-1] if best.at else best
    others = [cause for cause in close if cause.owner != chosen.owner]
    text = _described(chosen, coordinates)
    if others:
        text += f", or {_described(max(others, key=lambda cause: cause.gain), coordinates)}"
    distance = max(robot.distance - chosen.part.gain, 0.0)
    if robot.chance(distance, robot.rows - chosen.part.rank) < naming:
        return f"it is unlike the others in more than one place, most of all {text}: another type?"
    if not chosen.at:
        return f"{text}: torque constants, gear ratio or unit of torques?"
    carried = chosen.owner in _CARRIERS
    return text + (": another tool, or a load that is not declared?" if carried else "")


def _causes(robot: AgainstOthers, coordinates: Coordinates, m: U) -> Iterator[_Cause]:
    """Torques as a whole, single entries, and whole bodies; platform and tool last."""
    variables, rigid = coordinates.reduction.variables, ~coordinates.is_friction
    yield _Cause((), "", robot.along(torques(robot, coordinates, m)[:, None]))
    single = [(k,) for k in range(coordinates.size) if rigid[k]]
    single.sort(key=lambda at: (variables[at[0]].owner in _CARRIERS,
                                coordinates.kinds[at[0]] == "mass"))  # fmt: skip
    bodies = [tuple(at) for at in coordinates.owners().values() if len(at) > 1 and rigid[at[0]]]
    for at in (*single, *bodies):
        yield _Cause(at, variables[at[0]].owner, robot.along(robot.H[:, at]))


def _described(cause: _Cause, coordinates: Coordinates) -> str:
    values, stds = cause.part.values, cause.part.stds
    if not cause.at:
        return f"its torques are {1 + values[0]:.3f} ± {stds[0]:.3f} times the type's"
    k = int(np.argmax(np.abs(values) / np.where(stds > 0, stds, np.inf)))
    variable, size = coordinates.reduction.variables[cause.at[k]], coordinates.sizes[cause.at[k]]
    off = f"{abs(values[k]) * size:.3g} ± {stds[k] * size:.2g} {variable.unit}"
    return f"{variable.name} is {off} {'more' if values[k] > 0 else 'less'} than in the type"


def friction_reason(
    robot: AgainstOthers, coordinates: Coordinates, m: U, naming: float
) -> tuple[list[int], str]:
    """Variables and text of the joint whose friction deviates most; none if none does."""
    joints: dict[str, list[int]] = {}
    for k in np.flatnonzero(coordinates.is_friction):
        joints.setdefault(coordinates.reduction.variables[k].owner, []).append(int(k))
    candidates: list[tuple[float, list[int], str]] = []
    for joint, at in joints.items():
        off = robot.along(robot.H[:, at])
        k = int(np.argmax(np.abs(off.values)))
        times, name = (1 + off.values[k] / m[at[k]], coordinates.reduction.variables[at[k]].symbol)
        text = f"{name} friction of {joint} is {times:.2f} times the type's"
        candidates.append((len(joints) * robot.chance(off.gain, off.rank), at, text))
    chance, at, text = min(candidates, default=(1.0, [], ""), key=lambda entry: entry[0])
    return (at, text) if chance < naming else ([], "")
