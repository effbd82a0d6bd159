"""A sensor beside the drives as part of a fit: its own unknowns are columns, what it shows is rows.

Drives' torques have no entry in its columns; `measured_rows.MeasuredRows` puts its rows below
theirs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter
from deltaid.sensors.about import about, is_of_pose
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
        known: parameters by their names that gain and pose are seen from; the prior if left out.
    """

    dynamics: Dynamics
    rows: SensorRows
    prior_spread: float
    known: Mapping[str, float] = field(default_factory=dict[str, float])

    @classmethod
    def of(
        cls,
        dynamics: Dynamics,
        name: str,
        prior_spread: float,
        known: Mapping[str, float] | None = None,
    ) -> "SensorColumns":
        """A sensor of a robot by its name in the description."""
        known = known or {}
        rows = sensor_rows(dynamics, name, dynamics.robot.sensors[name], prior_spread)
        found = cls(dynamics, rows, prior_spread, known)
        if not found.is_bilinear:
            return found
        every = (*dynamics.layout.parameters, *rows.parameters)
        values = np.array([known.get(one.name, one.prior) for one in every])
        return cls(dynamics, about(rows, values), prior_spread, known)

    @property
    def is_bilinear(self) -> bool:
        """Whether some of its columns go by what it should show, and so by other parameters."""
        return any(one.symbol == "gain" or is_of_pose(one) for one in self.rows.parameters)

    def on(self, dynamics: Dynamics) -> "SensorColumns":
        return self if dynamics is self.dynamics else self.seen_from(dynamics, self.known)

    def seen_from(self, dynamics: Dynamics, known: Mapping[str, float]) -> "SensorColumns":
        """The same beside the columns of a robot, its gain and pose seen from other parameters."""
        return self.of(dynamics, self.rows.name, self.prior_spread, known)

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
        return f"sensor {self.rows.name}"

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        names = [one.name.removesuffix(f".{self.rows.name}").replace("_", " ") for one in judged]
        own = f"; unknown of itself and found with the robot: {', '.join(names)}" if names else ""
        text = f"what it showed was fitted with the torques, in its own units{own}"
        return (Correction(kind="sensor", subject=self.rows.name, text=text),)
