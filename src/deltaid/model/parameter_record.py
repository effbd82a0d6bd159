"""Parameters of an identified model with intervals and their origin, and look-up by name.

A model file also keeps the choice of friction laws, and a posterior, from which consistent models
are drawn.
"""

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import unknown
from deltaid.robot.inertia import INERTIA_UNITS
from deltaid.robot.part import Coordinate, Part, Positive


class Share(Part):
    """Origin of an interval: noise of torques, of sensors and of measured values, the prior, the
    robot's geometry with undetermined effects, and physical consistency for unidentifiable
    parameters.

    Shares of the squared width, which sum to 1.
    """

    noise: Annotated[float, Field(ge=0, le=1, description="noise of the recorded torques")]
    prior: Annotated[float, Field(ge=0, le=1)]
    geometry: Annotated[float, Field(ge=0, le=1)]
    unseen: Annotated[float, Field(ge=0, le=1)] = 0.0
    sensors: Annotated[float, Field(ge=0, le=1, description="noise of sensors")] = 0.0
    measured: Annotated[float, Field(ge=0, le=1, description="noise of measured values")] = 0.0

    @classmethod
    def from_parts(cls, shares: Float[np.ndarray, " 5"]) -> "Share":
        """Shares from those of torques, sensors, measured values, prior and geometry; none is due
        to consistency."""
        noise, sensors, measured, prior, geometry = (float(share) for share in shares)
        return cls(noise=noise, prior=prior, geometry=geometry, sensors=sensors, measured=measured)


# What determines a parameter.
Origin = Literal["data", "measured", "sum", "prior", "limit", "structure", "fixed", "consistency"]


class Parameter(Part):
    """One parameter: value, standard deviation, 95 % interval, prior, and what determines it.

    `determined_by` is

    - 'data' if the recording alone determines it to less than half of the prior's spread;
    - 'measured' if this holds too, and most of its uncertainty comes from values that were measured
      on bodies, as by a scale;
    - 'sum' if torques determine a sum of it and the parameters in `rests_on`, so that it also needs
      their priors. `std` trusts these priors, the interval does not;
    - 'prior' if none of these holds; standard deviation and interval are those of the prior;
    - 'limit' if it is as small as consistency allows; the interval is one-sided, or what recording
      and consistency leave open;
    - 'consistency' for entries that no torque determines and that were increased to keep their body
      consistent. They are lower bounds; standard deviation and interval are those of the prior;
    - 'fixed' for entries that affect torques but that the reduction holds at the prior (± 0);
    - 'structure' for entries that the reduction holds at zero.

    Intervals of parameters that must be positive end at zero. Models of earlier versions lack `low`
    and `high`, those of format 2 `rests_on`, 'sum' and 'limit'.
    """

    name: str
    value: Coordinate
    std: Annotated[float, Field(ge=0)]
    low: Coordinate | None = None
    high: Coordinate | None = None
    unit: str
    prior: Coordinate
    determined_by: Origin
    rests_on: tuple[str, ...] = Field(
        default=(), description="parameters whose priors a value that is known only as a sum needs"
    )
    share: Share | None = Field(
        default=None,
        description="sources of an interval that the data determines; missing in earlier files",
    )

    @model_validator(mode="after")
    def _check(self) -> "Parameter":
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError("low is above high")
        return self

    def moved(self, by: float) -> "Parameter":
        """The parameter shifted by a correction that was applied before the fit."""
        low, high = (None if end is None else end + by for end in (self.low, self.high))
        return self.changed(value=self.value + by, low=low, high=high, prior=self.prior + by)


class HeldLoad(Part):
    """A load of recordings, as declared and as identified.

    `parameters` are ten inertia parameters, about the frame of the body that carries the load.
    """

    name: str
    body: str
    logs: tuple[str, ...]
    parameters: Annotated[tuple[Parameter, ...], Field(min_length=10, max_length=10)]

    @property
    def p(self) -> Float[np.ndarray, " 10"]:
        """m, mcx, mcy, mcz, Θ_xx, … of the load."""
        return np.array([parameter.value for parameter in self.parameters])

    @property
    def mass(self) -> Parameter:
        """Mass of the load [kg]."""
        return self.parameters[0]

    @model_validator(mode="after")
    def _check(self) -> "HeldLoad":
        for k, (entry, unit) in enumerate(zip(self.parameters, INERTIA_UNITS, strict=True)):
            if entry.unit != unit:
                raise ValueError(f"parameters.{k}.unit is {entry.unit}, but it is in {unit}")
        return self


class BaseParameter(Part):
    """A combination of parameters that torques determine, by least squares without prior and
    consistency: value, standard deviation and 95 % interval.
    """

    formula: str
    representative: str = Field(
        default="", description="parameter that it stands for; missing in earlier files"
    )
    value: float
    std: Annotated[float, Field(ge=0)]
    low: float
    high: float
    unit: str
    share: Share | None = Field(
        default=None, description="sources of the interval; missing in earlier files"
    )


# Common names of a body's entries, and the entries they mean.
_ALSO = {"mass": "m", "weight": "m", "x": "mcx", "y": "mcy", "z": "mcz", "com": "mcx",
         "inertia": "Izz"}  # fmt: skip


def place(layout: ParameterLayout, name: str, where: str) -> int:
    """Index of a parameter in p."""
    if name in layout.names:
        return layout.names.index(name)
    raise unknown(name, layout.names, "parameter", where, also=_usual(layout, name))


def _usual(layout: ParameterLayout, name: str) -> str:
    """The parameter that a common name means: P.m for P.mass; empty if none."""
    body, _, entry = name.partition(".")
    usual = f"{body}.{_ALSO.get(entry.lower(), '')}"
    return usual if usual in layout.names else ""


AdditionKind = Literal["offset", "both_ways", "power", "stribeck", "load"]
# A joint, and the kind of a term of its friction law.
JointTerm = tuple[str, str]


class FrictionTrial(Part):
    """One joint's friction law with one more term.

    Attributes:
        joint, addition: a joint, and the term tried for it: 'offset', 'both_ways' (a law for each
            direction), 'power', 'stribeck' or 'load'; for a term that is already described, other
            constants of it.
        error: remaining torque error, as a share of the largest torque, root mean square over all
            drives.
        gain: relative decrease of the squared error against the law before.
        significance: what it explains as a multiple of what chance explains, in amplitude. In
            models before format 3: mean gain over folds as a multiple of its standard error.
        useful: for a trial, whether its gain is beyond chance; for a step, whether the final law
            has it.
    """

    joint: str
    addition: AdditionKind
    error: float
    gain: float
    significance: float
    useful: bool


class FrictionChoice(Part):
    """The choice of friction laws.

    Attributes:
        folds: number of stretches of the recordings whose scatter determines what chance explains.
        plain_error, chosen_error: torque error with the described and with the chosen laws, as in
            `FrictionTrial`.
        steps: added terms, in this order.
        trials: every addition alone, to the described laws.
    """

    folds: int
    plain_error: float
    chosen_error: float
    steps: tuple[FrictionTrial, ...]
    trials: tuple[FrictionTrial, ...]


class FrictionCurve(Part):
    """Friction of a joint over its speed, without the load-dependent part, with 95 % intervals.

    Attributes:
        joint: name of the joint.
        speed: ascending, in both directions [rad/s or m/s].
        friction: at these speeds [N m or N].
        half_width: of the intervals, with the constants of the law as unknowns [N m or N].
    """

    joint: str
    speed: tuple[float, ...]
    friction: tuple[float, ...]
    half_width: tuple[float, ...]

    def band(self, speed: Float[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
        """Lower and upper ends of the intervals, interpolated between the curve's speeds."""
        middle, half = (np.interp(speed, self.speed, x) for x in (self.friction, self.half_width))
        return np.stack([middle - half, middle + half])


class PosteriorRecord(Part):
    """Data and prior of a robot's parameters, with all other unknowns marginalised.

    The data gives combinations of parameters, b = K p + e with e ~ N(0, L Lᵀ). L has the deviations
    of base parameters' intervals: by the recording's scatter and by tolerances of geometry. Lags,
    gains, loads and all other unknowns are already included.

    The prior of an entry of p has the standard deviation `spread` times `wider` (1 if it is not
    named) times its size.
    """

    spread: Positive = Field(
        description="relative standard deviation of the prior that the used γ implies"
    )
    wider: dict[str, Positive] = Field(
        default_factory=dict[str, Positive], description="factors on this spread, by parameter"
    )
    unseen: tuple[str, ...] = Field(
        default=(), description="parameters that no row of the data depends on"
    )
    combinations: tuple[dict[str, float], ...] = Field(
        description="rows of K: coefficients by parameter"
    )
    values: tuple[float, ...] = Field(description="the vector b")
    factor: tuple[Annotated[tuple[float, ...], Field(min_length=1)], ...] = Field(
        description="L, by rows of its lower triangle"
    )

    @property
    def names(self) -> set[str]:
        """Names of all parameters in it."""
        return {*self.wider, *self.unseen, *(name for row in self.combinations for name in row)}

    @property
    def root(self) -> Float[np.ndarray, "rows rows"]:
        """L, the factor of the covariance of b."""
        L = np.zeros((len(self.values), len(self.values)))
        L[np.tril_indices(len(L))] = [x for row in self.factor for x in row]
        return L

    def combination(self, names: tuple[str, ...]) -> Float[np.ndarray, "rows parameters"]:
        """K as a matrix over parameters of these names."""
        K, at = np.zeros((len(self.values), len(names))), {name: i for i, name in enumerate(names)}
        for row, members in zip(K, self.combinations, strict=True):
            for name, coefficient in members.items():
                row[at[name]] = coefficient
        return K

    @model_validator(mode="after")
    def _check(self) -> "PosteriorRecord":
        count = len(self.values)
        if len(self.combinations) != count:
            raise ValueError(f"has {len(self.combinations)} combinations for {count} values")
        if [len(row) for row in self.factor] != list(range(1, count + 1)):
            raise ValueError(f"factor must be a lower triangle of {count} rows: 1, 2, … numbers")
        if any(row[-1] <= 0 for row in self.factor):
            raise ValueError("factor must have a positive diagonal")
        return self
