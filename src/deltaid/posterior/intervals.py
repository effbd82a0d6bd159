"""Intervals of parameters from models drawn from the posterior, which feel edges of consistency."""

import numpy as np

from deltaid.model.model import load
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel
from deltaid.posterior.draw import draw

# Models that quantiles are taken of: the ends of an interval are then off by some 3 % of its width.
_MODELS = 8000
_ENDS = (0.025, 0.975)


def with_posterior_intervals(model: IdentifiedModel) -> IdentifiedModel:
    """The model with intervals and deviations of its parameters as drawn models have them.

    What is held has no spread, and keeps what it had. Labels, base parameters, loads and friction
    curves stay.

    Raises:
        IdentificationError: draws could not be trusted.
    """
    p = draw(load(model), _MODELS).p
    low, high = np.quantile(p, _ENDS, axis=0)
    deviation = p.std(axis=0)
    parameters = tuple(
        _told(parameter, float(low[i]), float(high[i]), float(deviation[i]))
        for i, parameter in enumerate(model.parameters)
    )
    settings = model.settings.changed(intervals="posterior")
    return model.changed(parameters=parameters, settings=settings)


def _told(parameter: Parameter, low: float, high: float, deviation: float) -> Parameter:
    if low == high:
        return parameter
    low, high = min(low, parameter.value), max(high, parameter.value)
    return parameter.changed(low=low, high=high, std=deviation)
