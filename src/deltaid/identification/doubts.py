"""What in a fit contradicts the data or the prior: wrong signs, units, geometry, priors."""

import numpy as np

from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.scatter import quantile
from deltaid.identification.fit import FittedProblem
from deltaid.identification.signs import CURE, against_motion, told

# A consistent fit contradicts the data when it leaves so many times the torque error of parameters
# without constraints and more than this share of the largest torque, or when a mass that torques
# cannot see had to grow to so many times its prior.
_WORSE, _SHARE, _GREW = 3.0, 0.01, 3.0
# A base parameter of the fit contradicts the recording when it lies so many half widths of its 95 %
# interval away from what the recording alone gives.
_APART = 3.0


def doubts(problem: FittedProblem) -> tuple[str, ...]:
    """A sentence on what contradicts the data: what was seen, the likeliest cause, the next step.

    One cause shows in many ways: torques of another scale leave a misfit, contradict the prior and
    make masses grow. So the first that is known is said, and that a mass had to grow only where
    nothing better is.
    """
    found = against_motion(problem.dynamics, problem.information)
    if found:
        return (f"{told(found, problem.dynamics.robot)}; {CURE}",)
    seen = (*_misfit(problem), *_contradictions(problem), *_grown(problem))
    scale = _scale(problem)
    if seen and np.isfinite(scale) and not 1 / _GREW < scale < _GREW:
        return (
            f"torques are {scale:.3g} times what the described robot would need. Likeliest their "
            "unit, torque constant or gear is not declared, else masses and lengths of the "
            "description are those of another robot; deltaid check compares units and gears",
        )
    return seen[:1]


def _misfit(problem: FittedProblem) -> list[str]:
    """Torques that no consistent parameters explain."""
    noise = max(problem.noise, NOISE_FLOOR)
    rows = problem.information.rows / problem.information.mean_samples
    left = np.sqrt(problem.objective.data.evaluate(problem.solution.x)[0] / rows)
    if left <= max(_WORSE * noise, _SHARE):
        return []
    return [
        f"the consistent fit leaves {left / noise:.3g} times the torque error that is possible "
        "without physical consistency: only negative masses or friction would explain these "
        "torques. Likeliest a torque or position is not that of its drive, or something drives the "
        "robot beside its motors; deltaid check tries signs, orders and gears"
    ]


def _grown(problem: FittedProblem) -> list[str]:
    """Entries that no torque shows and that consistency has made much larger than the prior."""
    reduction, p = problem.reduction, problem.values
    held = ~np.any(reduction.A, axis=1)
    grown = np.flatnonzero(held & (reduction.p_reg > 0) & (p > _GREW * reduction.p_reg))
    names = ", ".join(
        f"{reduction.layout.names[i]} had to grow from {reduction.p_reg[i]:.3g} to {p[i]:.3g} "
        f"{reduction.layout.units[i]}"
        for i in grown
    )
    return [
        f"{names} to keep its body consistent, whose moments in the torques are too large for the "
        "described mass. Likeliest the prior is too light or too small; weigh the body, or "
        "describe its size"
    ] * bool(grown.size)


def _scale(problem: FittedProblem) -> float:
    """How many times the prior's torques the measured ones are, by least squares."""
    factor = problem.information.of_drives.weighted()
    prior = factor[:, :-1] @ problem.reduction.p_reg[problem.information.columns]
    square = float(prior @ prior)
    return float(prior @ factor[:, -1]) / square if square > 0 else np.nan


def _contradictions(problem: FittedProblem) -> list[str]:
    """The base parameter that a fit holds farthest from what the recording alone gives.

    With the truth within the prior, or a prior as wide as it must be, the two differ by less than
    the noise of the estimate. Where they do not, parameters that hang together with this one are
    pulled along, out of intervals that take the rest of the description at its word.
    """
    base, estimate = problem.base, problem.estimate
    by_noise, freedom = estimate.by_noise  # geometry shifts both sides alike
    fitted, half = base.values(problem.values), _excess(problem) * quantile(freedom) * by_noise
    apart = np.abs(fitted - estimate.values) / np.maximum(half, np.finfo(float).tiny)
    k, count = int(np.argmax(apart)), int(np.sum(apart > _APART))
    if not count:
        return []
    unit = base.layout.units[base.groups[k].representative]
    others = f"; {count - 1} more are as far apart" if count > 1 else ""
    causes, cure = "entries that 'free' leaves out or consistency", "Free more of their entries"
    if problem.settings.gamma is not None:  # then no prior is widened
        causes = f"prior, {causes}"
        cure = "Likeliest the prior of this body is too far off: correct it, or free more entries"
    return [
        f"the recording alone gives {base.formulas[k]} = {estimate.values[k]:.3g} ± "
        f"{half[k]:.2g} {unit}, the fit {fitted[k]:.3g} {unit}{others}: {causes} contradict the "
        "recording, and other parameters of these bodies may lie outside of their intervals. "
        f"{cure}"
    ]


def _excess(problem: FittedProblem) -> float:
    """How many times larger than the data's own the noise is that γ stands for.

    γ is what a noise of this level would have got (`objective.default_gamma`).
    """
    gamma, samples = problem.objective.gamma, problem.information.mean_samples
    assumed = problem.settings.prior_spread * np.sqrt(gamma * samples)
    return max(1.0, float(assumed / max(problem.noise, np.finfo(float).tiny)))
