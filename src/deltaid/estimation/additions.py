"""Additional columns of the regression: lags, loads and other effects on torques.

A group of such columns is one `Addition`, a class in a file of its own. `Extended` puts them behind
the columns of a robot, so p of the fit is [p of the robot, values of the additions], and reduction,
solvers, base parameters and intervals treat all alike.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import ClassVar, TypeVar

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.information import Motion, entries_at
from deltaid.estimation.reduction import Free, free_coefficients
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PriorParameter

Values = Float[np.ndarray, "entries samples"]  # of a pattern, or channels
Own = Float[np.ndarray, "own samples"]
_Added = TypeVar("_Added", bound="Addition")
_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class Addition(ABC):
    """Additional columns, linear in their parameters; zero in recordings without them."""

    dynamics: Dynamics  # of the robot
    # whether the fit holds its parameters, while intervals count them as unknown
    is_held: ClassVar[bool] = False
    # whether it is an effect that the fit corrects, so that studies take it as known
    is_corrected: ClassVar[bool] = False

    @property
    @abstractmethod
    def parameters(self) -> tuple[PriorParameter, ...]: ...  # one a column

    @property
    @abstractmethod
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Drive and column of each entry that is not always zero; its columns count from 0."""

    @abstractmethod
    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        """The entries along consecutive samples w of a recording, at the full rate; `own` are the
        entries of the robot's regressor there."""

    def on(self, dynamics: Dynamics) -> "Addition":
        """The same for a robot with other friction laws."""
        return replace(self, dynamics=dynamics)

    @property
    def free(self) -> Free:
        """Free parameters of the fit: all, or none if they are held."""
        if not self.is_held:
            return free_coefficients(self.parameters)
        n = len(self.parameters)
        return Free((), np.zeros((n, 0)), np.zeros(n), ())

    @property
    def determines(self) -> tuple[str, ...]:
        """Prefixes of tolerances that its parameters determine."""
        return ()

    @property
    def scale_reference(self) -> str | None:
        """Words for a quantity known in kg or N m, which fixes the scale of torques."""
        return None

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return ()


@dataclass(frozen=True, eq=False)
class TorqueColumns(Addition):
    """Columns that depend on the torques of a robot and of other additions."""

    others: tuple[Addition, ...]  # the other additions
    p: Parameters  # of the robot, then of these

    def on(self, dynamics: Dynamics) -> "TorqueColumns":
        """The same for a robot with other friction laws; coefficients of new terms are zero."""
        if dynamics is self.dynamics:
            return self
        known = dict(zip(self._names, self.p.tolist(), strict=True))
        others = tuple(addition.on(dynamics) for addition in self.others)
        now = replace(self, dynamics=dynamics, others=others)
        return replace(now, p=np.array([known.get(name, 0.0) for name in now._names]))

    @property
    def _names(self) -> list[str]:
        added = [entry.name for addition in self.others for entry in addition.parameters]
        return [*self.dynamics.layout.names, *added]

    def torques(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        """τ of each drive, with the torques of loads."""
        values = np.vstack([own, *(term.entries(w, own, recording) for term in self.others)])
        return w.carried.T + torques_of(self._columns, self.dynamics.dof, values, self.p)

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and parameter of every entry of torques."""
        return extended(self.dynamics, self.others).regressor_pattern


@dataclass(frozen=True, eq=False)
class Extended:
    """The columns of a robot's regressor, then those of additions."""

    regressor: Dynamics
    robot_columns: int  # number of the robot's columns
    additions: tuple[Addition, ...]

    @property
    def kinematics(self) -> Kinematics:
        return self.regressor.kinematics

    @property
    def dof(self) -> int:
        return self.regressor.dof

    @property
    def regressor_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and column of every entry that is not always zero."""
        return self._pattern  # a property for type checkers: protocols have one

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray]:
        patterns, first = [self.regressor.regressor_pattern], self.robot_columns
        for addition in self.additions:
            drives, within = addition.pattern
            patterns.append((drives, first + within))
            first += len(addition.parameters)
        drives, columns = (np.concatenate(part) for part in zip(*patterns, strict=True))
        return drives, columns

    def carried(self, z: Motion, qd: Motion, qdd: Motion, p: Parameters) -> Motion:
        """Torques that gears carry, by parameters of the robot or of all columns."""
        return self.regressor.carried(z, qd, qdd, p[: self.robot_columns])


def extended(dynamics: Dynamics, additions: Sequence[Addition] = ()) -> Extended:
    """The regressor of a robot with additions."""
    behind = tuple(addition.on(dynamics) for addition in additions)
    return Extended(dynamics, len(dynamics.layout.names), behind)


def split_by_addition(
    additions: Sequence[_Added], values: Iterable[_Value]
) -> Iterator[tuple[_Added, tuple[_Value, ...]]]:
    """Each addition with its part of values in the order of all additions' parameters."""
    rest = iter(values)
    return ((addition, tuple(islice(rest, len(addition.parameters)))) for addition in additions)


def torques_of(
    pattern: tuple[np.ndarray, np.ndarray], dof: int, values: Values, p: Parameters
) -> Float[np.ndarray, "dof samples"]:
    """Torques of p by entries with their drives and columns: one matrix product."""
    drives, columns = pattern
    weights = np.zeros((dof, len(drives)))
    weights[drives, np.arange(len(drives))] = p[columns]
    return weights @ values


def entries(
    regressor: Extended, w: SampleBlock, load: Motion | None, recording: PreparedRecording
) -> Values:
    """Entries of Y along some samples of a recording, in the order of the pattern; `load` is the
    torque of gears that load friction uses, None for a robot without it."""
    own = entries_at(regressor.regressor, w.z, w.qd, w.qdd, load)
    if not regressor.additions:
        return own  # no copy
    return np.vstack([own, *(more.entries(w, own, recording) for more in regressor.additions)])
