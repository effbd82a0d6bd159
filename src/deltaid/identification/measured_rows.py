"""All rows of a fit: the drives' torques, then sensors; and measured values.

A sensor measures y = C p + D u of the robot and its own unknowns (`sensors.rows`). What the robot
holds adds to it as to torques: a load's columns are its carrier's while it is held, and what has
been subtracted from the torques is subtracted here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Regressor
from deltaid.effects.load_columns import LoadColumns
from deltaid.estimation.additions import Addition, Extended, Own, Values
from deltaid.estimation.information import Chunk, active_columns
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.carried import carrier
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples, Window
from deltaid.robot.parameter import Parameter
from deltaid.sensors.about import RowsAbout, about, is_of_pose
from deltaid.sensors.graph_rows import GraphRows, Pattern
from deltaid.sensors.of_robot import sensor_rows
from deltaid.sensors.rows import SensorRows
from deltaid.sensors.weighings import Weighing

# A sensor whose gain is known no better than this determines torques worse than torque constants.
_SURE = 0.02

PerChannel = Float[np.ndarray, "channels samples"]


@dataclass(frozen=True, eq=False)
class SensorColumns(Addition):
    """One sensor as part of a fit: its unknowns, which torques have no entry of, and its rows.

    Attributes:
        dynamics: of the robot.
        rows: what it shows of robot and unknowns.
        prior_spread: of the fit, which all scales of parameters are relative to.
        known: parameters by name about which gain and pose are linear; the prior if missing.
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
        columns = cls(dynamics, rows, prior_spread, known)
        if not columns.is_bilinear:
            return columns
        parameters = (*dynamics.layout.parameters, *rows.parameters)
        values = np.array([known.get(entry.name, entry.prior) for entry in parameters])
        return cls(dynamics, about(rows, values), prior_spread, known)

    @property
    def is_bilinear(self) -> bool:
        """Whether some columns depend on its expected reading, and so on other parameters."""
        return any(entry.symbol == "gain" or is_of_pose(entry) for entry in self.rows.parameters)

    def on(self, dynamics: Dynamics) -> "SensorColumns":
        return self if dynamics is self.dynamics else self.seen_from(dynamics, self.known)

    def seen_from(self, dynamics: Dynamics, known: Mapping[str, float]) -> "SensorColumns":
        """The same for a robot, its gain and pose linear about other parameters."""
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
        names = [
            entry.name.removesuffix(f".{self.rows.name}").replace("_", " ") for entry in judged
        ]
        words = f"; unknown of itself and found with the robot: {', '.join(names)}" if names else ""
        text = f"what it showed was fitted with the torques, in its own units{words}"
        return (Correction(kind="sensor", subject=self.rows.name, text=text),)


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """Readings of all sensors at filtered samples, entries of their rows there, and how many
    samples each is worth."""

    values: Values
    y: PerChannel
    counted: PerChannel


@dataclass(frozen=True, eq=False)
class SensorPart:
    """The rows of one sensor among those of a fit.

    Attributes:
        first: place of its unknowns among all parameters.
        pattern: channel and column of each entry, columns as of the fit; those of loads last.
        loads: each load with the entries of its carrier.
    """

    columns: SensorColumns
    first: int
    pattern: Pattern
    loads: tuple[tuple[LoadColumns, Int[np.ndarray, " _"]], ...]

    @property
    def channels(self) -> int:
        return len(self.columns.rows.channels)

    @property
    def graph(self) -> GraphRows:
        """Its rows without what is known of gain and pose."""
        rows = self.columns.rows
        rows = rows.rows if isinstance(rows, RowsAbout) else rows
        assert isinstance(rows, GraphRows)
        return rows

    def unknowns(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " own"]:
        """Its unknowns among all parameters."""
        return values[self.first : self.first + len(self.columns.parameters)]

    def shown(self, w: Samples, recording: Recording) -> tuple[PerChannel, PerChannel]:
        """Its readings along samples, and weights; zero where there is no number."""
        signals = recording.log.columns.shown(w.extra).get(self.columns.rows.name)
        if signals is None:
            nothing = np.zeros((self.channels, len(w.time)))
            return nothing, nothing
        counts = np.isfinite(signals)
        # What makes the torque of one drive useless, such as its own friction or clipping, does not
        # reach a sensor; what makes all of them useless does.
        return np.where(counts, signals, 0.0), counts * w.weights.max(axis=1, initial=0.0)

    def of(self, w: Samples, recording: Recording) -> tuple[Values, PerChannel, PerChannel]:
        """Entries, readings, and weights, along samples; the first two weighted."""
        rows, log, dynamics = self.columns.rows, recording.log, self.columns.dynamics
        y, weights = self.shown(w, recording)
        if not weights.any():
            return np.zeros((len(self.pattern[0]), len(w.time))), weights, weights
        Y = rows.entries(w.z, w.qd, w.qdd, y)
        channels, columns = rows.pattern
        held = log.columns.held(w.time, w.extra)
        # Loads whose torques have been subtracted from the recording are subtracted here.
        for load, p, state in zip(log.columns.loads, recording.repairs.loads, held, strict=False):
            values = np.zeros(len(dynamics.layout.names) + len(rows.parameters))
            values[dynamics.layout.body(carrier(load, dynamics.robot))] = p
            np.add.at(y, channels, -Y * values[columns][:, None] * state)
        all_rows = np.vstack([Y, *(Y[k] * load.held(w, recording) for load, k in self.loads)])
        return all_rows * weights[self.pattern[0]], y * weights, weights


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Rows and columns of a fit.

    Attributes:
        regressor: the columns of torques.
        weighings: what is known of p without a recording.
    """

    regressor: Regressor | Extended
    weighings: tuple[Weighing, ...] = ()

    @property
    def drives(self) -> int:
        return self.regressor.dof

    @property
    def dof(self) -> int:
        return self.drives + self.channels

    @property
    def channels(self) -> int:
        return sum(part.channels for part in self.sensors)

    @property
    def known_columns(self) -> Int[np.ndarray, " _"]:
        """Columns in weighings."""
        columns = [np.flatnonzero(weighing.coefficients) for weighing in self.weighings]
        return np.concatenate([np.zeros(0, dtype=int), *columns])

    @cached_property
    def active(self) -> Int[np.ndarray, " columns"]:
        """All columns that some row has."""
        return active_columns(self)

    @property
    def regressor_pattern(self) -> Pattern:
        """Row and column of every entry that is not always zero."""
        rows, columns = (list(part) for part in zip(self.regressor.regressor_pattern, strict=True))
        first = self.drives
        for part in self.sensors:
            rows.append(first + part.pattern[0])
            columns.append(part.pattern[1])
            first += part.channels
        return np.concatenate(rows), np.concatenate(columns)

    @cached_property
    def sensors(self) -> tuple[SensorPart, ...]:
        if not isinstance(self.regressor, Extended):
            return ()
        first, sensors, loads = self.regressor.own, list[tuple[SensorColumns, int]](), []
        for addition in self.regressor.additions:
            if isinstance(addition, SensorColumns):
                sensors.append((addition, first))
            if isinstance(addition, LoadColumns) and not addition.is_fixed:
                loads.append((addition, first))
            first += len(addition.parameters)
        return tuple(_part(sensor, start, self.regressor.own, loads) for sensor, start in sensors)

    def shown(self, window: Window, recording: Recording) -> SensorSamples | None:
        """Readings of the sensors in a window, weighted, filtered and thinned; None without any."""
        if not self.sensors:
            return None
        entries = len(self.regressor_pattern[0]) - len(self.regressor.regressor_pattern[0])

        def of(w: Samples) -> Values:
            parts = [part.of(w, recording) for part in self.sensors]
            return np.vstack([*(part[0] for part in parts), *(part[1] for part in parts)])

        filtered = window.filtered(of)
        weights = np.vstack([part.shown(window.wide, recording)[1] for part in self.sensors])
        counted = window.worth(weights, window.thinned)
        return SensorSamples(filtered[:entries], filtered[entries:], counted)

    def chunks(self, sensed: SensorSamples, part: slice) -> list[Chunk]:
        """Each channel's rows of [C, y], as `chunks_of_drives` has those of drives."""
        rows, columns = self.regressor_pattern
        mine = rows >= self.drives
        channels, cols = rows[mine] - self.drives, np.searchsorted(self.active, columns[mine])
        return [
            (
                np.append(cols[channels == k], len(self.active)),
                np.vstack([sensed.values[channels == k, part], sensed.y[k, part]]),
            )
            for k in range(self.channels)
        ]


def _part(
    sensor: SensorColumns, first: int, own: int, loads: Sequence[tuple[LoadColumns, int]]
) -> SensorPart:
    """A sensor whose unknowns are columns from `first` on, with a robot's `own` columns."""
    channels, columns = sensor.rows.pattern
    count = len(sensor.dynamics.layout.names)
    assert count == own or not np.any(columns >= own), "unknowns follow the robot's columns"
    rows, places = [channels], [np.where(columns < count, columns, columns - count + first)]
    carried = list[tuple[LoadColumns, Int[np.ndarray, " _"]]]()
    for load, start in loads:
        entries = load.carried(columns)
        carried.append((load, entries))
        rows.append(channels[entries])
        places.append(columns[entries] - sensor.dynamics.layout.body(load.body).start + start)
    return SensorPart(sensor, first, (np.concatenate(rows), np.concatenate(places)), tuple(carried))
