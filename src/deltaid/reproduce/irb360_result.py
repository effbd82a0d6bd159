"""What reproducing Sec. VIII is asked for, and what it finds."""

from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.identification.identify import Identification
from deltaid.motion.excitation.run import Run
from deltaid.reproduce.table_one import Drive4Friction
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Irb360Settings:
    """How much of Sec. VIII to do.

    Attributes:
        seed: of motions and noise.
        starts: of each motion's optimisation.
        harmonics, duration, repeats: of the motions, see `deltaid.ExcitationSettings`.
        torque_noise: of the recordings, a share of each drive's largest torque.
        rate: sampling rate [Hz].
    """

    seed: int = 0
    starts: int = 4
    harmonics: int = 8
    duration: float = 20.0
    repeats: int = 2
    torque_noise: float = 0.02
    rate: float = 1000.0


@dataclass(frozen=True)
class Candidate:
    """Parameters to compare on the verification motions.

    Attributes:
        name: as tables have it, such as 'ID geom'.
        robot: whose friction laws they belong to.
        p: the parameters.
        identification: where they come from; None for what is derived from another one.
    """

    name: str
    robot: RobotDescription
    p: Parameters
    identification: Identification | None


@dataclass(frozen=True)
class Verified:
    """One candidate on one verification motion.

    Attributes:
        candidate, motion: names.
        rms: root mean square of measured minus predicted torque, through the filter [N m].
        predicted: torques through the filter at the times of the motion's `Track` [N m].
    """

    candidate: str
    motion: str
    rms: Float[np.ndarray, " dof"]
    predicted: Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class Track:
    """One verification motion as measured, through the filter, thinned to the rate it allows.

    Attributes:
        motion: 'slow', as in Sec. VIII C, or 'fast', as fast as the identification.
        time [s], speed [rad/s], measured [N m].
        noise: what the true model leaves of the measured torques, root mean square [N m].
        speed_max, acceleration_max: of drive 4 [rad/s, rad/s²].
    """

    motion: str
    time: Float[np.ndarray, " samples"]
    speed: Float[np.ndarray, "samples dof"]
    measured: Float[np.ndarray, "samples dof"]
    noise: Float[np.ndarray, " dof"]
    speed_max: float
    acceleration_max: float


@dataclass(frozen=True)
class Irb360:
    """Sec. VIII with a stand-in for the machine.

    Attributes:
        settings: what was asked.
        dynamics, truth: of the stand-in; `friction` is what drive 4 really has.
        priors: by column of Table I.
        runs: the motions by name: identify, slow, fast.
        recordings: by file name.
        candidates: what is compared.
        tracks: the verification motions.
        verified: every candidate on each of them.
        seconds: for all of it.
    """

    settings: Irb360Settings
    dynamics: Dynamics
    truth: Parameters
    friction: Drive4Friction
    priors: dict[str, RobotDescription]
    runs: dict[str, Run]
    recordings: dict[str, pl.DataFrame]
    candidates: tuple[Candidate, ...]
    tracks: tuple[Track, ...]
    verified: tuple[Verified, ...]
    seconds: float

    def candidate(self, name: str) -> Candidate:
        """A candidate by name."""
        return next(c for c in self.candidates if c.name == name)

    def result(self, candidate: str, motion: str) -> Verified:
        """A candidate on a motion."""
        return next(v for v in self.verified if (v.candidate, v.motion) == (candidate, motion))

    def track(self, motion: str) -> Track:
        """A verification motion by name."""
        return next(t for t in self.tracks if t.motion == motion)


QUICK = Irb360Settings(harmonics=5, duration=10.0, repeats=1)
