"""Rows of one sensor in addition to the drives' torques: linear in p and its own unknowns.

    y = C(z, q̇, q̈) p + D(z, q̇, q̈, y) u + e,    u: bias, pose, gain, whatever the sensor has

One kind of sensor is one class in one file. All kinds share columns from a graph, and unknowns that
enter by what was shown. Columns of u that follow from the motion, such as a rotor's spin, stand in
the graph behind C. A bias is a column of ones, a gain one of what was shown, because
y = (C p + b)/(1 − g) is

    y = C p + b + g y.

Column and y of a gain must not share their noise: taken as measured, ‖(1 − g) y − C p‖² falls with
every g towards one, and at a noise of a few per cent of the signal the gain comes out many standard
deviations off. So they are taken as what some values say (`SensorRows.about`),

    h = C p₀ + b₀,    h' = h + (0, f × δ₀),    v = h' + ½ (h' + v) × θ₀,    ŷ = v / (1 − g₀),

and the fit repeated about what it gives, until it settles. Columns of the place are of h, those of
the axes of what is half turned, ½ (h' + v): so v is h' turned by 2 arctan(|θ₀|/2), and not a longer
vector, as h' + h' × θ₀ is.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.equations import beyond_rounding
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import Sensor, SensorChannel, channels_of

# Rounds of turning, each of which makes what is left of a turn by 0.2 rad ten times smaller.
_ROUNDS = 5

Motion = Float[np.ndarray, "samples dof"]
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
class SensorRows(ABC):
    """One sensor of a robot.

    Attributes:
        dynamics: of the robot.
        name: its key in the description.
        prior_spread: of the fit, which all scales of parameters are relative to.
        sensor: as described.
        values: p₀ and the values of its unknowns, in the order of the columns, that gain and pose
            are about; they are about what it showed where there are none.
    """

    dynamics: Dynamics
    name: str
    prior_spread: float
    sensor: Sensor
    values: Float[np.ndarray, " columns"] | None = None

    @property
    def channels(self) -> tuple[SensorChannel, ...]:
        """What it shows, in the order of its columns."""
        return channels_of(self.dynamics.robot, self.name, self.sensor)

    @property
    @abstractmethod
    def graph(self) -> ca.SX:
        """[C, columns of `moving`] as a function of z, q̇ and q̈; one row a channel."""

    @property
    def moving(self) -> tuple[PriorParameter, ...]:
        """Unknowns whose columns follow from the motion."""
        return ()

    @abstractmethod
    def still(self) -> Iterator[Unknown]:
        """Unknowns whose columns do not follow from the motion alone."""

    @cached_property
    def _still(self) -> tuple[Unknown, ...]:
        return tuple(self.still())

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """Its unknowns u, of kind 'sensor'; `scale` · prior spread is what is known of each."""
        return (*self.moving, *(unknown.parameter for unknown in self._still))

    @cached_property
    def pattern(self) -> Pattern:
        """Channel and column of each entry that is not always zero.

        Columns below len(p) are those of p, the others are of `parameters`.
        """
        rows, columns = self._compiled[1]
        first = len(self.dynamics.layout.parameters) + len(self.moving)
        places = [(c, first + k) for k, entry in enumerate(self._still) for c in entry.channels]
        more = np.array(places, dtype=int).reshape(-1, 2)
        return np.append(rows, more[:, 0]), np.append(columns, more[:, 1])

    def about(self, values: Float[np.ndarray, " columns"]) -> "SensorRows":
        """The same rows about p₀ and values of its unknowns; what it showed is not looked at."""
        rows = replace(self, values=values)
        vars(rows)["_compiled"] = self._compiled  # where cached properties are kept
        return rows

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Shown
    ) -> Float[np.ndarray, "entries samples"]:
        """The entries at some samples, in the order of the pattern.

        Args:
            shown: what it showed there, in SI and its own axes; for pose and gain.
        """
        columns = self._compiled[0](np.hstack([z, qd, qdd]).T)
        if self.values is None:
            return self._entries(columns, shown)
        straight, half, expected = self._expected(columns)
        entries = self._entries(columns, expected)
        for selected, seen in (
            (self._entries_of("position"), straight),
            (self._entries_of("rotation"), half),
        ):
            if selected.any():
                entries[selected] = self._entries(columns, seen)[selected]
        return entries

    def expected(self, z: Motion, qd: Motion, qdd: Motion) -> Shown:
        """What the sensor should show by its `values`, ŷ, at some samples."""
        return self._expected(self._compiled[0](np.hstack([z, qd, qdd]).T))[2]

    def _entries(self, columns: np.ndarray, shown: Shown) -> Float[np.ndarray, "entries samples"]:
        return np.vstack([columns, *(unknown.column(shown) for unknown in self._still)])

    def _expected(self, columns: np.ndarray) -> tuple[Shown, Shown, Shown]:
        """h, what is half turned, and ŷ."""
        assert self.values is not None
        values = self.values[self.pattern[1]][:, None]

        def added(seen: Shown, chosen: Bool[np.ndarray, " entries"]) -> Shown:
            """What some columns add, of what is seen."""
            total = np.zeros_like(seen)
            if chosen.any():
                entries = self._entries(columns, seen)[chosen] * values[chosen]
                np.add.at(total, self.pattern[0][chosen], entries)
            return total

        position, rotation = self._entries_of("position"), self._entries_of("rotation")
        straight = added(np.zeros((len(self.channels), columns.shape[1])), ~(position | rotation))
        moved = straight + added(straight, position)
        turned = half = moved
        for _ in range(_ROUNDS if rotation.any() else 0):
            turned = moved + added(half, rotation)
            half = 0.5 * (moved + turned)
        gain = sum(self.values[self._places("gain")])  # g₀; zero where the gain is known
        return straight, half, turned / (1.0 - gain)

    def _places(self, symbol: str) -> list[int]:
        own = enumerate(self.parameters, len(self.dynamics.layout.parameters))
        return [k for k, parameter in own if parameter.symbol.startswith(symbol)]

    def _entries_of(self, symbol: str) -> Bool[np.ndarray, " entries"]:
        return np.isin(self.pattern[1], self._places(symbol))

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

    def bias(self, channel: int, symbol: str, std: float) -> Iterator[Unknown]:
        """The offset of one channel; none where it is zero."""
        if std:
            parameter = self.unknown(symbol, self.channels[channel].unit, std)
            yield Unknown(parameter, (channel,), lambda shown: np.ones((1, shown.shape[1])))

    def gain(self, tolerance: float) -> Iterator[Unknown]:
        """What all channels are off by alike, as a share; none where that is zero."""
        if tolerance:
            every = tuple(range(len(self.channels)))
            yield Unknown(self.unknown("gain", "", tolerance), every, lambda shown: shown)


def is_of_pose(parameter: PriorParameter) -> bool:
    """Whether a sensor's unknown is an error of its place or its axes."""
    return parameter.symbol.startswith(("position", "rotation"))


# An offset that nobody knows is a priori so many times what the sensor shows at rest.
_WIDE = 10.0
# Gravity [m/s²].
_G = 9.81


def wide_force(dynamics: Dynamics) -> float:
    """Standard deviation of an unknown offset of a force [N]: ten times the robot's weight."""
    bodies, described = dynamics.kinematics.mechanism.bodies, dynamics.robot.bodies
    masses = (body.count * described[body.name].prior_parameters()[0] for body in bodies)
    return float(_WIDE * _G * sum(masses))


def wide_moment(dynamics: Dynamics, about: Float[np.ndarray, " 3"]) -> float:
    """The same of a moment [N m]: ten times the weight at the body farthest from a point."""
    mechanism = dynamics.kinematics.mechanism
    origins = [ca.DM(body.R_WL) @ body.origin.at for body in mechanism.bodies]
    places = ca.Function("origins", [mechanism.z], [ca.horzcat(*origins)])
    levers = np.array(places(dynamics.kinematics.home)).T - about
    return wide_force(dynamics) * float(np.linalg.norm(levers, axis=1).max())
