"""What a model file keeps so that consistent models can be drawn from data, prior and cones."""

from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.robot.part import Part, Positive


class PosteriorRecord(Part):
    """What data and prior say about a robot's parameters, all beside the robot averaged out.

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
        """All parameters that it speaks of."""
        return {*self.wider, *self.unseen, *(name for row in self.combinations for name in row)}

    @property
    def root(self) -> Float[np.ndarray, "rows rows"]:
        """L, the factor of the covariance of b."""
        L = np.zeros((len(self.values), len(self.values)))
        for row, numbers in zip(L, self.factor, strict=True):
            row[: len(numbers)] = numbers
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
