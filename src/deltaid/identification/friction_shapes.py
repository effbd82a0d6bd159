"""How terms of friction laws depend on speed, as arrays: values, and slopes by their constants.

The same as `FrictionTerm.h` in `robot/friction.py`, which is made for graphs. A term of a joint is
its Coulomb column times φ(|v|); of a column of the regressor, speed and direction are known by the
viscous and the Coulomb column, also of joints that are no drives.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from deltaid.robot.friction import EXPONENTS, Friction
from deltaid.robot.friction_terms import FrictionTerm

Speeds = Float[np.ndarray, " *shape"]

# Which constants a term has beside its coefficient.
CONSTANTS: Mapping[str, tuple[str, ...]] = {
    "power": ("exponent",),
    "stribeck": ("speed", "exponent"),
    "hess_soom": ("speed",),
}
# Speeds below this [rad/s, m/s] count as rest.
_REST = 1e-9


def shape(term: FrictionTerm, v: Speeds) -> Speeds:
    """φ at speeds |v| ≥ 0, for terms that have constants."""
    if term.kind == "power":
        return (v + _REST) ** term.exponent
    x = v / term.speed
    return np.exp(-(x**term.exponent)) if term.kind == "stribeck" else 1 / (1 + x**2)


def slopes(term: FrictionTerm, v: Speeds) -> dict[str, Speeds]:
    """∂φ/∂ ln speed and ∂φ/∂ ln exponent, for those constants that a term has."""
    if term.kind == "power":
        v = v + _REST
        return {"exponent": term.exponent * np.log(v) * v**term.exponent}
    x = np.maximum(v / term.speed, _REST)
    if term.kind == "hess_soom":
        return {"speed": 2 * x**2 / (1 + x**2) ** 2}
    y = x**term.exponent
    steep = term.exponent * y * np.exp(-y)
    return {"speed": steep, "exponent": -steep * np.log(x)}


def moved(law: Friction, kind: str, name: str, step: float) -> Friction:
    """A law with one constant of a term multiplied by e^step, exponents within their limits."""
    part = getattr(law, kind)
    value = float(getattr(part, name) * np.exp(step))
    if name == "exponent":
        value = float(np.clip(value, *EXPONENTS))
    return law.changed(**{kind: part.changed(**{name: value})})
