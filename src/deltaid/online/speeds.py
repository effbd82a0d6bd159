"""Whether a recording's velocities are worth taking, or positions are better differenced.

A drive's velocity often comes filtered, and so late against its position, or with more noise than
differences of the positions have. Both make loads look lighter: what is late, and what is noise,
stands in the columns of the load and not in the torques.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.check.spectra import white_noise
from deltaid.errors import Doubt
from deltaid.identification.velocity_stage import late_rate
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.recording import Recording

# A lag [s] that does no harm, and noise [rad/s or m/s] that does none.
_HARMLESS, _QUIET = 1e-4, 3e-3
# Rows that noise is looked at in.
_ROWS = 1 << 16


@dataclass(frozen=True, eq=False)
class Speeds:
    """What is known of a recording's velocities.

    Attributes:
        differenced: whether positions are differenced, because none are recorded or as that is
            better.
        noise: standard deviation of one cycle's speed, as it is taken, drive by drive.
        doubts: why recorded ones are not taken.
    """

    differenced: bool
    noise: tuple[float, ...]
    doubts: tuple[Doubt, ...] = ()


def speeds_of(recording: Recording, kinematics: Kinematics) -> Speeds:
    """Look at the velocities of a recording."""
    log = recording.log
    made = log.position_noise[: kinematics.dof] * log.rate * np.sqrt(2.0)
    differences = tuple(made.tolist())
    if not log.columns.velocity:
        return Speeds(True, differences)
    late = late_rate(recording, kinematics)
    if late is not None and np.abs(late.values).max() > _HARMLESS:
        return Speeds(True, differences, (_late(late.values, recording),))
    noise = _noise(recording, kinematics.dof)
    if np.any(noise > np.maximum(made, _QUIET)):
        return Speeds(True, differences, (_noisy(noise, made, recording),))
    return Speeds(False, tuple(noise.tolist()))


def _noise(recording: Recording, dof: int) -> Float[np.ndarray, " dof"]:
    """White noise of recorded velocities, from the first stretch that is long enough."""
    log = recording.log
    for segment in log.segments(None):
        for rows in segment:
            if len(rows) > 1:
                return white_noise(rows[:_ROWS, 1 + dof : 1 + 2 * dof], log.rate)
    return np.zeros(dof)


def _late(lag: Float[np.ndarray, " drives"], recording: Recording) -> Doubt:
    i = int(np.argmax(np.abs(lag)))
    word = "late" if lag[i] > 0 else "early"
    return Doubt(
        f"column {recording.log.columns.velocity[i].column} comes {1e3 * abs(lag[i]):.2g} ms "
        f"{word} against its position: velocities are left out, and positions differenced",
        cause="the drive filters its velocity",
        cure="a controller that runs on such velocities has to difference positions too "
        "(OnlineSettings.speed)",
        key="velocity",
    )


def _noisy(noise: np.ndarray, made: np.ndarray, recording: Recording) -> Doubt:
    i = int(np.argmax(noise))
    unit = recording.log.columns.velocity[i].column
    return Doubt(
        f"column {unit} has noise of {noise[i]:.2g} a row, and differences of its position have "
        f"{made[i]:.2g}: velocities are left out, and positions differenced",
        cause="the drive makes its velocity of few steps of the encoder",
        cure="a controller that runs on such velocities has to difference positions too "
        "(OnlineSettings.speed)",
        key="velocity",
    )
