"""Slow adaptation of the drives' friction, with what physics asks of it kept.

Coefficients are states of the estimate (`load`): they move only as far as residuals tell, forget
towards the covariance of their prior and not towards zero, so without motion nothing happens. They
stay within a share of what was identified and never fall below zero. Friction h(v) with such
coefficients takes energy from the robot at any speed, and mass matrix and Coriolis matrix with a
consistent load keep M positive definite and Ṁ − 2C skew. That is what is claimed: the model that
runs is passive at any instant. While coefficients change, energy may flow, slowly; no passivity of
a whole loop is claimed.
"""

import casadi as ca
import numpy as np

from deltaid.model.model import Model
from deltaid.online.graph import Given, Part
from deltaid.online.knowledge import Knowledge
from deltaid.online.layout import Field

Bounds = tuple[tuple[float, ...], tuple[float, ...]]

# An offset is near zero, so it may move by so many deviations.
_DEVIATIONS = 3.0


def friction_bounds(model: Model, known: Knowledge, share: float) -> Bounds:
    """Lowest and highest deviation of each followed coefficient, in units of `friction_std`."""
    low, high = [], []
    for k, std in zip(known.followed, known.friction_std, strict=True):
        parameter, value = model.layout.parameters[k], float(model.p[k])
        reach = _DEVIATIONS * std if parameter.signed else share * abs(value)
        low.append((max(parameter.low, value - reach) - value) / std)
        high.append((min(parameter.high, value + reach) - value) / std)
    return tuple(low), tuple(high)


def friction_part(model: Model, known: Knowledge, x: ca.SX, bounds: Bounds) -> Part:
    """The followed coefficients as an output.

    Args:
        x: their deviations behind a cycle.
    """
    x = ca.fmin(ca.fmax(x, ca.SX(bounds[0])), ca.SX(bounds[1]))
    names = ", ".join(model.layout.names[k] for k in known.followed)
    value = ca.SX(model.p[list(known.followed)]) + ca.SX(np.array(known.friction_std)) * x
    field = Field("friction", len(known.followed), f"coefficients: {names}")
    return Part((), (Given(field, value),))
