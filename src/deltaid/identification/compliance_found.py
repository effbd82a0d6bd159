"""What was found of gears that wind up."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.windings import Compliance

Groups = Float[np.ndarray, "dof groups"]


@dataclass(frozen=True, eq=False)
class Found:
    """Compliances of all gears.

    Attributes:
        values: s of every drive [rad/(N m) or m/N].
        groups: which drives have each of the sizes that were looked for, ones and zeros.
        sizes, covariance: of these.
        like_lag: how far the size of each correlates with its drives' lags, between 0 and 1.
        p: parameters of the robot that go with them.
    """

    values: Compliance
    groups: Groups
    sizes: Float[np.ndarray, " groups"]
    covariance: Float[np.ndarray, "groups groups"]
    like_lag: Float[np.ndarray, " groups"]
    p: Parameters

    @property
    def deviation(self) -> Float[np.ndarray, " groups"]:
        """Standard deviations of the sizes."""
        return np.sqrt(np.diag(self.covariance))
