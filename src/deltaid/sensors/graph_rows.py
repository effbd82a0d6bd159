"""What all kinds of sensors share: columns from a graph, and unknowns that enter by what was shown.

    y = C(z, q̇, q̈) p + D(z, q̇, q̈, y) u + e

Columns of u that follow from the motion, such as a rotor's spin, stand beside C in the graph. A
bias is a column of ones, a gain one of what was shown, because y = (C p + b)/(1 − g) is

    y = C p + b + g y.

Column and y of a gain must not share their noise; see `sensors.about`.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.equations import beyond_rounding
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.parameter import Parameter
from deltaid.sensors.rows import Motion, SensorChannel, SensorRows

Shown = Float[np.ndarray, "channels samples"]
Pattern = tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]


@dataclass(frozen=True)
class Unknown:
    """One unknown of a sensor that no motion says anything about by itself.

    Attributes:
        parameter: what it is.
        channels: numbers of the channels that it is seen in.
        column: its entries there, (channels, samples), from what was shown.
    """

    parameter: Parameter
    channels: tuple[int, ...]
    column: Callable[[Shown], np.ndarray]


@dataclass(frozen=True, eq=False)
class GraphRows(SensorRows):
    """One sensor of a robot.

    Attributes:
        dynamics: of the robot.
        name: its key in the description.
        prior_spread: of the fit, which all scales of parameters are relative to.
    """

    dynamics: Dynamics
    name: str
    prior_spread: float

    @property
    @abstractmethod
    def graph(self) -> ca.SX:
        """[C, columns of `moving`] as a function of z, q̇ and q̈; one row a channel."""

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """Unknowns whose columns follow from the motion."""
        return ()

    @property
    @abstractmethod
    def still(self) -> tuple[Unknown, ...]:
        """The other unknowns."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.moving, *(one.parameter for one in self.still))

    @property
    def pattern(self) -> Pattern:
        return self._pattern

    @cached_property
    def _pattern(self) -> Pattern:
        rows, columns = self._compiled[1]
        first = len(self.dynamics.layout.parameters) + len(self.moving)
        of_still = [(c, first + k) for k, one in enumerate(self.still) for c in one.channels]
        more = np.array(of_still, dtype=int).reshape(-1, 2)
        return np.append(rows, more[:, 0]), np.append(columns, more[:, 1])

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Shown
    ) -> Float[np.ndarray, "entries samples"]:
        values = self._compiled[0](np.hstack([z, qd, qdd]).T)
        return np.vstack([values, *(one.column(shown) for one in self.still)])

    @cached_property
    def _compiled(self) -> tuple[BatchKernel, Pattern]:
        """What of the graph is not zero, and where that stands.

        Sums over limbs cancel in numbers alone, as the arms' mcy of a symmetric robot do.
        """
        speeds = self.dynamics.kinematics.mechanism.speeds
        inputs = ca.vertcat(self.dynamics.kinematics.mechanism.z, speeds.q.u, speeds.q.ud)
        turned = ca.sparsify(self.graph).T
        columns, rows = (np.array(one, dtype=int) for one in turned.sparsity().get_triplet())
        kept = beyond_rounding(self.dynamics.kinematics, inputs, turned.nz[:])
        return BatchKernel(inputs, turned.nz[kept.tolist()]), (rows[kept], columns[kept])

    def unknown(self, symbol: str, unit: str, std: float, prior: float = 0.0) -> Parameter:
        """A parameter of this sensor with the standard deviation of its prior."""
        scale, spread = std / self.prior_spread, self.prior_spread
        return Parameter(
            "sensor", self.name, symbol, unit, -np.inf, np.inf, prior, scale, spread=spread
        )

    def bias(self, channel: int, symbol: str, std: float) -> tuple[Unknown, ...]:
        """The offset of one channel; none where it is zero."""
        if std == 0:
            return ()
        parameter = self.unknown(symbol, self.channels[channel].unit, std)
        return (Unknown(parameter, (channel,), lambda shown: np.ones((1, shown.shape[1]))),)

    def gain(self, tolerance: float) -> tuple[Unknown, ...]:
        """What all channels are off by alike, as a share; none where that is zero."""
        if tolerance == 0:
            return ()
        every = tuple(range(len(self.channels)))
        return (Unknown(self.unknown("gain", "", tolerance), every, lambda shown: shown),)


@dataclass(frozen=True, eq=False)
class OneChannelRows(GraphRows):
    """A sensor that shows one number, with a bias and a gain."""

    @property
    @abstractmethod
    def channel(self) -> SensorChannel:
        """What it shows."""

    @property
    @abstractmethod
    def offsets(self) -> tuple[float, float]:
        """Standard deviations of bias and gain."""

    @property
    def channels(self) -> tuple[SensorChannel, ...]:
        return (self.channel,)

    @property
    def still(self) -> tuple[Unknown, ...]:
        bias, gain = self.offsets
        return (*self.bias(0, "bias", bias), *self.gain(gain))
