"""Checks that a recording stays within reach of the limbs: poses, singularities, branch, workspace.

A motion that stays on one branch of the forward kinematics crosses no singularity.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.regularity import SINGULAR_CONDITION, Regularity, passages
from deltaid.recording.columns import Columns
from deltaid.recording.source import LogTable

# Consecutive rows that reveal a passage from branch to branch: two before it, two after it.
_PASSAGE = 4
# Ratio of a platform's step to the step that the drives explain above which it is a jump; and least
# step of drives that counts, the resolution of an encoder [rad or m].
_JUMP, _STILL = 10.0, 1e-6
# Condition number of J above which a robot without a closed form may have changed its branch
# unnoticed: due to steps δ of an encoder, 1/cond is about √δ at a passage instead of zero.
_LOST = 200.0
_KEEP_AWAY = (
    "check zero and sign of the drives and the robot's lengths; a robot that does this cannot be "
    "held by its drives there, so keep the motion away from it"
)
_CHECK = "check sign, zero, unit and order of the drives{} and the robot's lengths"
_ANGLES = " (angle 0 = arm horizontal and outwards, positive = down)"


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive samples: times, drives, poses and their regularity."""

    time: Float[np.ndarray, " rows"]
    q: Float[np.ndarray, "rows dof"]
    z: Float[np.ndarray, "rows dof"]
    regular: Regularity

    def part(self, which: slice) -> "Stretch":
        return Stretch(self.time[which], self.q[which], self.z[which], self.regular.part(which))

    def after(self, before: "Stretch") -> "Stretch":
        pairs = ([getattr(s.regular, f.name) for s in (before, self)] for f in fields(Regularity))
        return Stretch(
            np.concatenate([before.time, self.time]),
            np.concatenate([before.q, self.q]),
            np.concatenate([before.z, self.z]),
            Regularity(*map(np.concatenate, pairs)),
        )


class ReachCheck:
    """Running state of the check. Add all batches in order.

    Attributes:
        nearest, farthest: lowest and highest coordinates of the platform so far [m].
    """

    def __init__(self, table: LogTable, columns: Columns, kinematics: Kinematics) -> None:
        self.table, self.columns, self.kinematics = table, columns, kinematics
        self.nearest, self.farthest = np.full(3, np.inf), np.full(3, -np.inf)
        self.branch = BranchCheck(kinematics)
        self.outside, self.first_outside = 0, ""
        self.strained, self.first_strained = 0, ""

    def add(
        self,
        stretch: Stretch,
        good: Bool[np.ndarray, " rows"],
        row: int,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        """Check consecutive rows.

        Args:
            good: whether the pose of each row exists.
            row: number of the first row.
            apart: rows at which time jumps.

        Raises:
            RecordingError: names the first impossible row.
        """
        time, q, worst = stretch.time, stretch.q, stretch.regular.worst
        if not good.all():
            self._refuse_missing_pose(stretch, int(np.argmin(good)), row, apart)
        points = self.kinematics.robot.task.point(stretch.z)
        self.nearest = np.minimum(self.nearest, points.min(axis=0))
        self.farthest = np.maximum(self.farthest, points.max(axis=0))
        for singular in np.flatnonzero(~(worst < SINGULAR_CONDITION))[:1].tolist():
            raise RecordingError(
                f"the robot is in a singular pose at {self._angles(q[singular])}",
                where=self.table.row_place(row + singular),
                cure="an arm and its struts are in line there, or the struts in one plane; check "
                "zero and sign of the drives, and the robot's lengths",
            )
        strained = np.flatnonzero(worst > self.kinematics.robot.largest_condition)
        if strained.size and not self.strained:
            self.first_strained = (
                f"{self.table.row_name(row + int(strained[0]))} at {time[strained[0]]:.6g} s"
            )
        self.strained += strained.size
        self._check_branch(stretch, row, apart)
        outside = np.flatnonzero(~self.kinematics.robot.workspace.contains(points))
        if outside.size and not self.outside:
            x, y, height = points[outside[0]]
            place = f"[{x:.3f}, {y:.3f}, {height:.3f}] m"
            self.first_outside = f"{self.table.row_name(row + int(outside[0]))} at {place}"
        self.outside += outside.size

    def doubts(self, samples: int) -> Iterator[Doubt]:
        """Doubts about samples outside the workspace or near a singularity."""
        if self.outside:
            yield Doubt(
                f"{self.outside} of {samples} samples lie outside the workspace of the "
                f"description, the first in {self.first_outside}",
                cause="the robot uses more room than 'workspace' says",
                cure="widen it; if the robot was not there, check its lengths and zeros",
            )
        if self.strained:
            yield Doubt(
                f"{self.strained} of {samples} samples are nearer to a singular pose than "
                f"the description's largest_condition of "
                f"{self.kinematics.robot.largest_condition:g}, the first in "
                f"{self.first_strained}",
                cause="a motion at the edge of what the limbs reach",
                cure="keep away from it, for small errors of lengths and zeros are large there",
            )

    def _check_branch(self, stretch: Stretch, row: int, apart: Int[np.ndarray, " runs"]) -> None:
        count = len(stretch.time)
        for start, stop in pairwise([0, *apart[apart > 0].tolist(), count]):
            if start in apart:
                self.branch = BranchCheck(self.kinematics)
                if stop - start < _PASSAGE and stop < count:
                    continue
            passage = self.branch.add(stretch.part(slice(start, stop)))
            if passage is not None:
                at, what = passage
                place = f", at {self._angles(stretch.q[start + at])}" if at >= 0 else ""
                where = self.table.row_place(row + start + at)
                raise RecordingError(f"{what}{place}", where=where, cure=_KEEP_AWAY)

    def _refuse_missing_pose(
        self, stretch: Stretch, bad: int, row: int, apart: Int[np.ndarray, " runs"]
    ) -> None:
        """Refuse the first sample without a pose, or an earlier passage that explains it."""
        if bad:
            self._check_branch(stretch.part(slice(bad)), row, apart[apart < bad])
        q, time, carried = stretch.q, stretch.time[bad], self.branch.carried
        before = float(carried.regular.worst[-1]) if carried else 0.0
        reason = f"{self.kinematics.why_not(q[bad : bad + 1])} at {self._angles(q[bad])}"
        rails = all(self.kinematics.robot.linear_drives[:3])
        what, cure = f"{reason}, {time:.6g} s", _CHECK.format("" if rails else _ANGLES)
        if before > self.kinematics.robot.largest_condition:
            cure = _KEEP_AWAY
            what = (
                f"the robot comes to a singular pose at {time:.6g} s: the condition number is "
                f"{before:.4g} in the row before, and here {reason}"
            )
        raise RecordingError(what, where=self.table.row_place(row + bad), cure=cure)

    def _angles(self, q: Float[np.ndarray, " dof"]) -> str:
        names = ", ".join(channel.column for channel in self.columns.position)
        linear = self.kinematics.robot.linear_drives
        unit = "m" if all(linear) else "rad" if not any(linear) else "m and rad"
        return f"({names}) = ({', '.join(f'{value:.4g}' for value in q)}) {unit}"


@dataclass
class BranchCheck:
    """Running check that consecutive samples stay on one branch."""

    kinematics: Kinematics
    carried: Stretch | None = None

    def add(self, stretch: Stretch) -> tuple[int, str] | None:
        """Index of the first sample on another branch than the sample before it, with a reason;
        None without one.

        With T = J⁻¹, a step Δq moves the platform by about T Δq. If the determinant of J changes
        its sign between two samples, it was zero in between. Without a change of sign, z(q) may
        turn back where the robot went on (`passages`), or do so near a singular J. The index counts
        from the first sample of this call; it is negative for earlier samples.
        """
        before, mechanism = self.carried, self.kinematics.mechanism
        s = stretch.after(before) if before else stretch
        self.carried = s.part(slice(1 - _PASSAGE, None))
        sign, lengths = np.sign(s.regular.determinant), np.array(mechanism.lengths)
        flipped = np.diff(sign, prepend=sign[0]) != 0
        flipped[passages(s.regular) + 1] = True
        moved = np.linalg.norm(np.diff(s.z * lengths, axis=0, prepend=s.z[:1] * lengths), axis=1)
        driven = np.linalg.norm(np.diff(s.q, axis=0, prepend=s.q[:1]), axis=1)
        jumped = moved > _JUMP * s.regular.gain * (driven + _STILL)
        near = s.regular.condition > (_LOST if mechanism.forward is None else np.inf)
        bad = np.flatnonzero(flipped | jumped | near)
        if not bad.size:
            return None
        i = int(bad[0])
        if flipped[i]:
            between = f"between {s.time[i - 1]:.6g} s and {s.time[i]:.6g} s"
            what = f"the robot passes through a singular pose {between}"
        elif near[i]:
            what = (
                f"the robot comes to a singular pose at {s.time[i]:.6g} s (condition number "
                f"{s.regular.condition[i]:.4g}), where it may have gone on to another branch"
            )
        else:
            what = (
                f"the platform jumps by {moved[i]:.4g} m at {s.time[i]:.6g} s while the drives "
                "hardly move: the loops close on another branch there"
            )
        return i - (len(before.time) if before else 0), what
