"""Rows of a sensor about values that are known so far: its gain and its pose see no noise.

A gain's column is what the sensor shows. Taken as measured, column and y share their noise, and
‖(1 − g) y − C p‖² falls with every g towards one: at a noise of a few per cent of the signal the
gain comes out many standard deviations off. So it is taken as what some values say,

    ŷ = (C p₀ + b₀) / (1 − g₀),

and the fit repeated about what it gives, until it settles.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.robot.parameter import Parameter
from deltaid.sensors.rows import Motion, SensorChannel, SensorRows


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
    def parameters(self) -> tuple[Parameter, ...]:
        return self.rows.parameters

    @property
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        return self.rows.pattern

    def entries(
        self, z: Motion, qd: Motion, qdd: Motion, shown: Float[np.ndarray, "channels samples"]
    ) -> Float[np.ndarray, "entries samples"]:
        return self.rows.entries(z, qd, qdd, self.expected(z, qd, qdd))

    def expected(self, z: Motion, qd: Motion, qdd: Motion) -> Float[np.ndarray, "channels samples"]:
        """ŷ, without errors of the pose."""
        channels, columns = self.pattern
        expected = np.zeros((len(self.channels), len(z)))
        own = self.rows.entries(z, qd, qdd, expected)
        np.add.at(expected, channels, own * self.values[columns][:, None])
        return expected / (1.0 - self._gain)

    @property
    def _gain(self) -> float:
        """g₀; zero where the gain is known."""
        first = len(self.values) - len(self.parameters)
        found = [k for k, one in enumerate(self.parameters, start=first) if one.symbol == "gain"]
        return float(self.values[found[0]]) if found else 0.0


def about(rows: SensorRows, values: Float[np.ndarray, " columns"]) -> RowsAbout:
    """Rows of a sensor about p₀ and values of its own unknowns.

    Args:
        rows: of the sensor.
        values: in the order of the columns, p first.
    """
    return RowsAbout(rows.name, rows, values)
