"""All rows of a fit: the drives' torques, then sensors; and measured values.

A sensor measures y = C p + D u with the unknowns u of its own (`sensors.rows`). Loads add to it as
to torques: a load's columns are its carrier's while it is held, and the part of a load that was
subtracted from the torques is subtracted from readings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import parameter_layout
from deltaid.effects.load_columns import WELL_KNOWN, LoadColumns
from deltaid.estimation.additions import Addition, Extended, Own, Values, entries
from deltaid.estimation.information import active_columns
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.carried import carrier
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock, Window
from deltaid.robot.parameter import PriorParameter
from deltaid.sensors.robot_sensors import sensor_rows
from deltaid.sensors.rows import Pattern, SensorRows, is_of_pose
from deltaid.sensors.weighings import Weighing

PerRow = Float[np.ndarray, "rows samples"]


@dataclass(frozen=True, eq=False)
class SensorAddition(Addition):
    """One sensor in a fit: its unknowns, which have no entries in torques, and its rows."""

    rows: SensorRows  # by the robot's parameters and the sensor's unknowns
    prior_spread: float  # of the fit; scales of parameters are relative to it
    # parameters by name about which gain and pose are linearised; the prior if missing
    known: Mapping[str, float] = field(default_factory=dict[str, float])

    @classmethod
    def for_sensor(
        cls,
        dynamics: Dynamics,
        name: str,
        prior_spread: float,
        known: Mapping[str, float] | None = None,
    ) -> "SensorAddition":
        """A sensor by its name in the description; `known` as of the class."""
        rows = sensor_rows(dynamics, name, dynamics.robot.sensors[name], prior_spread)
        columns = cls(dynamics, rows, prior_spread, known or {})
        if not columns.is_bilinear:
            return columns
        parameters = (*dynamics.layout.parameters, *rows.parameters)
        values = [columns.known.get(entry.name, entry.prior) for entry in parameters]
        return replace(columns, rows=rows.about(np.array(values)))

    @property
    def is_bilinear(self) -> bool:
        """Whether some columns depend on the expected reading, and so on parameters."""
        return any(entry.symbol == "gain" or is_of_pose(entry) for entry in self.rows.parameters)

    def on(self, dynamics: Dynamics) -> "SensorAddition":
        same, name = dynamics is self.dynamics, self.rows.name
        return self if same else self.for_sensor(dynamics, name, self.prior_spread, self.known)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return self.rows.parameters

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return np.zeros((0, len(w.time)))

    @property
    def scale_reference(self) -> str | None:
        is_sure = self.dynamics.robot.sensors[self.rows.name].gain_tolerance <= WELL_KNOWN
        return f"sensor {self.rows.name}" if is_sure else None

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        own = f".{self.rows.name}"
        names = ", ".join(entry.name.removesuffix(own).replace("_", " ") for entry in judged)
        words = f"; unknown of itself and found with the robot: {names}" if names else ""
        text = f"what it showed was fitted with the torques, in its own units{words}"
        return (Correction(kind="sensor", subject=self.rows.name, text=text),)


@dataclass(frozen=True, eq=False)
class SensorPart:
    """The rows of one sensor among those of a fit."""

    columns: SensorAddition
    rows: slice  # of its channels among all rows
    first: int  # place of its unknowns among all parameters
    pattern: Pattern  # row and column of each entry, as of the fit; those of loads last
    # each load with the entries of its carrier
    loads: tuple[tuple[LoadColumns, Int[np.ndarray, " _"]], ...]

    @classmethod
    def placed(
        cls, sensor: SensorAddition, row: int, first: int, loads: Sequence[tuple[LoadColumns, int]]
    ) -> "SensorPart":
        """A sensor whose channels are rows from `row` on, and its unknowns columns from `first` on,
        beside loads with their first columns."""
        layout, (channels, columns) = sensor.dynamics.layout, sensor.rows.pattern
        count = len(layout.names)
        rows, places = [channels], [np.where(columns < count, columns, columns - count + first)]
        carried = [(load, load.carried(columns)) for load, _ in loads]
        for (load, loaded), (_, start) in zip(carried, loads, strict=True):
            rows.append(channels[loaded])
            places.append(columns[loaded] - layout.body(load.body).start + start)
        pattern = row + np.concatenate(rows), np.concatenate(places)
        place = slice(row, row + len(sensor.rows.channels))
        return cls(sensor, place, first, pattern, tuple(carried))

    def shown(self, w: SampleBlock, recording: PreparedRecording) -> tuple[PerRow, PerRow]:
        """Its readings along samples, and weights; zero where there is no number."""
        signals = recording.log.columns.shown(w.extra).get(self.columns.rows.name)
        if signals is None:
            nothing = np.zeros((len(self.columns.rows.channels), len(w.time)))
            return nothing, nothing
        counts = np.isfinite(signals)
        # A cause that excludes one drive's torque, such as clipping, does not reach a sensor; one
        # that excludes all drives does.
        return np.where(counts, signals, 0.0), counts * w.weights.max(axis=1, initial=0.0)

    def weighted(self, w: SampleBlock, recording: PreparedRecording) -> tuple[Values, PerRow]:
        """Entries and readings along samples, weighted."""
        rows, log, dynamics = self.columns.rows, recording.log, self.columns.dynamics
        y, weights = self.shown(w, recording)
        if not weights.any():
            return np.zeros((len(self.pattern[0]), len(w.time))), weights
        Y = rows.entries(w.z, w.qd, w.qdd, y)
        channels, columns = rows.pattern
        held = log.columns.held(w.time, w.extra)
        # Loads whose torques have been subtracted from the recording are subtracted here.
        for load, p, state in zip(log.columns.loads, recording.repairs.loads, held, strict=False):
            values = np.zeros(len(dynamics.layout.names) + len(rows.parameters))
            values[dynamics.layout.body(carrier(load, dynamics.robot))] = p
            np.add.at(y, channels, -Y * values[columns][:, None] * state)
        all_rows = np.vstack([Y, *(Y[k] * load.held(w, recording) for load, k in self.loads)])
        return all_rows * weights[self.pattern[0] - self.rows.start], y * weights


@dataclass(frozen=True, eq=False)
class LoadSlope:
    """Linearisation of load friction about the loads of gears.

    Losses μ s |x| with the load x = X p and s = sign(q̇) are not linear. About the parameters p₀ of
    the fit before, with x₀ = X p₀,

        μ s |x| ≈ μ s |x₀| + μ₀ s sign(x₀) X (p − p₀),

    so columns of loads are multiplied by 1 + μ₀ s sign(x₀), and μ₀ s sign(x₀) x₀ is added to
    torques. Without the second term x₀ would stay at its prior where torques alone do not determine
    a gear's load: where only the sum of a rotor and the inertia behind its gear is identifiable.
    """

    # μ₀ of each drive; zero where friction does not depend on load
    shares: Float[np.ndarray, " dof"]
    drives: Int[np.ndarray, " entries"]  # of each entry of the regressor
    # whether an entry belongs to X: neither friction nor rotor of the drive's motor
    carried: Bool[np.ndarray, " entries"]

    @classmethod
    def about(cls, regressor: Extended, p: Parameters) -> "LoadSlope":
        """About parameters p of the robot; entries of additions do not belong to X."""
        robot = regressor.kinematics.robot
        layout, (drives, columns) = parameter_layout(robot), regressor.regressor_pattern
        of_links = [
            k for k, parameter in enumerate(layout.parameters)
            if not (parameter.owner in robot.drives and parameter.kind in ("friction", "rotor"))
        ]  # fmt: skip
        values = layout.named(p)
        shares = np.array([values.get(f"load.{drive}", 0.0) for drive in robot.drives])
        return cls(shares, drives, np.isin(columns, of_links))

    def factor(self, w: SampleBlock, x: Float[np.ndarray, "samples dof"]) -> PerRow:
        """μ₀ s sign(x₀) of each drive for loads x of gears."""
        return (self.shares * np.sign(w.qd) * np.sign(x)).T

    def scaled(self, entries: Values, factor: PerRow) -> Values:
        return entries * (1.0 + self.carried[:, None] * factor[self.drives])


class FilteredRows(NamedTuple):
    """Rows of a fit at filtered samples of a window, weighted."""

    entries: Values  # in the order of the pattern
    y: PerRow  # torques, then readings
    counted: PerRow  # number of samples that each counts for


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Rows and columns of a fit."""

    regressor: Extended  # the columns of torques
    weighings: tuple[Weighing, ...] = ()  # measured values of p

    @property
    def drives(self) -> int:
        return self.regressor.dof

    @property
    def dof(self) -> int:
        return self.sensors[-1].rows.stop if self.sensors else self.drives

    @property
    def known_columns(self) -> Int[np.ndarray, " _"]:
        known = [weighing.coefficients != 0 for weighing in self.weighings]
        return np.flatnonzero(np.any(known, axis=0))

    @cached_property
    def active(self) -> Int[np.ndarray, " columns"]:
        return active_columns(self)

    @property
    def regressor_pattern(self) -> Pattern:
        """Row and column of every entry that is not always zero."""
        patterns = [self.regressor.regressor_pattern, *(part.pattern for part in self.sensors)]
        rows, columns = (np.concatenate(part) for part in zip(*patterns, strict=True))
        return rows, columns

    @cached_property
    def sensors(self) -> tuple[SensorPart, ...]:
        additions, sizes = self.regressor.additions, [self.regressor.robot_columns]
        sizes += [len(addition.parameters) for addition in additions]
        placed = list(zip(additions, np.cumsum(sizes).tolist(), strict=False))
        loads = [
            (addition, first)
            for addition, first in placed
            if isinstance(addition, LoadColumns) and not addition.is_fixed
        ]
        row, sensors = self.drives, list[SensorPart]()
        for addition, first in placed:
            if isinstance(addition, SensorAddition):
                sensors.append(SensorPart.placed(addition, row, first, loads))
                row = sensors[-1].rows.stop
        return tuple(sensors)

    def filtered(
        self, window: Window, recording: PreparedRecording, load: Parameters | None = None
    ) -> FilteredRows:
        """All rows in a window, weighted, filtered and thinned alike; `load` as of `gather`."""
        regressor, sensors = self.regressor, self.sensors
        drives, _ = regressor.regressor_pattern
        slope = LoadSlope.about(regressor, load) if load is not None else None

        def weighted(w: SampleBlock) -> Values:
            x, tau = w.tau + w.carried, w.tau.T
            carried = np.zeros_like(x)
            if load is not None:
                carried = regressor.carried(w.z, w.qd, w.qdd, load)
                x = carried + w.carried
            Y = entries(regressor, w, x, recording)
            if slope is not None:
                factor = slope.factor(w, x)
                Y, tau = slope.scaled(Y, factor), tau + factor * carried.T
            shown = [part.weighted(w, recording) for part in sensors]
            torques = w.weighted(Y, drives), w.weighted(tau, np.arange(len(tau)))
            return np.vstack([part[k] for k in (0, 1) for part in (torques, *shown)])

        values = window.filtered(weighted)
        weights = [window.wide.weights.T]
        weights += [part.shown(window.wide, recording)[1] for part in sensors]
        counted = [window.counted(window.low_pass.thinned, part) for part in weights]
        return FilteredRows(values[: -self.dof], values[-self.dof :], np.vstack(counted))
