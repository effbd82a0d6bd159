"""A recording before its effects are known: its rows, what parameters explain, what they leave."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.joint import Joint, Shape, joint_columns, joints_of
from deltaid.estimation.drive_rows import ColumnsOfDrives, DriveRows, OfDrives
from deltaid.estimation.information import active_columns
from deltaid.estimation.span import Columns, Rows, Span
from deltaid.estimation.trace_rows import parameters_of
from deltaid.estimation.traces import Trace
from deltaid.recording.windows import Samples

# Sweeps of a fit with a factor for each drive; directions that show less are left out.
_SWEEPS, _SHOWN = 3, 0.05


@dataclass(frozen=True, eq=False)
class Candidate:
    """Columns that one effect would add, to first order in its size.

    Attributes:
        subject: the drive or joint; empty for all together.
        columns: as rows of all drives.
        words: what the torque follows, for messages.
        tries: how many of its like it was chosen from, as a decimal logarithm.
        detail: what was found beside, such as times.
        is_preferred: whether it is taken where another explains little more: other checks know
            better of it.
        bends: whether it bends with the place of the platform.
    """

    kind: str
    subject: str
    columns: Columns
    words: str = ""
    tries: float = 0.0
    detail: tuple[float, ...] = ()
    is_preferred: bool = False
    bends: bool = False


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A recording, what parameters explain of it, and the fitted parameters.

    Attributes:
        Y: the active columns of its regressor, filtered.
        rows, span: its samples as rows, and what these columns explain of them.
        tau: its torques as rows.
    """

    trace: Trace
    Y: ColumnsOfDrives
    rows: DriveRows
    span: Span
    tau: Rows

    @cached_property
    def p(self) -> Parameters:
        """Of least squares."""
        return parameters_of(self.trace.dynamics, self.span, self.tau)

    @property
    def drives(self) -> tuple[str, ...]:
        return self.trace.dynamics.robot.drives

    @cached_property
    def motion(self) -> Samples:
        """At the filtered samples."""
        return self.trace.motion()

    @cached_property
    def q(self) -> Float[np.ndarray, "samples dof"]:
        """Positions of the drives at the filtered samples."""
        return self.trace.dynamics.kinematics.inverse(self.motion.z)

    @cached_property
    def model(self) -> OfDrives:
        """Torques of p."""
        return self.trace.model(self.p)

    @cached_property
    def scaled_model(self) -> OfDrives:
        """Torques of parameters that are fitted together with a factor for every drive.

        τ_i = (1 + g_i) Y_i p, by Gauss–Newton. What torques hardly show of the factors, such as one
        common to all, stays 1.
        """
        model = self.model
        for _ in range(_SWEEPS):
            own = self.rows.own(model)
            left = self.span.without(self.tau)
            gain = np.linalg.lstsq(self.span.without(own), left, rcond=_SHOWN)[0]
            model = self.Y @ self.span.coefficients(self.tau - own @ gain)
        return model

    def column(self, name: str) -> OfDrives:
        """One parameter's column of Y."""
        return self.Y[:, :, np.searchsorted(active_columns(self.trace.dynamics), self._at(name))]

    def shows(self, name: str) -> bool:
        """Whether a parameter has a column."""
        return self._at(name) in active_columns(self.trace.dynamics)

    def size(self, name: str) -> float:
        """One of the fitted parameters."""
        return float(self.p[self._at(name)])

    def _at(self, name: str) -> int:
        return self.trace.dynamics.layout.names.index(name)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Joints with friction that move."""
        entries = self.trace.entries(self.motion)
        found = ((one, float(one.speed(entries).max())) for one in joints_of(self.trace.dynamics))
        return tuple(replace(one, fastest=fastest) for one, fastest in found if fastest > 0)

    def joint_columns(self, wanted: Sequence[tuple[Joint, Shape]]) -> Columns:
        """One column for each shape of a joint."""
        return self.rows.stack(joint_columns(self.trace, self.p, wanted))
