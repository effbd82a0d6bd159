"""Rows of one sensor in addition to the drives' torques: linear in p and the sensor's unknowns u.

    y = C(z, q̇, q̈) p + D(z, q̇, q̈, y) u + e,    u: bias, pose, gain, depending on the sensor

Each kind of sensor is a class in a separate file. All kinds take columns from a graph; some
columns also depend on the measured values y. Columns of u that follow from the motion, such as a
rotor's spin, follow C in the graph. A bias has a column of ones, a gain the column y, because
y = (C p + b)/(1 − g) is

    y = C p + b + g y.

The column of a gain and y must not share their noise: with measured values, ‖(1 − g) y − C p‖²
falls as g approaches one, and noise of a few per cent of the signal moves the gain by many standard
deviations. So columns take y from a linearization point (`SensorRows.about`),

    h = C p₀ + b₀,    h' = h + (0, f × δ₀),    v = h' + ½ (h' + v) × θ₀,    ŷ = v / (1 − g₀),

and the fit is repeated about its result until it settles. Columns of the position use h, columns of
the axes ½ (h' + v): so v is h' turned by 2 arctan(|θ₀|/2), of the same length.
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
from deltaid.levels import GRAVITY, WIDER
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import Sensor, SensorChannel, channels_of

Motion = Float[np.ndarray, "samples dof"]
Shown = Float[np.ndarray, "channels samples"]
Pattern = tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]


@dataclass(frozen=True)
class Unknown:
    """One unknown of a sensor whose column does not follow from the motion alone.

    Attributes:
        parameter: its name, unit and prior.
        channels: indices of the channels that it changes.
        column: its entries there, (channels, samples), as a function of the measured values.
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
        prior_spread: of the fit; all scales of parameters are relative to it.
        sensor: as described.
        values: linearization point, p₀ and the unknowns in the order of the columns; None to use
            measured values in the columns of gain and pose.
    """

    dynamics: Dynamics
    name: str
    prior_spread: float
    sensor: Sensor
    values: Float[np.ndarray, " columns"] | None = None

    @property
    def channels(self) -> tuple[SensorChannel, ...]:
        """Measured channels, in the order of the log's columns."""
        return channels_of(self.dynamics.robot, self.name, self.sensor)

    @property
    @abstractmethod
    def graph(self) -> ca.SX:
        """[C, columns of `moving`] as a function of z, q̇ and q̈; one row a channel."""

    @property
    def moving(self) -> tuple[PriorParameter, ...]:
        """Unknowns whose columns follow from the motion."""
        return ()

    @cached_property
    @abstractmethod
    def still(self) -> tuple[Unknown, ...]:
        """Unknowns whose columns do not follow from the motion alone."""

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """Unknowns u, of kind 'sensor'; `scale` · prior spread is the prior deviation of each."""
        return (*self.moving, *(unknown.parameter for unknown in self.still))

    @cached_property
    def pattern(self) -> Pattern:
        """Channel and column of each entry that is not always zero.

        Columns below len(p) belong to p, the others to `parameters`.
        """
        rows, columns = self._compiled[1]
        first = len(self.dynamics.layout.parameters) + len(self.moving)
        places = [(c, first + k) for k, entry in enumerate(self.still) for c in entry.channels]
        more = np.array(places, dtype=int).reshape(-1, 2)
        return np.append(rows, more[:, 0]), np.append(columns, more[:, 1])

    def about(self, values: Float[np.ndarray, " columns"]) -> "SensorRows":
        """The same rows linearized about p₀ and values of the unknowns, without measured values."""
        rows = replace(self, values=values)
        vars(rows)["_compiled"] = self._compiled  # where cached properties are kept
        return rows

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Shown
    ) -> Float[np.ndarray, "entries samples"]:
        """Entries of [C, D] at some samples, in the order of `pattern`.

        Args:
            shown: measured values there, in SI and the sensor's axes; for pose and gain.
        """
        columns = self._compiled[0](np.hstack([z, qd, qdd]).T)
        if self.values is None:
            return self._entries(columns, shown)
        straight, half, expected = self._expected(columns)
        entries = self._entries(columns, expected)
        for selected, about in (
            (self._entries_of("position"), straight),
            (self._entries_of("rotation"), half),
        ):
            if selected.any():
                entries[selected] = self._entries(columns, about)[selected]
        return entries

    def _entries(self, columns: np.ndarray, shown: Shown) -> Float[np.ndarray, "entries samples"]:
        return np.vstack([columns, *(unknown.column(shown) for unknown in self.still)])

    def _expected(self, columns: np.ndarray) -> tuple[Shown, Shown, Shown]:
        """h, ½ (h' + v) and ŷ."""
        assert self.values is not None
        straight = self._sum(columns, self.values, np.zeros((len(self.channels), columns.shape[1])))
        moved = straight + self._feedback(self.values, "position") @ straight
        half_turn, unit = 0.5 * self._feedback(self.values, "rotation"), np.eye(len(straight))
        turned = np.linalg.solve(unit - half_turn, moved + half_turn @ moved)
        gain = sum(self.values[self._places("gain")])  # g₀; zero where the gain is known
        return straight, 0.5 * (moved + turned), turned / (1.0 - gain)

    def shown(self, values: np.ndarray, z: Motion, qd: Motion, qdd: Motion) -> Shown:
        """Noise-free y = C p + D(y) u along a motion.

        Args:
            values: p and u, in the order of the columns.
        """
        columns = self._compiled[0](np.hstack([z, qd, qdd]).T)
        free = self._sum(columns, values, np.zeros((len(self.channels), len(z))))
        return np.linalg.solve(np.eye(len(free)) - self._feedback(values), free)

    def _sum(self, columns: np.ndarray, values: np.ndarray, shown: Shown) -> Shown:
        """Product of [C, D(shown)] and the values."""
        total = np.zeros_like(shown)
        rows, places = self.pattern
        np.add.at(total, rows, self._entries(columns, shown) * values[places][:, None])
        return total

    def _feedback(self, values: np.ndarray, symbol: str = "") -> Float[np.ndarray, "n n"]:
        """K with D(y) u = D(0) u + K y, only of unknowns whose symbol begins with `symbol`."""
        values = np.where(self._entries_of(symbol), values[self.pattern[1]], 0.0)
        still, unit = values[len(self._compiled[1][0]) :], np.eye(len(self.channels))
        columns = [entry.column(unit) - entry.column(0 * unit) for entry in self.still]
        K, channels = np.zeros_like(unit), [c for entry in self.still for c in entry.channels]
        np.add.at(K, channels, np.vstack([np.zeros((0, len(unit))), *columns]) * still[:, None])
        return K

    def _places(self, symbol: str) -> list[int]:
        own = enumerate(self.parameters, len(self.dynamics.layout.parameters))
        return [k for k, parameter in own if parameter.symbol.startswith(symbol)]

    def _entries_of(self, symbol: str) -> Bool[np.ndarray, " entries"]:
        return np.isin(self.pattern[1], self._places(symbol))

    @cached_property
    def _compiled(self) -> tuple[BatchKernel, Pattern]:
        """Kernel of the graph's nonzero entries, and their places.

        Sums over limbs cancel only numerically, such as the arms' mcy of a symmetric robot.
        """
        speeds = self.dynamics.kinematics.mechanism.speeds
        inputs = ca.vertcat(self.dynamics.kinematics.mechanism.z, speeds.q.u, speeds.q.ud)
        turned = ca.sparsify(self.graph).T
        columns, rows = (np.array(places, dtype=int) for places in turned.sparsity().get_triplet())
        kept = beyond_rounding(self.dynamics.kinematics, inputs, turned.nz[:])
        return BatchKernel(inputs, turned.nz[kept.tolist()]), (rows[kept], columns[kept])

    def unknown(self, symbol: str, unit: str, std: float, prior: float = 0.0) -> PriorParameter:
        """A parameter of this sensor with the standard deviation of its prior."""
        return PriorParameter(
            "sensor", self.name, symbol, unit, -np.inf, np.inf, prior, std / self.prior_spread,
            spread=self.prior_spread,
        )  # fmt: skip

    def bias(self, channel: int, symbol: str, std: float) -> Iterator[Unknown]:
        """Yield the offset of one channel; nothing where its deviation is zero."""
        if std:
            yield Unknown(
                self.unknown(symbol, self.channels[channel].unit, std),
                channels=(channel,),
                column=lambda shown: np.ones((1, shown.shape[1])),
            )

    def gain(self, tolerance: float) -> Iterator[Unknown]:
        """Yield the relative error that all channels share; nothing where its tolerance is zero."""
        if tolerance:
            yield Unknown(
                self.unknown("gain", "", tolerance),
                channels=tuple(range(len(self.channels))),
                column=lambda shown: shown,
            )


def is_of_pose(parameter: PriorParameter) -> bool:
    """Whether a sensor's unknown is an error of its position or its axes."""
    return parameter.symbol.startswith(("position", "rotation"))


def wide_force(dynamics: Dynamics) -> float:
    """Standard deviation of an unknown offset of a force [N]: ten times the robot's weight."""
    bodies, described = dynamics.kinematics.mechanism.bodies, dynamics.robot.bodies
    masses = (body.count * described[body.name].prior_parameters()[0] for body in bodies)
    return float(WIDER * GRAVITY * sum(masses))


def wide_moment(dynamics: Dynamics, about: Float[np.ndarray, " 3"]) -> float:
    """Standard deviation of an unknown moment offset [N m]: `wide_force` at the farthest body."""
    poses = dynamics.kinematics.poses(dynamics.kinematics.home)
    levers = np.array([pose.r_WB for pose in poses]) - about
    return wide_force(dynamics) * float(np.linalg.norm(levers, axis=1).max())
