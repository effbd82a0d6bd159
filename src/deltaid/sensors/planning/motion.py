"""The motion that a plan is made for: a file, or a generic one within the robot's limits."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.identification.sources import model_filtered
from deltaid.model.model import Model
from deltaid.motion.random_motion import random_motion
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.windows import Samples as Motion

# Samples of a plan; a motion within limits has far less to show than these can tell apart.
_SAMPLES = 2000

Samples = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """Attributes:
    words: which motion, for tables and pages.
    duration: of the recording [s].
    z, qd, qdd: samples spread evenly over it.
    """

    words: str
    duration: float
    z: Samples
    qd: Samples
    qdd: Samples


def generic_motion(dynamics: Dynamics, duration: float, seed: int) -> PlannedMotion:
    """A random motion within the robot's limits.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    time = np.arange(_SAMPLES) * motion.period / _SAMPLES
    z, zd, zdd = motion.evaluate(time)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    words = f"a random motion within the robot's limits, {duration:g} s (seed {seed})"
    return PlannedMotion(words, duration, z, qd, qdd)


def motion_of_file(
    model: Model, dynamics: Dynamics, given: RecordingLike, columns: ColumnMapping | None = None
) -> PlannedMotion:
    """A motion that `deltaid excite` has planned, or that was recorded.

    Raises:
        RecordingError: it cannot be used.
    """
    log = open_log(given, dynamics.kinematics, columns, need_torque=False)
    recording = model_filtered(model, log)
    thin = slice(None, None, max(1, log.samples // _SAMPLES))
    parts, samples = list[Motion](), 0
    for part in recording.evaluate(dynamics.kinematics, lambda window: window.own):
        parts.append(part.part(thin))
        samples += len(part.z)
    z, qd, qdd = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("z", "qd", "qdd")
    )
    duration = samples / log.rate
    return PlannedMotion(f"{log.path.name}, {duration:.3g} s", duration, z, qd, qdd)
