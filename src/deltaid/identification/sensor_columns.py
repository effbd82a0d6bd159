"""A sensor beside the drives as part of a fit: its own unknowns are columns, what it shows is rows.

Drives' torques have no entry in its columns; `measured_rows.MeasuredRows` puts its rows below
theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.identification.additions import Addition, Own, Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter
from deltaid.sensors.of_robot import sensor_rows
from deltaid.sensors.rows import SensorRows

# A sensor whose gain is known no better than this says less of torques than torque constants do.
_SURE = 0.02


@dataclass(frozen=True, eq=False)
class SensorColumns(Addition):
    """One sensor.

    Attributes:
        dynamics: of the robot.
        rows: what it shows of robot and unknowns.
        prior_spread: of the fit, which all scales of parameters are relative to.
    """

    dynamics: Dynamics
    rows: SensorRows
    prior_spread: float

    @classmethod
    def of(cls, dynamics: Dynamics, name: str, prior_spread: float) -> "SensorColumns":
        """A sensor of a robot by its name in the description."""
        sensor = dynamics.robot.sensors[name]
        return cls(dynamics, sensor_rows(dynamics, name, sensor, prior_spread), prior_spread)

    def on(self, dynamics: Dynamics) -> "SensorColumns":
        if dynamics is self.dynamics:
            return self
        return self.of(dynamics, self.rows.name, self.prior_spread)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.rows.parameters

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        return np.zeros((0, len(w.time)))

    @property
    def is_absolute(self) -> bool:
        return self.dynamics.robot.sensors[self.rows.name].gain_tolerance <= _SURE

    @property
    def witness(self) -> str:
        return self.rows.name

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        shown = ", ".join(_told(self.rows.name, one) for one in judged)
        text = "what it showed was fitted with the torques, in its own units"
        if judged:
            text += f"; of the sensor itself this tells {shown}"
        return (Correction(kind="sensor", subject=self.rows.name, text=text),)


def _told(sensor: str, one: Judged) -> str:
    """One of its unknowns: value, half width of the interval, and what decided it."""
    what = one.name.removesuffix(f".{sensor}").replace("_", " ")
    unit = f" {one.unit}" if one.unit else ""
    how = "" if one.determined_by == "data" else " (its prior)"
    return f"{what} {one.value:.4g} ± {1.96 * one.std:.2g}{unit}{how}"
