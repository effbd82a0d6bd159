"""In words what is different in a robot that does not belong, or in its friction."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.population.belonging import Along, LeftOut, torques
from deltaid.population.coordinates import Coordinates

# Explanations that gain so much less than the best are as good; one more coefficient costs so much.
_CLOSE, _COST = 2.0, 4.0


@dataclass(frozen=True, eq=False)
class _Cause:
    """Something that may be different.

    Attributes:
        name: 'torques', or a variable or body.
        at: variables, if it is some.
        found: how far the robot is off along it.
    """

    name: str
    at: tuple[int, ...]
    found: Along

    @property
    def gain(self) -> float:
        """By how much the distance falls, less the cost of its coefficients."""
        return self.found.gain - _COST * self.found.rank

    def owner(self, coordinates: Coordinates) -> str:
        """Body or joint; empty for all torques."""
        return coordinates.reduction.variables[self.at[0]].owner if self.at else ""


def reason(
    one: LeftOut, coordinates: Coordinates, m: Float[np.ndarray, " u"], naming: float
) -> str:
    """What is different in a robot that does not belong.

    Args:
        one: the robot against the others.
        m: mean of the type.
    """
    causes = list(_causes(one, coordinates, m))
    best = max(causes, key=lambda cause: cause.gain)
    close = [cause for cause in causes if cause.gain >= best.gain - _CLOSE]
    chosen = close[-1] if best.name != "torques" else best
    others = [cause for cause in close if cause.owner(coordinates) != chosen.owner(coordinates)]
    text = _told(chosen, coordinates)
    if others:
        text += f", or {_told(max(others, key=lambda cause: cause.gain), coordinates)}"
    left = one.distance - chosen.found.gain
    if one.chance(max(left, 0.0), one.rows - chosen.found.rank) < naming:
        return f"it is unlike the others in more than one place, most of all {text}: another type?"
    return f"{text}{_hint(chosen, coordinates)}"


def _causes(one: LeftOut, coordinates: Coordinates, m: Float[np.ndarray, " u"]) -> Iterator[_Cause]:
    """Torques as a whole, single entries, and whole bodies; platform and tool last."""
    yield _Cause("torques", (), one.along(torques(one, coordinates, m)[:, None]))
    order = sorted(
        (k for k in range(coordinates.size) if not coordinates.is_friction[k]),
        key=lambda k: (coordinates.reduction.variables[k].owner in ("P", "EE"),
                       coordinates.kinds[k] == "mass"),
    )  # fmt: skip
    for k in order:
        yield _Cause(coordinates.reduction.names[k], (k,), one.along(one.H[:, [k]]))
    for owner, at in coordinates.owners().items():
        if len(at) > 1 and not coordinates.is_friction[at[0]]:
            yield _Cause(owner, tuple(at), one.along(one.H[:, at]))


def _told(cause: _Cause, coordinates: Coordinates) -> str:
    if cause.name == "torques":
        gain, std = cause.found.values[0], cause.found.stds[0]
        return f"its torques are {1 + gain:.3f} ± {std:.3f} times the type's"
    z = np.abs(cause.found.values) / np.where(cause.found.stds > 0, cause.found.stds, np.inf)
    k = int(np.argmax(z))
    variable, size = coordinates.reduction.variables[cause.at[k]], coordinates.sizes[cause.at[k]]
    value, std = cause.found.values[k] * size, cause.found.stds[k] * size
    more = "more" if value > 0 else "less"
    return (
        f"{variable.name} is {abs(value):.3g} ± {std:.2g} {variable.unit} {more} than in the type"
    )


def _hint(cause: _Cause, coordinates: Coordinates) -> str:
    if cause.name == "torques":
        return ": torque constants, gear ratio or unit of torques?"
    owner = coordinates.reduction.variables[cause.at[0]].owner
    return ": another tool, or a load that is not declared?" if owner in ("P", "EE") else ""


def friction_reason(
    one: LeftOut, coordinates: Coordinates, m: Float[np.ndarray, " u"], naming: float
) -> tuple[list[int], str]:
    """Variables of the joint whose friction is least like the type's, and what of it; none if all
    are alike."""
    joints: dict[str, list[int]] = {}
    for k in np.flatnonzero(coordinates.is_friction):
        joints.setdefault(coordinates.reduction.variables[k].owner, []).append(int(k))
    found: list[tuple[float, list[int], str]] = []
    for joint, at in joints.items():
        own = one.along(one.H[:, at])
        chance, values = len(joints) * one.chance(own.gain, own.rank), own.values
        k = int(np.argmax(np.abs(values)))
        times = 1 + values[k] / m[at[k]]
        name = coordinates.reduction.variables[at[k]].symbol
        found.append((chance, at, f"{name} friction of {joint} is {times:.2f} times the type's"))
    chance, at, text = min(found, default=(1.0, [], ""), key=lambda each: each[0])
    return (at, text) if chance < naming else ([], "")
