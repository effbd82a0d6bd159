"""Motions for controllers: from a file, from samples, or from memory."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from deltaid.control.controllers import Desired
from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.mechanism.one_or_many import real_numbers
from deltaid.motion.surrogate import Motion
from deltaid.recording.filter import TOO_SHORT
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.planned import motion_of, planned
from deltaid.recording.time.doubts import restarted

# Degree of splines, so that q̈ is smooth.
_DEGREE = 5


@dataclass(frozen=True)
class MotionTrajectory:
    """A Fourier motion or a run from rest to rest, in memory.

    Attributes:
        duration: length of the part to follow [s].
    """

    kinematics: Kinematics
    motion: Motion
    duration: float

    def desired(self, time: Float[np.ndarray, " samples"]) -> Desired:
        """The desired motion at times [s].

        Raises:
            KinematicsError: a pose is out of reach or singular.
        """
        z, zd, zdd = self.motion.evaluate(np.clip(time, 0.0, self.duration))
        return Desired(z, *self.kinematics.drive_motion(z, zd, zdd))


class SampledTrajectory:
    """Samples of drive coordinates, interpolated by a spline of fifth degree.

    Args:
        time: at least six times, evenly spaced or not [s].
        q: drive coordinates at these times.

    Velocities and accelerations are derivatives of the spline, so that all three agree.
    """

    def __init__(
        self, kinematics: Kinematics, time: Float[np.ndarray, " samples"], q: Samples
    ) -> None:
        time, q = real_numbers(time, "time"), real_numbers(q, "q")
        self._kinematics = kinematics
        self._spline = make_interp_spline(time - time[0], q, k=_DEGREE)
        self.duration = float(time[-1] - time[0])

    def desired(self, time: Float[np.ndarray, " samples"]) -> Desired:
        """The desired motion at times [s].

        Raises:
            KinematicsError: between the samples a pose is out of reach or singular.
        """
        inside = np.clip(time, 0.0, self.duration)
        q, qd, qdd = (np.asarray(self._spline(inside, order)) for order in range(3))
        return Desired(self._kinematics.forward(q), q, qd, qdd)


# A desired motion, evaluated at any time [s] between 0 and its duration.
Trajectory = MotionTrajectory | SampledTrajectory


def open_trajectory(
    path: RecordingLike, kinematics: Kinematics, mapping: ColumnMapping | None = None
) -> tuple[SampledTrajectory, Log]:
    """The motion of a file: of `deltaid excite`, or of a recording.

    A file with velocities and accelerations is used unchanged. Positions alone are low-passed: an
    end at rest is continued at rest; an end in motion is cut by the filter's length.

    Raises:
        RecordingError: the file cannot be used, its time restarts, it has a gap or too few samples.
    """
    log = open_log(path, kinematics, mapping, need_torque=False)
    seen, cause, _ = restarted(log.clock, log.table, log.columns.time.column)
    if seen:
        raise RecordingError(
            f"{seen}, so these are several motions; likeliest cause: {cause}",
            where=str(path),
            cure="give a file with one of them",
        )
    # A spline bridges fewer missing rows than its degree.
    for row, lost in zip(log.clock.holes.tolist(), log.clock.lost.tolist(), strict=True):
        if lost >= _DEGREE:
            raise RecordingError(
                f"{lost} rows are missing before {log.table.row_name(log.table.first_row + row)}",
                where=str(path),
                cure="give a motion without gaps, or a part of it between them",
            )
    recording = planned(log)
    parts = [(part.time, kinematics.inverse(part.z)) for part in motion_of(recording, kinematics)]
    time, q = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(time) <= _DEGREE:
        raise RecordingError(
            f"has {len(time)} samples, too few for a motion (at least {_DEGREE + 1})",
            where=str(path),
            cure=TOO_SHORT,
        )
    return SampledTrajectory(kinematics, time, q), recording.log
