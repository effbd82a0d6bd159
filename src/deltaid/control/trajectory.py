"""Motions that a controller follows: of a file, of samples, or in memory."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from deltaid.control.controllers import Desired
from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.mechanism.one_or_many import real_numbers
from deltaid.motion.surrogate import Motion
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter

# Through samples, so that q̈ has no corners.
_DEGREE = 5


@runtime_checkable
class Trajectory(Protocol):
    """A desired motion that can be asked for any time between 0 and its duration."""

    @property
    def duration(self) -> float:
        """How long the motion lasts [s]."""
        ...

    def desired(self, time: Float[np.ndarray, " samples"]) -> Desired:
        """The desired motion at times [s], which start at 0."""
        ...


@dataclass(frozen=True)
class MotionTrajectory:
    """A Fourier motion or a run from rest to rest, in memory.

    Attributes:
        duration: how much of it is to be followed [s].
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
    """Samples of drive coordinates, joined by a spline of fifth degree.

    Args:
        time: evenly spaced or not, at least six [s].
        q: drive coordinates there.

    Velocities and accelerations are the spline's own, so that all three agree.
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


def open_trajectory(
    path: RecordingLike, kinematics: Kinematics, mapping: ColumnMapping | None = None
) -> tuple[SampledTrajectory, Log]:
    """The motion of a file: what `deltaid excite` writes, or a recording.

    A file with velocities and accelerations is taken as it is. One with positions only is a
    recording: it is low-passed as an identification would, and is shorter at both ends by the
    filter's length.

    Raises:
        RecordingError: the file cannot be used, or has too few samples.
    """
    log = open_log(path, kinematics, mapping, need_torque=False)
    recording = with_filter(log, None if log.has_derivatives else log.motion_cutoff)
    parts = [(w.own.time, kinematics.inverse(w.own.z)) for w in recording.windows(kinematics)]
    time, q = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(time) <= _DEGREE:
        raise RecordingError(
            f"has {len(time)} samples, too few for a motion (at least {_DEGREE + 1})",
            where=str(path),
            cure="give a longer one; without velocities and accelerations the filter's length is "
            "lost at either end",
        )
    return SampledTrajectory(kinematics, time, q), recording.log
