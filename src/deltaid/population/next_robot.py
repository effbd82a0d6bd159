"""A description of the next robot of a type: bodies' priors and how far robots are from them."""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import inertia_scale
from deltaid.dynamics.prior import with_prior
from deltaid.population.member import unmeasured
from deltaid.population.result import Population
from deltaid.population.widths import widest
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES
from deltaid.robot.load import save_yaml

# Digits of a spread: three.
_DIGITS = 3


def next_robot(found: Population, fleet: str) -> RobotDescription:
    """The type as a description whose priors are its mean, and whose bodies' spreads are what is
    open of the mean and what robots differ by together.

    Spreads of entries are independent in a description, and are as wide as that asks for
    (`widths`). Measured values are in the mean, and left out. Friction has the type's mean and the
    fit's own spread.

    Args:
        fleet: where the robots come from, for `sources`.
    """
    p, spreads = found.mean.value, _spreads(found)
    data = with_prior(unmeasured(found.robot), p).model_dump()
    for name, own in spreads.items():
        if data["bodies"][name]["free"]:
            data["bodies"][name]["spread"] = own
    count = sum(one.belongs for one in found.members)
    robots = f"{count} robot{'s' if count > 1 else ''} of {fleet}"
    text = f"mean of {robots}; spreads are of the next robot; deltaid {version('deltaid')}"
    friction = {"friction": f"mean of {robots}"} if data["friction"] else {}
    rotors = {"rotor_inertia": f"mean of {robots}"} if data["rotor_inertia"] else {}
    bodies = {f"bodies.{name}": text for name in found.layout.bodies}
    kept = {
        key: value
        for key, value in found.robot.sources.items()
        if key.split(".")[0] not in ("bodies", "friction", "rotor_inertia", "measured")
    }
    data["sources"] = kept | bodies | friction | rotors
    return RobotDescription.model_validate(data)


def save_next(found: Population, fleet: str, path: Path) -> None:
    """Write that description, whole or not at all.

    Raises:
        DeltaidError: it cannot be written.
    """
    save_yaml(next_robot(found, fleet), path)


def _spreads(found: Population) -> dict[str, dict[str, float]]:
    """Of each body's entries, as shares of their sizes in the new description."""
    coordinates, layout = found.coordinates, found.layout
    n = coordinates.size
    of_bodies = [one.kind == "inertia" for one in coordinates.reduction.variables]
    at = np.flatnonzero(of_bodies)
    covariance = found.covariance + np.diag(found.variance)
    Q = np.linalg.inv(covariance[:n, :n][np.ix_(at, at)])
    T = coordinates.to_p[:, at]
    changed = np.flatnonzero(np.any(T != 0, axis=1))
    sizes = np.linalg.norm(T[changed], axis=1)
    std = sizes / np.sqrt(widest(Q, T[changed] / sizes[:, None]))
    spreads = dict(zip(changed.tolist(), std.tolist(), strict=True))
    result: dict[str, dict[str, float]] = {}
    for body in layout.bodies:
        part = layout.body(body)
        scale = inertia_scale(_reduced(found.robot, body, found.mean.value[part]))
        result[body] = {
            name: _short(spreads[part.start + k] / scale[k])
            for k, name in enumerate(INERTIA_NAMES)
            if part.start + k in spreads
        }
    return {body: own for body, own in result.items() if own}


def _reduced(
    robot: RobotDescription, body: str, p: Float[np.ndarray, " 10"]
) -> Float[np.ndarray, " 10"]:
    """A body's prior as the fit will have it."""
    return robot.bodies[body].changed(prior=ExplicitInertia.of(p)).reduced_prior()


def _short(value: float) -> float:
    """Rounded up, so that nothing is claimed that is not known."""
    unit = 10.0 ** (np.floor(np.log10(value)) - _DIGITS + 1)
    return float(f"{np.ceil(value / unit) * unit:.{_DIGITS + 1}g}")


def summary(found: Population) -> Sequence[str]:
    """The type in a few lines: robots, spreads, those that do not belong."""
    belong = [one for one in found.members if one.belongs]
    lines = [f"{len(found.members)} robots, {len(belong)} of the type", *found.told]
    if found.spreads.known:
        deviation = np.sqrt(np.diag(found.spreads.covariance))
        for kind, log, std, there in zip(
            found.spreads.kinds, found.spreads.log, deviation, found.spreads.there, strict=True
        ):
            low = np.exp(log - 1.96 * std) if there else 0.0
            lines.append(
                f"{kind}: robots differ by {np.exp(log):.1%} "
                f"({low:.1%} to {np.exp(log + 1.96 * std):.1%})"
            )
    lines += [f"{one.name}: {one.reason}" for one in found.members if one.reason]
    return lines
