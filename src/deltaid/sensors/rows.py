"""Rows of one sensor beside the drives' torques: what it shows is linear in p and its unknowns.

    y = C(z, q̇, q̈) p + D(z, q̇, q̈, y) u + e,    u: bias, pose, gain, whatever the sensor has

One kind of sensor is one class in one file.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.robot.parameter import Parameter

Motion = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class SensorChannel:
    """One number that a sensor shows.

    Attributes:
        name: as in files: 'plate.fx', 'gauge1'.
        unit: N or N m.
        noise: its standard deviation.
    """

    name: str
    unit: str
    noise: float


class SensorRows(ABC):
    """One sensor of a robot.

    Attributes:
        name: its key in the description.
    """

    name: str

    @property
    @abstractmethod
    def channels(self) -> tuple[SensorChannel, ...]:
        """What it shows, in the order of its columns."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns u, of kind 'sensor'; `scale` · prior spread is what is known of each."""

    @property
    @abstractmethod
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Channel and column of each entry that is not always zero.

        Columns below len(p) are those of p, the others are of `parameters`.
        """

    @abstractmethod
    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Float[np.ndarray, "channels samples"]
    ) -> Float[np.ndarray, "entries samples"]:
        """The entries at some samples, in the order of the pattern.

        Args:
            shown: what it showed there, in SI and its own axes; for pose and gain.
        """
