"""Rows of one sensor in addition to the drives' torques: linear in p and its own unknowns.

    y = C(z, q̇, q̈) p + D(z, q̇, q̈, y) u + e,    u: bias, pose, gain, whatever the sensor has

One kind of sensor is one class in one file. All kinds share columns from a graph, and unknowns that
enter by what was shown. Columns of u that follow from the motion, such as a rotor's spin, stand in
the graph behind C. A bias is a column of ones, a gain one of what was shown, because
y = (C p + b)/(1 − g) is

    y = C p + b + g y.

Column and y of a gain must not share their noise; see `sensors.about`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.equations import beyond_rounding
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import Sensor, SensorChannel, channels_of

Motion = Float[np.ndarray, "samples dof"]


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
    def parameters(self) -> tuple[PriorParameter, ...]:
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

    parameter: PriorParameter
    channels: tuple[int, ...]
    column: Callable[[Shown], np.ndarray]


@dataclass(frozen=True, eq=False)
class GraphRows(SensorRows):
    """One sensor of a robot.

    Attributes:
        dynamics: of the robot.
        name: its key in the description.
        prior_spread: of the fit, which all scales of parameters are relative to.
        sensor: as described.
    """

    dynamics: Dynamics
    name: str
    prior_spread: float
    sensor: Sensor

    @property
    def channels(self) -> tuple[SensorChannel, ...]:
        return channels_of(self.dynamics.robot, self.name, self.sensor)

    @property
    @abstractmethod
    def graph(self) -> ca.SX:
        """[C, columns of `moving`] as a function of z, q̇ and q̈; one row a channel."""

    @property
    def moving(self) -> tuple[PriorParameter, ...]:
        """Unknowns whose columns follow from the motion."""
        return ()

    @property
    @abstractmethod
    def still(self) -> tuple[Unknown, ...]:
        """Unknowns whose columns do not follow from the motion alone."""

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return (*self.moving, *(unknown.parameter for unknown in self.still))

    @property
    def pattern(self) -> Pattern:
        return self._pattern

    @cached_property
    def _pattern(self) -> Pattern:
        rows, columns = self._compiled[1]
        first = len(self.dynamics.layout.parameters) + len(self.moving)
        of_still = [
            (c, first + k) for k, unknown in enumerate(self.still) for c in unknown.channels
        ]
        more = np.array(of_still, dtype=int).reshape(-1, 2)
        return np.append(rows, more[:, 0]), np.append(columns, more[:, 1])

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Shown
    ) -> Float[np.ndarray, "entries samples"]:
        values = self._compiled[0](np.hstack([z, qd, qdd]).T)
        return np.vstack([values, *(unknown.column(shown) for unknown in self.still)])

    @cached_property
    def _compiled(self) -> tuple[BatchKernel, Pattern]:
        """What of the graph is not zero, and where that stands.

        Sums over limbs cancel in numbers alone, as the arms' mcy of a symmetric robot do.
        """
        speeds = self.dynamics.kinematics.mechanism.speeds
        inputs = ca.vertcat(self.dynamics.kinematics.mechanism.z, speeds.q.u, speeds.q.ud)
        turned = ca.sparsify(self.graph).T
        columns, rows = (np.array(places, dtype=int) for places in turned.sparsity().get_triplet())
        kept = beyond_rounding(self.dynamics.kinematics, inputs, turned.nz[:])
        return BatchKernel(inputs, turned.nz[kept.tolist()]), (rows[kept], columns[kept])

    def unknown(self, symbol: str, unit: str, std: float, prior: float = 0.0) -> PriorParameter:
        """A parameter of this sensor with the standard deviation of its prior."""
        scale, spread = std / self.prior_spread, self.prior_spread
        return PriorParameter(
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


# An offset that nobody knows is a priori so many times what the sensor shows at rest.
_WIDE = 10.0
# Gravity [m/s²].
_G = 9.81


def wide_force(dynamics: Dynamics) -> float:
    """Standard deviation of an unknown offset of a force [N]: ten times the robot's weight."""
    robot = dynamics.robot
    masses = (
        body.count * robot.bodies[body.name].prior_parameters()[0]
        for body in dynamics.kinematics.mechanism.bodies
    )
    return float(_WIDE * _G * sum(masses))


def wide_moment(dynamics: Dynamics, about: Float[np.ndarray, " 3"]) -> float:
    """The same of a moment [N m]: ten times the weight at the body farthest from a point."""
    mechanism = dynamics.kinematics.mechanism
    origins = [ca.DM(body.R_WL) @ body.origin.at for body in mechanism.bodies]
    places = ca.Function("origins", [mechanism.z], [ca.horzcat(*origins)])
    ways = np.array(places(dynamics.kinematics.home)).T - about
    return wide_force(dynamics) * float(np.linalg.norm(ways, axis=1).max())
