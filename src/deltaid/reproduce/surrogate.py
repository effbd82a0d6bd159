"""Sec. VII from excitation to numbers: a robot with known parameters, identified from two priors.

The stages: two optimised motions, one to identify and one to verify; recordings of both, without
noise and with that of a drive; fits from a regularisation below the truth (RG1) and one above it
(RG2), by both solvers; their accuracy along both motions; the ends of other minimisers of the
paper's objective; and the dependence of all results on γ.
"""

import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from jaxtyping import Int

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.conic import SOLVERS
from deltaid.identification.identify import Identification, identify
from deltaid.model.options import Method
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET, ExcitationSettings
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.reproduce.accuracy import (
    Accuracy,
    DriveMotion,
    MotionTerms,
    SweepPoint,
    accuracy,
    drive_motion,
    motion_terms,
    sweep,
)
from deltaid.reproduce.descent import Descents, descend
from deltaid.reproduce.table_one import ABOVE, BELOW, ROBOT, nominal_robot, regularisation
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

# γ_p/γ_τ for the comparison of minimisers; the paper does not state its own.
DESCENT_GAMMA = 1e-10


@dataclass(frozen=True)
class RecordingSettings:
    """Settings of motions and recordings.

    Attributes:
        seed: of motions, regularisations and noise.
        starts: number of starts of each motion's optimisation.
        harmonics, duration, repeats: of the motions, see `deltaid.ExcitationSettings`. By default a
            recording lasts about 40 s; in 10 s, 2 % of noise hides friction and the small inertia
            of the fourth drive.
        torque_noise: of the noisy recordings, as a share of each drive's largest torque.
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
        """Settings of the excitation."""
        names = ("harmonics", "duration", "repeats", "starts", "seed")
        return ExcitationSettings(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True)
class SurrogateSettings(RecordingSettings):
    """Settings of the reproduction of Sec. VII.

    Attributes:
        methods: solvers of the fits; conic must be among them.
        points: number of samples in figures and in the sweep, over one period of the motion.
        gammas: γ_p/γ_τ of the sweep.
        iterations: largest number of steps of each of the other minimisers.
    """

    methods: tuple[Method, ...] = ("conic", "log-cholesky")
    points: int = 500
    gammas: tuple[float, ...] = tuple(float(g) for g in 10.0 ** np.arange(-14.0, -0.9, 0.5))
    iterations: int = 1000


# Quick settings: in 10 s of motion the noise has more effect.
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
    """One identification and its accuracy.

    Attributes:
        prior: 'RG1' or 'RG2'.
        noisy: whether its recording has noise.
        method: solver.
        identification: the result.
        seconds: from the file to the model.
        accuracy, verified: along the motion of the data, and along the other one.
        terms: along one period of the motion, for figures.
        sweep: accuracy over γ along that period, of certified fits.
        descents: runs of other minimisers, of certified fits without noise.
    """

    prior: str
    noisy: bool
    method: Method
    identification: Identification
    seconds: float
    accuracy: Accuracy
    verified: Accuracy
    terms: MotionTerms
    sweep: tuple[SweepPoint, ...] = ()
    descents: Descents | None = None

    @property
    def certified(self) -> bool:
        """Whether its solver certifies the optimum."""
        return SOLVERS[self.method].certifies

    @property
    def name(self) -> str:
        """The paper's name of a fit: ID1 from RG1."""
        return self.prior.replace("RG", "ID")


@dataclass(frozen=True)
class Reproduction:
    """All results of Sec. VII, and additional ones.

    Attributes:
        settings: of motions, recordings and fits.
        dynamics: of the robot whose prior is the truth.
        truth: its parameters.
        priors: the descriptions with RG1 and RG2.
        run, verification: the motions.
        period: one period of the identification motion, for figures.
        terms: the true terms along it.
        recordings: by file name.
        fits: the results.
        seconds: duration of the whole computation.
    """

    settings: SurrogateSettings
    dynamics: Dynamics
    truth: Parameters
    priors: dict[str, RobotDescription]
    run: Run
    verification: Run
    period: DriveMotion
    terms: MotionTerms
    recordings: dict[str, pl.DataFrame]
    fits: tuple[SurrogateFit, ...] = ()
    seconds: float = 0.0

    @property
    def free(self) -> Int[np.ndarray, " free"]:
        """Indices of free parameters whose truth is not zero."""
        reduction = self.fits[0].identification.problem.reduction
        return np.flatnonzero(np.any(reduction.A != 0, axis=1) & (self.truth != 0))

    @property
    def certified(self) -> tuple[SurrogateFit, ...]:
        """The fits with a certificate."""
        return tuple(fit for fit in self.fits if fit.certified)

    @property
    def descents(self) -> dict[str, Descents]:
        """Runs of other minimisers on the recording without noise, by prior."""
        return {fit.prior: fit.descents for fit in self.fits if fit.descents is not None}

    def fit(self, prior: str, *, noisy: bool) -> SurrogateFit:
        """The certified fit of a prior and a recording."""
        return next(f for f in self.certified if (f.prior, f.noisy) == (prior, noisy))


def reproduce_surrogate(
    settings: SurrogateSettings | None = None, progress: Progress = lambda _: None
) -> Reproduction:
    """Reproduce Sec. VII.

    Raises:
        DeltaidError: no motion was found, or a fit did not converge.
    """
    settings, began = settings or SurrogateSettings(), time.perf_counter()
    rng = np.random.default_rng(settings.seed)
    nominal = nominal_robot(load_robot(ROBOT))
    shares = {"RG1": BELOW, "RG2": ABOVE}
    priors = {name: regularisation(nominal, name, share, rng) for name, share in shares.items()}
    run, verification = _motions(priors["RG2"], settings, progress)
    dynamics, truth = compiled(nominal), prior_parameters(nominal)
    recordings = {}
    for noisy in (False, True):
        for kind, motion in (("identify", run), ("verify", verification)):
            progress(f"recording {kind}, {'with' if noisy else 'without'} noise")
            recordings[recording_name(kind, noisy=noisy)] = simulate_recording(
                dynamics,
                truth,
                motion,
                rng,
                duration=motion.duration,
                rate=settings.rate,
                noise=SensorNoise(settings.torque_noise) if noisy else None,
            )
    times = run.ramp + np.linspace(0, run.motion.period, settings.points)
    along = drive_motion(dynamics, run, times)
    result = Reproduction(
        settings=settings,
        dynamics=dynamics,
        truth=truth,
        priors=priors,
        run=run,
        verification=verification,
        period=replace(along, time=along.time - run.ramp),  # the first complete period
        terms=motion_terms(dynamics, along, truth),
        recordings=recordings,
    )
    fits = _fits(result, progress)
    return replace(result, fits=fits, seconds=time.perf_counter() - began)


def recording_name(kind: str, *, noisy: bool) -> str:
    """File name of a recording."""
    return f"{kind}-noisy.csv" if noisy else f"{kind}.csv"


def _motions(
    planned_with: RobotDescription, settings: SurrogateSettings, progress: Progress
) -> tuple[Run, Run]:
    """Two motions within the limits of a robot with larger masses and friction than the truth, so
    that the true torques keep their limits too."""
    progress("preparing the excitation")
    exciter = Exciter(compiled(planned_with), settings.excitation)
    progress(f"optimising the motion from {settings.starts} starts")
    first = exciter.optimise()
    progress("optimising the verification motion")
    return first.run, exciter.optimise(offset=VERIFICATION_OFFSET).run


def _fits(result: Reproduction, progress: Progress) -> tuple[SurrogateFit, ...]:
    settings, dynamics, fits = result.settings, result.dynamics, list[SurrogateFit]()
    motions = [
        drive_motion(dynamics, run, np.arange(round(run.duration * settings.rate)) / settings.rate)
        for run in (result.run, result.verification)
    ]
    with TemporaryDirectory() as folder:
        for noisy, prior, method in product((False, True), result.priors, settings.methods):
            name = recording_name("identify", noisy=noisy)
            log = Path(folder) / name
            if not log.exists():
                write_recording(result.recordings[name], log)
            progress(f"fitting {name} from {prior}, {method}")
            began = time.perf_counter()
            chosen = Settings(method=method, friction="described", effects="none")
            identification = identify(result.priors[prior], [log], settings=chosen)
            seconds, p = time.perf_counter() - began, identification.model.p
            fast, other = (accuracy(dynamics, along, result.truth, p) for along in motions)
            terms = motion_terms(dynamics, result.period, p)
            fit = SurrogateFit(prior, noisy, method, identification, seconds, fast, other, terms)
            fits.append(_compared(result, fit, progress) if fit.certified else fit)
    return tuple(fits)


def _compared(result: Reproduction, fit: SurrogateFit, progress: Progress) -> SurrogateFit:
    """A certified fit with its sweep over γ and, without noise, with other minimisers."""
    objective, settings, descents = fit.identification.problem.objective, result.settings, None

    def judge(x: np.ndarray) -> Accuracy:
        p = objective.reduction.parameters(x)
        return accuracy(result.dynamics, result.period, result.truth, p)

    if not fit.noisy:
        progress(f"watching other minimisers from {fit.prior}")
        descents = descend(replace(objective, gamma=DESCENT_GAMMA), judge, settings.iterations)
    progress(f"varying γ from {fit.prior}, {'with' if fit.noisy else 'without'} noise")
    return replace(fit, descents=descents, sweep=sweep(objective, judge, settings.gammas))
