"""Whether a recording stays where the limbs reach: poses, singularities, branch, workspace."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.regularity import SINGULAR_CONDITION, Regularity
from deltaid.recording.branch import BranchCheck
from deltaid.recording.columns import Columns
from deltaid.recording.seen import Seen
from deltaid.recording.source import Table

# Rows between two places where time leaves off that show a passage from branch to branch.
_SHOWN = 4
_KEEP_AWAY = (
    "check zero and sign of the drives and the robot's lengths; a robot that does this cannot be "
    "held by its drives there, so keep the motion away from it"
)


class ReachCheck:
    """Running state of the check. Add all batches in order.

    Attributes:
        nearest, farthest: lowest and highest of the platform's coordinates so far [m].
    """

    def __init__(self, table: Table, columns: Columns, kinematics: Kinematics) -> None:
        self.table, self.columns, self.kinematics = table, columns, kinematics
        self.nearest, self.farthest = np.full(3, np.inf), np.full(3, -np.inf)
        self.branch = BranchCheck(kinematics)
        self.outside, self.first_outside = 0, ""
        self.strained, self.first_strained = 0, ""

    def add(self, seen: Seen, apart: Int[np.ndarray, " runs"]) -> None:
        """Check consecutive rows; `apart` are those before which time leaves off.

        Raises:
            RecordingError: with the first row that cannot be.
        """
        time, q = seen.batch.values[:, 0], seen.batch.values[:, 1 : 1 + self.kinematics.dof]
        z, regular, row = seen.z, seen.regular, seen.batch.row
        bad = np.flatnonzero(~seen.good)
        if bad.size:
            self._require_way(time, q, z, int(bad[0]), row, apart)
        points = self.kinematics.robot.task.point(z)
        self.nearest = np.minimum(self.nearest, points.min(axis=0))
        self.farthest = np.maximum(self.farthest, points.max(axis=0))
        singular = np.flatnonzero(~(regular.worst < SINGULAR_CONDITION))
        if singular.size:
            raise RecordingError(
                f"the robot is in a singular pose at {self._angles(q[singular[0]])}",
                where=self.table.row_place(row + int(singular[0])),
                cure="an arm and its struts are in line there, or the struts in one plane; check "
                "zero and sign of the drives, and the robot's lengths",
            )
        strained = np.flatnonzero(regular.worst > self.kinematics.robot.largest_condition)
        if strained.size and not self.strained:
            self.first_strained = f"row {row + int(strained[0])} at {time[strained[0]]:.6g} s"
        self.strained += strained.size
        self._check_branch(time, q, z, regular, row, apart)
        outside = np.flatnonzero(~self.kinematics.robot.workspace.contains(points))
        if outside.size and not self.outside:
            i = int(outside[0])
            x, y, height = points[i]
            self.first_outside = f"row {row + i} at [{x:.3f}, {y:.3f}, {height:.3f}] m"
        self.outside += outside.size

    def told(self, samples: int) -> list[Doubt]:
        """What is doubtful of so many samples: outside of the workspace, or near a singularity."""
        doubts: list[Doubt] = []
        if self.outside:
            doubts.append(
                Doubt(
                    f"{self.outside} of {samples} samples lie outside the workspace of the "
                    f"description, the first in {self.first_outside}",
                    cause="the robot uses more room than 'workspace' says",
                    cure="widen it; if the robot was not there, check its lengths and zeros",
                )
            )
        if self.strained:
            doubts.append(
                Doubt(
                    f"{self.strained} of {samples} samples are nearer to a singular pose than "
                    f"the description's largest_condition of "
                    f"{self.kinematics.robot.largest_condition:g}, the first in "
                    f"{self.first_strained}",
                    cause="a motion at the edge of what the limbs reach",
                    cure="keep away from it, for small errors of lengths and zeros are large there",
                )
            )
        return doubts

    def _check_branch(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        regular: Regularity,
        row: int,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        for start, stop in pairwise([0, *apart[apart > 0].tolist(), len(time)]):
            if start in apart:
                self.branch = BranchCheck(self.kinematics)
                if stop - start < _SHOWN and stop < len(time):
                    continue
            run = slice(start, stop)
            left = self.branch.add(time[run], q[run], z[run], regular.part(run))
            if left is not None:
                at, what = left
                place = f", at {self._angles(q[start + at])}" if at >= 0 else ""
                where = self.table.row_place(row + start + at)
                raise RecordingError(f"{what}{place}", where=where, cure=_KEEP_AWAY)

    def _require_way(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        bad: int,
        row: int,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        """Refuse the first sample without a pose, or a passage before it that explains it."""
        if bad:
            way = time[:bad], q[:bad], z[:bad]
            regular = self.kinematics.regularity(way[2])
            self._check_branch(*way, regular, row, apart[apart < bad])
        before = self.branch.last_condition
        reason = f"{self.kinematics.why_not(q[bad : bad + 1])} at {self._angles(q[bad])}"
        if before > self.kinematics.robot.largest_condition:
            raise RecordingError(
                f"the robot comes to a singular pose at {time[bad]:.6g} s: the condition number "
                f"is {before:.4g} in the row before, and here {reason}",
                where=self.table.row_place(row + bad),
                cure=_KEEP_AWAY,
            )
        raise RecordingError(
            f"{reason}, {time[bad]:.6g} s",
            where=self.table.row_place(row + bad),
            cure="check sign, zero, unit and order of the drives (angle 0 = arm horizontal and "
            "outwards, positive = down) and the robot's lengths",
        )

    def _angles(self, q: Float[np.ndarray, " dof"]) -> str:
        names = ", ".join(channel.column for channel in self.columns.position)
        linear = [self.kinematics.robot.is_linear(d) for d in self.kinematics.robot.drives]
        unit = "m" if all(linear) else "rad" if not any(linear) else "m and rad"
        return f"({names}) = ({', '.join(f'{value:.4g}' for value in q)}) {unit}"
