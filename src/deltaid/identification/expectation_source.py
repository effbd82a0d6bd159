"""Whose torques are expected: a recording, and the columns that explain them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Dynamics, Regressor
from deltaid.estimation.additions import Addition, Extended, entries, extended
from deltaid.estimation.information import active_columns
from deltaid.recording.masks.directions import Directions
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Torques may be late by so much [s] before that is known; a reversal says nothing for so long.
_APART = 5e-3


@dataclass(frozen=True, eq=False)
class Source:
    """Whose torques are expected: a recording, and the columns that explain them.

    Attributes:
        dynamics: of the robot.
        additions: columns beside the robot's.
        recording: with the repairs that are known.
    """

    dynamics: Dynamics
    additions: tuple[Addition, ...]
    recording: Recording

    @cached_property
    def regressor(self) -> Regressor | Extended:
        """All columns."""
        return extended(self.dynamics, self.additions)

    @cached_property
    def active(self) -> Int[np.ndarray, " active"]:
        """Columns that show in some torque."""
        return active_columns(self.regressor)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the active columns."""
        more = (parameter for one in self.additions for parameter in one.parameters)
        every = (*self.dynamics.layout.parameters, *more)
        return tuple(every[k] for k in self.active)

    @cached_property
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Drive of each entry, and place of its column among the active ones."""
        rows, columns = self.regressor.regressor_pattern
        return rows, np.searchsorted(self.active, columns)

    def entries(self, w: Samples) -> Float[np.ndarray, "entries samples"]:
        """Of the regressor, in the order of the pattern."""
        return entries(self.regressor, w, w.tau, self.recording)

    def torques(
        self, values: Float[np.ndarray, "entries samples"], p: Float[np.ndarray, " active"]
    ) -> Float[np.ndarray, "dof samples"]:
        """Y p from the entries of Y."""
        rows, at = self.pattern
        return np.stack([p[at[rows == i]] @ values[rows == i] for i in range(self.dynamics.dof)])

    def counts(self, w: Samples) -> Bool[np.ndarray, "dof samples"]:
        """Whether a drive's torque counts, and all directions of friction in it are known."""
        known = Directions(np.inf, np.zeros(self.dynamics.dof)).known(
            self.dynamics.kinematics, w.z, w.qd, w.qdd, within=_APART
        )
        return ((w.weights > 0.5) & known).T
