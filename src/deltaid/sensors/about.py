"""Rows of a sensor about values that are known so far: its gain and its pose see no noise.

A gain's column is what the sensor shows. Taken as measured, column and y share their noise, and
‖(1 − g) y − C p‖² falls with every g towards one: at a noise of a few per cent of the signal the
gain comes out many standard deviations off. So it is taken as what some values say,

    h = C p₀ + b₀,    h' = h + (0, f × δ₀),    v = h' + ½ (h' + v) × θ₀,    ŷ = v / (1 − g₀),

and the fit repeated about what it gives, until it settles. Columns of the place are of h, those of
the axes of what is half turned, ½ (h' + v): so v is h' turned by 2 arctan(|θ₀|/2), and not a longer
vector, as h' + h' × θ₀ is.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import SensorChannel
from deltaid.sensors.rows import Motion, SensorRows

# Each makes what is left of a turn by 0.2 rad ten times smaller.
_ROUNDS = 5

Seen = Float[np.ndarray, "channels samples"]


@dataclass(frozen=True, eq=False)
class RowsAbout(SensorRows):
    """The same rows; what the sensor showed is not looked at.

    Attributes:
        name: its key in the description.
        rows: the sensor's.
        values: p₀ and the values of the sensor's own unknowns, in the order of the columns.
    """

    name: str
    rows: SensorRows
    values: Float[np.ndarray, " columns"]

    @property
    def channels(self) -> tuple[SensorChannel, ...]:
        return self.rows.channels

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return self.rows.parameters

    @property
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        return self.rows.pattern

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Float[np.ndarray, "channels samples"]
    ) -> Float[np.ndarray, "entries samples"]:
        straight, half, expected = self._expected(z, qd, qdd)
        entries = self.rows.entries(z, qd, qdd, expected)
        for selected, seen in ((self._position, straight), (self._rotation, half)):
            if selected.any():
                entries[selected] = self.rows.entries(z, qd, qdd, seen)[selected]
        return entries

    def expected(self, z: Motion, qd: Motion, qdd: Motion) -> Seen:
        """What the sensor should show, ŷ, at some samples."""
        return self._expected(z, qd, qdd)[2]

    def _expected(self, z: Motion, qd: Motion, qdd: Motion) -> tuple[Seen, Seen, Seen]:
        """h, what is half turned, and ŷ."""
        channels, columns = self.pattern
        values = self.values[columns][:, None]

        def more(seen: Seen, of: Bool[np.ndarray, " entries"]) -> Seen:
            """What some columns add, of what is seen."""
            total = np.zeros_like(seen)
            if of.any():
                np.add.at(total, channels[of], self.rows.entries(z, qd, qdd, seen)[of] * values[of])
            return total

        position, rotation = self._position, self._rotation
        straight = more(np.zeros((len(self.channels), len(z))), ~(position | rotation))
        moved = straight + more(straight, position)
        turned = half = moved
        for _ in range(_ROUNDS if rotation.any() else 0):
            turned = moved + more(half, rotation)
            half = 0.5 * (moved + turned)
        gain = sum(self.values[self._places("gain")])  # g₀; zero where the gain is known
        return straight, half, turned / (1.0 - gain)

    def _places(self, symbol: str) -> list[int]:
        """Columns of such unknowns."""
        first = len(self.values) - len(self.parameters)
        own = enumerate(self.parameters, first)
        return [k for k, parameter in own if parameter.symbol.startswith(symbol)]

    @cached_property
    def _position(self) -> Bool[np.ndarray, " entries"]:
        return np.isin(self.pattern[1], self._places("position"))

    @cached_property
    def _rotation(self) -> Bool[np.ndarray, " entries"]:
        return np.isin(self.pattern[1], self._places("rotation"))


def is_of_pose(parameter: PriorParameter) -> bool:
    """Whether a sensor's unknown is an error of its place or its axes."""
    return parameter.symbol.startswith(("position", "rotation"))


def about(rows: SensorRows, values: Float[np.ndarray, " columns"]) -> RowsAbout:
    """Rows of a sensor about p₀ and values of its own unknowns.

    Args:
        rows: of the sensor.
        values: in the order of the columns, p first.
    """
    return RowsAbout(rows.name, rows, values)
