"""Weights of rows other than torques: sensors by their observed noise, facts by their stated one.

The fit weighs each drive by its largest torque, and σ̂ is the noise as a share of that. A sensor's
channel counts as 1 of what makes its own noise σ̂ too: its residual's root mean square over σ̂,
by turns with the residual (iterated generalised least squares). A fact cᵀp = v ± σ has the row
(σ̂/σ) [c, v]. Then all rows have the noise σ̂, and (15) is as probable as it was.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.information import Information
from deltaid.estimation.objective import noise_level
from deltaid.identification.gathering import Gathered
from deltaid.sensors.weighings import Weighing

# Rounds at most, and the relative step below which levels have settled.
_ROUNDS, _SETTLED = 30, 1e-3


def balanced(gathered: Gathered, weighings: Sequence[Weighing]) -> Gathered:
    """The same with channels of sensors weighted by their noise, and with weighings."""
    information = gathered.information
    if not (information.channels or weighings):
        return gathered
    sigma = max(noise_level(information), NOISE_FLOOR)
    rows = [
        sigma / fact.std * np.append(fact.over(information.columns), fact.value)
        for fact in weighings
    ]
    facts = np.reshape(rows, (len(rows), len(information.columns) + 1))
    levels = _levels(replace(information, facts=facts), sigma)
    return replace(gathered, levels=levels, facts=facts)


def _levels(information: Information, sigma: float) -> Float[np.ndarray, " channels"]:
    """What each channel counts as 1 of."""
    channels = slice(information.drives.stop, None)
    largest = information.torque_max[channels]
    levels = largest.copy()
    for _ in range(_ROUNDS if information.channels else 0):
        now = replace(information, levels=levels)
        residual = np.linalg.norm(now.factors @ np.append(-now.problem.x, 1.0), axis=1)
        # Each channel's share of the degrees of freedom that the fit takes is given back.
        leverage = now.factors[:, :, :-1] @ now.problem.inverse
        freedom = np.sum(leverage**2, axis=(1, 2)) * now.weights
        rms = residual / np.sqrt(np.maximum(now.samples - freedom, 1.0))
        before, levels = levels, np.maximum(rms[channels], NOISE_FLOOR * largest) / sigma
        if np.allclose(levels, before, rtol=_SETTLED, atol=0):
            break
    return levels
