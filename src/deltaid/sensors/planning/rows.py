"""The motion of a sensor plan, and its rows over w = [p; gains] in units of their noise.

Rows are those of torques, sensors and measured values. Predicted samples stand for the independent
samples of a recording, so rows are scaled by √(rate · duration / samples). A sensor's unknowns
(bias, pose, gain) are eliminated with their prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
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
    """Attributes:
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
class Scene:
    """Robot, motion and torque noise of a sensor plan.

    Attributes:
        dynamics: of the robot.
        p: its parameters at the prior.
        motion: planned or recorded.
        count: independent samples per planned sample.
        torque_noise: standard deviation of each drive's torque [N m or N].
    """

    dynamics: Dynamics
    p: Parameters
    motion: PlannedMotion
    count: float
    torque_noise: Float[np.ndarray, " dof"]

    @property
    def width(self) -> int:
        """Length of w: all parameters, then a gain of each drive."""
        return len(self.p) + self.dynamics.dof


def torques(dynamics: Dynamics, p: Parameters, motion: PlannedMotion) -> np.ndarray:
    """The regressor along a motion, samples × drives × parameters."""
    states = motion.z, motion.qd, motion.qdd
    load = dynamics.carried(*states, p) if dynamics.robot.load_drives else None
    return dynamics.regressor_at(*states, load)


def torque_rows(scene: Scene, Y: Float[np.ndarray, "samples dof parameters"]) -> Extended:
    """Rows of recorded torques τ_i / c_i: the gains' logarithms have the columns −τ_i."""
    gains = -(Y @ scene.p)[:, :, None] * np.eye(scene.dynamics.dof)
    scaled = np.dstack([Y, gains]) * (np.sqrt(scene.count) / scene.torque_noise)[None, :, None]
    return triangle(scaled.reshape(-1, scene.width))


def planned_rows(scene: Scene, sensor: SensorRows) -> tuple[Extended, Extended]:
    """A sensor's rows over w with its unknowns eliminated: with all of their priors, and with
    stated tolerances alone, which shows what is identifiable at all."""
    motion, n, unknowns = scene.motion, len(scene.p), sensor.parameters
    along = motion.z, motion.qd, motion.qdd
    values = sensor.entries(
        *along, sensor.shown(np.append(scene.p, np.zeros(len(unknowns))), *along)
    )
    dense = np.zeros((len(motion.z), len(sensor.channels), n + len(unknowns)))
    dense[:, *sensor.pattern] = values.T
    noise = np.array([channel.noise for channel in sensor.channels])
    flat = (dense * (np.sqrt(scene.count) / noise)[None, :, None]).reshape(-1, dense.shape[2])
    stds = np.array([parameter.std for parameter in unknowns]).reshape(-1)
    flat = triangle(np.hstack([flat[:, n:] * stds, flat[:, :n]]))

    def rest(known: Sequence[bool]) -> Extended:
        prior = np.eye(len(unknowns), flat.shape[1]) * np.reshape(known, (-1, 1))
        rows = triangle(np.vstack([prior, flat]))[len(unknowns) :, len(unknowns) :]
        return np.hstack([rows, np.zeros((len(rows), scene.dynamics.dof))])

    return rest([True] * len(unknowns)), rest([not _is_open(entry, sensor) for entry in unknowns])


def _is_open(parameter: PriorParameter, sensor: SensorRows) -> bool:
    """Whether the description states neither tolerance nor deviation of a sensor's unknown."""
    if parameter.symbol.rpartition("_")[2] != "bias":
        return not is_of_pose(parameter) and parameter.symbol != "gain"
    if isinstance(described := sensor.sensor, BaseWrench):
        moment = parameter.symbol.startswith("m")
        return (described.moment_bias if moment else described.force_bias) is None
    return described.bias is None


def weighing_row(scene: Scene, weighing: Weighing) -> Extended:
    """A measured value as a row over w, in units of its standard deviation."""
    return np.append(weighing.coefficients / weighing.std, np.zeros(scene.dynamics.dof))[None]
