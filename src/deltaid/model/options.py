"""Options of a fit by name, their limits, and the parser of lags; imports nothing slow."""

from typing import Literal

from deltaid.errors import DeltaidError, within

Method = Literal["conic", "log-cholesky"]
RegularizerName = Literal["euclidean", "entropic", "riemannian"]
FrictionLaws = Literal["described", "choose"]
LagChoice = Literal["estimate", "none"]
ComplianceChoice = Literal["estimate", "none"]
EffectsChoice = Literal["correct", "none"]
IntervalChoice = Literal["linear", "posterior"]
Period = Literal["day", "week", "month", "all"]
LeastSquaresMethod = Literal["ordinary", "weighted", "gauss-markov"]

# Limits of γ and of the relative prior spread; beyond them rounding or the prior decides alone.
GAMMA_LIMITS, SPREAD_LIMITS = (1e-18, 1e3), (1e-4, 1e4)
# Largest lag that a user may give [s].
LARGEST_LAG = 0.1
# Limits of the number of drawn models, and of the relative scatter between limbs.
SAMPLES_LIMITS, TOLERANCE_LIMITS = (1.0, 1e5), (0.0, 0.3)


def lag_of(text: str) -> LagChoice | tuple[float, ...]:
    """Value of `--lag`: a word, or lags in s from a text in milliseconds."""
    words: dict[str, LagChoice] = {"estimate": "estimate", "none": "none"}
    if (word := text.strip()) in words:
        return words[word]
    try:
        lags = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise DeltaidError(
            f"must be estimate, none, or milliseconds such as 2 or 2,2,-1.5, not {text!r}",
            where="--lag",
        ) from None
    for lag in lags:
        within("--lag", lag, (-1e3 * LARGEST_LAG, 1e3 * LARGEST_LAG))
    return tuple(1e-3 * lag for lag in lags)
