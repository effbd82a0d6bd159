"""The motion of a sensor plan, and its rows over w = [p; gains] in units of their noise.

Rows are those of torques, sensors and measured values. Predicted samples stand for the independent
samples of a recording, so rows are scaled by √(rate · duration / samples). A sensor's unknowns
(bias, pose, gain) are eliminated with their prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.information import triangle
from deltaid.identification.generic_motion import SAMPLES
from deltaid.identification.sources import model_filtered
from deltaid.model.model import Model
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.planned import motion_of, planned
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import BaseWrench
from deltaid.sensors.rows import SensorRows, is_of_pose
from deltaid.sensors.weighings import Weighing

Samples = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """A motion that a plan is made for.

    Attributes:
        words: description of the motion, for tables and pages.
        duration: of the recording [s].
        z, qd, qdd: samples spread evenly over it.
    """

    words: str
    duration: float
    z: Samples
    qd: Samples
    qdd: Samples

    @property
    def few(self) -> Int[np.ndarray, " few"]:
        """Samples that show geometry and forces, spread evenly."""
        return np.linspace(0, len(self.z) - 1, num=12).astype(int)


def generic_motion(dynamics: Dynamics, duration: float, seed: int) -> PlannedMotion:
    """A random motion within the robot's limits.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    return planned_along(
        dynamics,
        motion,
        SAMPLES,
        f"a random motion within the robot's limits, {duration:g} s (seed {seed})",
        duration,
    )


def planned_along(
    dynamics: Dynamics, motion: FourierMotion, samples: int, words: str, duration: float
) -> PlannedMotion:
    """Samples of one period that stand for a recording of some duration [s]."""
    z, zd, zdd = motion.evaluate(np.arange(samples) * motion.period / samples)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    return PlannedMotion(words, duration, z, qd, qdd)


def motion_of_file(
    model: Model, dynamics: Dynamics, given: RecordingLike, columns: ColumnMapping | None = None
) -> PlannedMotion:
    """The motion of a file that `deltaid excite` planned, or of a recording.

    Raises:
        RecordingError: it cannot be used.
    """
    log = open_log(given, dynamics.kinematics, columns, need_torque=False)
    recording = model_filtered(model, log, planned)
    thin = slice(None, None, max(1, log.samples // SAMPLES))
    parts = [(part.part(thin), len(part.z)) for part in motion_of(recording, dynamics.kinematics)]
    z, qd, qdd = (
        np.concatenate([getattr(part, name) for part, _ in parts]) for name in ("z", "qd", "qdd")
    )
    duration = sum(samples for _, samples in parts) / log.rate
    return PlannedMotion(f"{log.path.name}, {duration:.3g} s", duration, z, qd, qdd)


Extended = Float[np.ndarray, "_ extended"]


@dataclass(frozen=True, eq=False)
class PlannedRecording:
    """A robot along a motion, and the noise of its torques there.

    Attributes:
        dynamics: of the robot.
        motion: planned or recorded.
        count: independent samples per planned sample.
        torque_noise: standard deviation of each drive's torque [N m or N].
    """

    dynamics: Dynamics
    motion: PlannedMotion
    count: float
    torque_noise: Float[np.ndarray, " dof"]

    @classmethod
    def with_noise(
        cls, dynamics: Dynamics, motion: PlannedMotion, rate: float, share: float
    ) -> "PlannedRecording":
        """A recording with independent samples at a rate [Hz], and noise as a share of each drive's
        largest torque."""
        count = rate * motion.duration / len(motion.z)
        exact = cls(dynamics, motion, count, np.zeros(dynamics.dof))
        return replace(exact, torque_noise=share * np.abs(exact.regressor @ exact.p).max(axis=0))

    @property
    def width(self) -> int:
        """Length of w: all parameters, then a gain of each drive."""
        return len(self.p) + self.dynamics.dof

    @cached_property
    def p(self) -> Parameters:
        """Parameters at the prior."""
        return prior_parameters(self.dynamics.robot)

    @cached_property
    def regressor(self) -> Float[np.ndarray, "samples dof parameters"]:
        """The regressor along the motion."""
        states = self.motion.z, self.motion.qd, self.motion.qdd
        load = self.dynamics.carried(*states, self.p) if self.dynamics.robot.load_drives else None
        return self.dynamics.regressor_at(*states, load)


def torque_rows(recorded: PlannedRecording) -> Extended:
    """Rows of recorded torques τ_i / c_i: the gains' logarithms have the columns −τ_i."""
    gains = -(recorded.regressor @ recorded.p)[:, :, None] * np.eye(recorded.dynamics.dof)
    weights = (np.sqrt(recorded.count) / recorded.torque_noise)[None, :, None]
    return triangle((np.dstack([recorded.regressor, gains]) * weights).reshape(-1, recorded.width))


def planned_rows(recorded: PlannedRecording, sensor: SensorRows) -> tuple[Extended, Extended]:
    """A sensor's rows over w with its unknowns eliminated: with all of their priors, and with
    stated tolerances alone, which shows what is identifiable at all."""
    motion, n, unknowns = recorded.motion, len(recorded.p), sensor.parameters
    along = motion.z, motion.qd, motion.qdd
    values = sensor.entries(
        *along, sensor.shown(np.append(recorded.p, np.zeros(len(unknowns))), *along)
    )
    dense = np.zeros((len(motion.z), len(sensor.channels), n + len(unknowns)))
    dense[:, *sensor.pattern] = values.T
    noise = np.array([channel.noise for channel in sensor.channels])
    flat = (dense * (np.sqrt(recorded.count) / noise)[None, :, None]).reshape(-1, dense.shape[2])
    stds = np.array([parameter.std for parameter in unknowns]).reshape(-1)
    flat = triangle(np.hstack([flat[:, n:] * stds, flat[:, :n]]))

    def rest(known: Sequence[bool]) -> Extended:
        prior = np.eye(len(unknowns), flat.shape[1]) * np.reshape(known, (-1, 1))
        rows = triangle(np.vstack([prior, flat]))[len(unknowns) :, len(unknowns) :]
        return np.hstack([rows, np.zeros((len(rows), recorded.dynamics.dof))])

    return rest([True] * len(unknowns)), rest([not _is_open(entry, sensor) for entry in unknowns])


def _is_open(parameter: PriorParameter, sensor: SensorRows) -> bool:
    """Whether the description states neither tolerance nor deviation of a sensor's unknown."""
    if parameter.symbol.rpartition("_")[2] != "bias":
        return not is_of_pose(parameter) and parameter.symbol != "gain"
    if isinstance(described := sensor.sensor, BaseWrench):
        moment = parameter.symbol.startswith("m")
        return (described.moment_bias if moment else described.force_bias) is None
    return described.bias is None


def weighing_row(recorded: PlannedRecording, weighing: Weighing) -> Extended:
    """A measured value as a row over w, in units of its standard deviation."""
    return np.append(weighing.coefficients / weighing.std, np.zeros(recorded.dynamics.dof))[None]
