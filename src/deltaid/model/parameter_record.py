"""Parameters of an identified model with intervals and their origin; look-up by name, with the
nearest name where there is none.

A model file also keeps how friction laws were chosen, and a posterior, so that consistent models
can be drawn from data, prior and cones.
"""

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import unknown
from deltaid.robot.part import Coordinate, Part, Positive


class Share(Part):
    """Origin of an interval: noise of torques, of sensors and of measured values, the prior, the
    robot's geometry with undetermined effects, and, for what nothing shows, physical consistency.

    Shares of its squared width, together one.
    """

    noise: Annotated[float, Field(ge=0, le=1, description="of the recorded torques")]
    prior: Annotated[float, Field(ge=0, le=1)]
    geometry: Annotated[float, Field(ge=0, le=1)]
    unseen: Annotated[float, Field(ge=0, le=1)] = 0.0
    sensors: Annotated[float, Field(ge=0, le=1, description="noise of sensors")] = 0.0
    measured: Annotated[float, Field(ge=0, le=1, description="of measured values")] = 0.0

    @classmethod
    def from_parts(cls, shares: Float[np.ndarray, " 5"]) -> "Share":
        """The shares from those of torques, sensors, measured values, prior and geometry, where
        consistency bounds what is not shown."""
        noise, sensors, measured, prior, geometry = (float(share) for share in shares)
        return cls(noise=noise, prior=prior, geometry=geometry, sensors=sensors, measured=measured)


# What decided a parameter.
Origin = Literal["data", "measured", "sum", "prior", "limit", "structure", "fixed", "consistency"]


class Parameter(Part):
    """One parameter: value, standard deviation, 95 % interval, prior, and what decided it.

    `determined_by` is

    - 'data' where the recording knows it to less than half of the prior's spread by itself;
    - 'measured' where it is known as well, and most of its uncertainty comes from values
      that were measured of bodies, by a scale or the like;
    - 'sum' where it does so only with the priors of others, which `rests_on` names: torques show a
      sum of it and these. `std` takes these priors at their word, the interval does not;
    - 'prior' where neither is the case; standard deviation and interval are the prior's own;
    - 'limit' where it is as small as consistency lets it be; the interval is one-sided, or what
      recording and consistency leave open;
    - 'consistency' for entries that no torque shows and that grew to keep their body consistent,
      which are lower bounds; standard deviation and interval are the prior's own;
    - 'fixed' for entries that torques show but the reduction holds at the prior (± 0);
    - 'structure' for entries that the reduction holds at zero.

    Parameters that must be positive have intervals that end at zero. `low` and `high` are missing
    in models of earlier versions, `rests_on`, 'sum' and 'limit' in those of format 2.
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
        default=(), description="whose priors a value that only a sum shows rests on"
    )
    share: Share | None = Field(
        default=None,
        description="what an interval by the data comes from; missing in earlier files",
    )

    def moved(self, by: float) -> "Parameter":
        """The correction already applied plus this remainder."""
        low, high = (None if end is None else end + by for end in (self.low, self.high))
        return self.changed(value=self.value + by, low=low, high=high, prior=self.prior + by)


class HeldLoad(Part):
    """A load of recordings, as declared and as identified.

    `parameters` are the ten of a body, about the frame of the body that carries it.
    """

    name: str
    body: str
    logs: tuple[str, ...]
    parameters: Annotated[tuple[Parameter, ...], Field(min_length=10, max_length=10)]

    @property
    def p(self) -> Float[np.ndarray, " 10"]:
        """m, mcx, mcy, mcz, Θ_xx, …, of the load."""
        return np.array([parameter.value for parameter in self.parameters])

    @property
    def mass(self) -> Parameter:
        """Mass of the load [kg]."""
        return self.parameters[0]


class BaseParameter(Part):
    """A combination that torques determine, by least squares without prior and consistency.

    Value, standard deviation and 95 % interval.
    """

    formula: str
    representative: str = Field(
        default="", description="the parameter that it stands for; missing in earlier files"
    )
    value: float
    std: Annotated[float, Field(ge=0)]
    low: float
    high: float
    unit: str
    share: Share | None = Field(
        default=None, description="what the interval comes from; missing in earlier files"
    )


# Common names of the entries of a body.
_ALSO = {"mass": "m", "weight": "m", "x": "mcx", "y": "mcy", "z": "mcz", "com": "mcx",
         "inertia": "Izz"}  # fmt: skip


def place(layout: ParameterLayout, name: str, where: str) -> int:
    """Index of a parameter in p."""
    if name in layout.names:
        return layout.names.index(name)
    raise unknown(name, layout.names, "parameter", where, also=_usual(layout, name))


def _usual(layout: ParameterLayout, name: str) -> str:
    """The parameter's name here for a common one: P.mass is P.m."""
    body, _, entry = name.partition(".")
    usual = f"{body}.{_ALSO.get(entry.lower(), '')}"
    return usual if usual in layout.names else ""


AdditionKind = Literal["offset", "both_ways", "power", "stribeck", "load"]
# A joint, and the kind of term that its law gets.
JointTerm = tuple[str, str]


class FrictionTrial(Part):
    """One joint's law with one more term.

    Attributes:
        joint, addition: what was tried: 'offset', 'both_ways' (a law for each direction), 'power',
            'stribeck' or 'load'; of a term that is described, other constants.
        error: torque error that it leaves, as a share of the largest torque, root mean square over
            all drives.
        gain: by what share the squared error falls against the law before.
        significance: what it explains as a multiple of what chance explains, in amplitude. Of
            models before format 3 the mean gain over folds as a multiple of its standard error.
        useful: of a trial whether its gain is beyond chance; of a step whether the final law has
            it.
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
        folds: number of stretches of the recordings whose scatter says what chance explains.
        plain_error, chosen_error: torque error with the described and with the chosen laws, as in
            `FrictionTrial`.
        steps: what was added, in this order.
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
        joint: which.
        speed: ascending, both ways [rad/s or m/s].
        friction: at these speeds [N m or N].
        half_width: of its intervals, constants of the law counted as unknown.
    """

    joint: str
    speed: tuple[float, ...]
    friction: tuple[float, ...]
    half_width: tuple[float, ...]

    def band(self, speed: Float[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
        """Lower and upper ends of the intervals at speeds of the curve, between its points."""
        middle, half = (np.interp(speed, self.speed, x) for x in (self.friction, self.half_width))
        return np.stack([middle - half, middle + half])


class PosteriorRecord(Part):
    """Data and prior on a robot's parameters, with all other unknowns marginalised.

    The data gives combinations of parameters, b = K p + e with e ~ N(0, L Lᵀ). Deviations are those
    that intervals of base parameters have: by the recording's scatter and by tolerances of
    geometry. Lags, gains, loads and all else beside the robot have widened them already.

    The prior of an entry of p has the standard deviation `spread` times `wider` (1 where it is not
    named) times its size.
    """

    spread: Positive = Field(description="relative standard deviation of the prior, by the γ used")
    wider: dict[str, Positive] = Field(
        default_factory=dict[str, Positive], description="factors on it, by parameter"
    )
    unseen: tuple[str, ...] = Field(default=(), description="parameters that no row of data shows")
    combinations: tuple[dict[str, float], ...] = Field(description="rows of K, by parameter")
    values: tuple[float, ...] = Field(description="b")
    factor: tuple[Annotated[tuple[float, ...], Field(min_length=1)], ...] = Field(
        description="L, the rows of a lower triangle"
    )

    @property
    def names(self) -> set[str]:
        """Names of all its parameters."""
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
