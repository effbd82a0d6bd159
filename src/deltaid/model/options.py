"""What a user may ask of a fit by name, and within which limits; imports nothing that is slow."""

from typing import Literal

Method = Literal["conic", "log-cholesky"]
RegularizerName = Literal["euclidean", "entropic", "riemannian"]
FrictionLaws = Literal["described", "choose"]
LagChoice = Literal["estimate", "none"]
ComplianceChoice = Literal["estimate", "none"]
EffectsChoice = Literal["correct", "none"]
IntervalChoice = Literal["linear", "posterior"]
Period = Literal["day", "week", "month", "all"]
LeastSquaresMethod = Literal["ordinary", "weighted", "gauss-markov"]

# Beyond these the fit only sees the data's rounding, or only the prior.
GAMMA_LIMITS, SPREAD_LIMITS = (1e-18, 1e3), (1e-4, 1e4)
# The largest lag that can be given [s].
LARGEST_LAG = 0.1
# How many models can be drawn at once, and by how much limbs may scatter.
SAMPLES_LIMITS, TOLERANCE_LIMITS = (1.0, 1e5), (0.0, 0.3)
