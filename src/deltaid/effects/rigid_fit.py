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

# Sweeps of a fit with a factor for each drive; directions below this share are excluded.
_SWEEPS, _SHOWN = 3, 0.05


@dataclass(frozen=True, eq=False)
class Candidate:
    """Columns that one effect would add, to first order in its size.

    Attributes:
        subject: the drive or joint; empty for all together.
        columns: as rows of all drives.
        words: what the torque follows, for messages.
        tries: how many of its like it was chosen from, as a decimal logarithm.
        detail: further results, such as times.
        is_preferred: whether it is taken where another explains little more: other checks judge
            it better.
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
        return self.trace.model(self.p)

    @cached_property
    def scaled_model(self) -> OfDrives:
        """Torques of parameters that are fitted together with a factor for every drive.

        τ_i = (1 + g_i) Y_i p, by Gauss–Newton. Hardly identifiable factors, such as one common to
        all, stay 1.
        """
        model = self.model
        for _ in range(_SWEEPS):
            columns = self.rows.own(model)
            residual = self.span.without(self.tau)
            gain = np.linalg.lstsq(self.span.without(columns), residual, rcond=_SHOWN)[0]
            model = self.Y @ self.span.coefficients(self.tau - columns @ gain)
        return model

    def column(self, name: str) -> OfDrives:
        return self.Y[:, :, np.searchsorted(active_columns(self.trace.dynamics), self._at(name))]

    def shows(self, name: str) -> bool:
        return self._at(name) in active_columns(self.trace.dynamics)

    def size(self, name: str) -> float:
        return float(self.p[self._at(name)])

    def _at(self, name: str) -> int:
        return self.trace.dynamics.layout.names.index(name)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Joints with friction that move."""
        entries = self.trace.entries(self.motion)
        joints = joints_of(self.trace.dynamics)
        speeds = ((joint, float(joint.speed(entries).max())) for joint in joints)
        return tuple(replace(joint, fastest=fastest) for joint, fastest in speeds if fastest > 0)

    def joint_columns(self, shapes: Sequence[tuple[Joint, Shape]]) -> Columns:
        """One column for each shape of a joint."""
        return self.rows.stack(joint_columns(self.trace, self.p, shapes))
