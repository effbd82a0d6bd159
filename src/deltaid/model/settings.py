"""Settings of a fit, and how they are given."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from deltaid.errors import DescriptionError
from deltaid.model.options import (
    GAMMA_LIMITS,
    LARGEST_LAG,
    SPREAD_LIMITS,
    ComplianceChoice,
    EffectsChoice,
    FrictionLaws,
    IntervalChoice,
    LagChoice,
    Method,
    RegularizerName,
)
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.robot.part import Part

Lag = Annotated[float, Field(ge=-LARGEST_LAG, le=LARGEST_LAG)]


class Settings(Part):
    """Settings of a fit.

    Attributes:
        method: 'conic' (global optimum, certified) or 'log-cholesky' (the paper's).
        regularizer: the metric that pulls towards the prior.
        gamma: γ_p/γ_τ of (15); None for maximum a posteriori from the data.
        prior_spread: relative standard deviation of the prior that this rule assumes.
        cutoff: low-pass cut-off of logs [Hz]; None for the default rule.
        friction: laws as described, or extended if the recordings require it.
        keep_all: whether to exclude nothing from the recordings.
        lag: of torques behind positions: estimated, none, or given [s], one for all drives or one
            for each.
        compliance: of gears: estimated where none is described, or only as described.
        effects: whether to correct zeros, gear ratios, lengths, a tilt, forces and ripples, as far
            as the contest of causes selects them, and loads that no mapping declares.
        events: whether to detect and exclude contacts, stops, torque spikes and play in gears.
        intervals: of parameters: by linearisation about the fit, with what data and consistency
            leave open; or of models drawn from the posterior, which include the bounds of
            consistency.
    """

    method: Method = "conic"
    regularizer: RegularizerName = "euclidean"
    gamma: Annotated[float, Field(ge=GAMMA_LIMITS[0], le=GAMMA_LIMITS[1])] | None = None
    prior_spread: Annotated[float, Field(ge=SPREAD_LIMITS[0], le=SPREAD_LIMITS[1])] = PRIOR_SPREAD
    cutoff: Annotated[float, Field(gt=0)] | None = None
    friction: FrictionLaws = "choose"
    keep_all: bool = False
    lag: LagChoice | Annotated[tuple[Lag, ...], Field(min_length=1)] = "estimate"
    compliance: ComplianceChoice = "estimate"
    effects: EffectsChoice = "correct"
    events: bool = True
    intervals: IntervalChoice = "linear"


def settings_of(given: object, options: Mapping[str, Any] | None = None) -> Settings:
    """Settings by value or as a dictionary of those that differ; single settings by name.

    Raises:
        DescriptionError: a setting does not exist, or cannot have that value.
    """
    chosen = {} if given is None else given
    if isinstance(chosen, Settings):
        chosen = chosen.model_dump()
    if not isinstance(chosen, Mapping):
        raise DescriptionError(
            f"a {type(given).__name__} is no settings",
            where="settings",
            cure="give deltaid.Settings(…), or a dictionary of the same keys",
        )
    return Settings.from_dict({**chosen, **(options or {})}, "settings")
