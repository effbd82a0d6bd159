"""Measured values that the recording contradicts.

Without the k-th fact, with the row a and leverage h = ‖R⁻ᵀa‖², least squares would give it the
residual r / (1 − h) in place of r, and what it is compared with errs by (uᵀs − h e) / (1 − h),
u = R⁻ᵀa. Where nothing else tells of it (h = 1), physical consistency still may: then the fit
itself keeps away from it.
"""

from collections.abc import Iterator

import numpy as np

from deltaid.estimation.scatter import inverse
from deltaid.identification.fit import FittedProblem
from deltaid.sensors.weighings import Weighing, weighings

# Standard deviations apart that are no chance, and what is left of a fact's row where all else
# tells of it too.
_APART, _TOLD = 4.0, 1e-4


def contradicted(problem: FittedProblem) -> tuple[str, ...]:
    """A sentence on each measured value that recordings, other values or consistency contradict."""
    return tuple(_contradictions(problem))


def _contradictions(problem: FittedProblem) -> Iterator[str]:
    information, estimate = problem.information, problem.estimate
    if information.facts is None:
        return
    noise = estimate.noise
    at = np.searchsorted(
        information.columns, [group.representative for group in problem.base.groups]
    )
    over = inverse(noise.root)
    shifts = problem.geometry.shifts if problem.geometry else np.zeros((len(at), 0))
    for one, row in zip(weighings(problem.dynamics.robot), information.facts, strict=True):
        u = over.T @ row[at]
        left, rest = float(row[-1] - row[at] @ estimate.values), float(1.0 - u @ u)
        std, _ = noise.deviations(u[:, None])
        others = max(float(std[0]) ** 2 - (noise.sigma * (1.0 - rest)) ** 2, 0.0)
        others += float(np.sum((row[at] @ shifts) ** 2))
        if rest > _TOLD:
            apart = left / rest / np.hypot(noise.sigma, np.sqrt(others) / rest)
            if abs(apart) > _APART:
                value = one.value * (1.0 - left / rest / row[-1]) if row[-1] else 0.0
                yield _told(one, "the recording", value, abs(apart))
                continue
        fitted = float(one.coefficients @ problem.p)
        apart = abs(one.value - fitted) / one.std
        if apart > _APART:
            yield _told(one, "the fit, whose bodies must be possible,", fitted, apart)


def _told(one: Weighing, who: str, value: float, apart: float) -> str:
    return (
        f"{one.where}: {one.name} was measured as {one.shown(one.value)} ± {one.std:.2g} "
        f"{one.unit}, but {who} says {one.shown(value)} {one.unit}, {apart:.2g} standard "
        "deviations apart. Likeliest its unit, or what was measured with it (screws, cables, half "
        "a joint); mend it, state a larger std, or leave it out"
    )
