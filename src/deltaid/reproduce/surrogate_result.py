"""What reproducing Sec. VII is asked for, and what it finds."""

from dataclasses import dataclass, field

import numpy as np
import polars as pl
from jaxtyping import Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.conic import SOLVERS
from deltaid.identification.identify import Identification
from deltaid.model.options import Method
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import ExcitationSettings
from deltaid.reproduce.accuracy import Accuracy, DriveMotion, MotionTerms, SweepPoint
from deltaid.reproduce.descent import Descents
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class RecordingSettings:
    """How motions are optimised and recorded.

    Attributes:
        seed: of motions, regularisations and noise.
        starts: of each motion's optimisation.
        harmonics, duration, repeats: of the motions, see `deltaid.ExcitationSettings`. With the
            default ones a recording lasts about 40 s; in 10 s, friction and the small inertia of
            the fourth drive drown in 2 % of noise.
        torque_noise: of the noisy recordings, a share of each drive's largest torque.
        rate: sampling rate [Hz].
    """

    seed: int = 0
    starts: int = 4
    harmonics: int = 8
    duration: float = 20.0
    repeats: int = 2
    torque_noise: float = 0.02
    rate: float = 1000.0

    @property
    def excitation(self) -> ExcitationSettings:
        """What is asked of the motions."""
        names = ("harmonics", "duration", "repeats", "starts", "seed")
        return ExcitationSettings(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True)
class SurrogateSettings(RecordingSettings):
    """How much of Sec. VII to do.

    Attributes:
        methods: solvers of the fits; conic must be among them.
        points: in pictures and in the sweep, over one period of the motion.
        gammas: γ_p/γ_τ of the sweep.
        descent_gamma: γ_p/γ_τ of the comparison of minimisers. The paper does not state its own.
        iterations: of each of them.
    """

    methods: tuple[Method, ...] = ("conic", "log-cholesky")
    points: int = 500
    gammas: tuple[float, ...] = tuple(float(g) for g in 10.0 ** np.arange(-14.0, -0.9, 0.5))
    descent_gamma: float = 1e-10
    iterations: int = 1000


# For a first look: with 10 s of motion the noise shows more.
QUICK = SurrogateSettings(
    starts=1,
    harmonics=5,
    duration=10.0,
    repeats=1,
    gammas=tuple(float(g) for g in 10.0 ** np.arange(-14.0, -0.9, 2.0)),
    iterations=100,
)


@dataclass(frozen=True)
class SurrogateFit:
    """One identification and how far it is from the truth.

    Attributes:
        prior: 'RG1' or 'RG2'.
        noisy: with noise.
        method: which solver.
        identification: the result.
        seconds: from the file to the model.
        accuracy, verified: along the motion of the data, and along the other one.
        terms: along one period of the motion, for pictures.
    """

    prior: str
    noisy: bool
    method: Method
    identification: Identification
    seconds: float
    accuracy: Accuracy
    verified: Accuracy
    terms: MotionTerms

    @property
    def certified(self) -> bool:
        """Whether its solver certifies the optimum by itself."""
        return SOLVERS[self.method].certifies


@dataclass(frozen=True)
class Sweep:
    """Accuracy over γ for one prior and recording, along one period of the motion."""

    prior: str
    noisy: bool
    points: tuple[SweepPoint, ...]


@dataclass(frozen=True)
class Reproduction:
    """Everything Sec. VII shows, and more.

    Attributes:
        settings: what was asked for.
        dynamics: of the robot.
        nominal: the description whose prior is the truth.
        truth: its parameters.
        priors: the descriptions with RG1 and RG2.
        run, verification: the motions.
        period: one period of the identification motion, for pictures.
        terms: the true terms along it.
        recordings: by file name.
        fits, descents, sweeps: the results; descents by prior, without noise.
        seconds: of the whole.
    """

    settings: SurrogateSettings
    dynamics: Dynamics
    nominal: RobotDescription
    truth: Parameters
    priors: dict[str, RobotDescription]
    run: Run
    verification: Run
    period: DriveMotion
    terms: MotionTerms
    recordings: dict[str, pl.DataFrame]
    fits: tuple[SurrogateFit, ...] = ()
    descents: dict[str, Descents] = field(default_factory=dict[str, Descents])
    sweeps: tuple[Sweep, ...] = ()
    seconds: float = 0.0

    @property
    def free(self) -> Int[np.ndarray, " free"]:
        """Parameters that fits choose and whose truth is not zero."""
        reduction = self.fits[0].identification.problem.reduction
        return np.flatnonzero(np.any(reduction.A != 0, axis=1) & (self.truth != 0))

    def fit(self, prior: str, *, noisy: bool, method: Method = "conic") -> SurrogateFit:
        """One of the fits."""
        wanted = (prior, noisy, method)
        return next(f for f in self.fits if (f.prior, f.noisy, f.method) == wanted)
