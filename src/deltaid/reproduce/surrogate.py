"""Sec. VII from excitation to numbers: a robot whose truth is known, identified from two priors.

The stages: two optimised motions, one to identify and one to verify; recordings of both, without
noise and as a drive would log them; fits from a regularisation below the truth (RG1) and one above
it (RG2), by both solvers; their accuracy along both motions; where other minimisers of the paper's
objective stop; and how all of it depends on γ.
"""

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.reduction import Reduction
from deltaid.identification.identify import identify
from deltaid.model.options import Method
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.reproduce.accuracy import (
    Accuracy,
    DriveMotion,
    accuracy,
    drive_motion,
    motion_terms,
    sweep,
)
from deltaid.reproduce.descent import Descents, descend
from deltaid.reproduce.surrogate_result import Reproduction, SurrogateFit, SurrogateSettings, Sweep
from deltaid.reproduce.table_one import ABOVE, BELOW, ROBOT, nominal_robot, regularisation
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot


@dataclass(frozen=True)
class _SharedScene:
    """What all fits share."""

    dynamics: Dynamics
    truth: Parameters
    identification: DriveMotion
    verification: DriveMotion
    period: DriveMotion


def reproduce_surrogate(
    settings: SurrogateSettings | None = None, progress: Progress = lambda _: None
) -> Reproduction:
    """Do all of Sec. VII.

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
    scene = _SharedScene(
        dynamics=dynamics,
        truth=truth,
        identification=drive_motion(dynamics, run, _times(run, settings)),
        verification=drive_motion(dynamics, verification, _times(verification, settings)),
        period=_period(dynamics, run, settings.points),
    )
    fits = _fits(scene, priors, recordings, settings, progress)
    return Reproduction(
        settings=settings,
        dynamics=dynamics,
        nominal=nominal,
        truth=truth,
        priors=priors,
        run=run,
        verification=verification,
        period=scene.period,
        terms=motion_terms(dynamics, scene.period, truth),
        recordings=recordings,
        fits=fits,
        descents=_descents(scene, fits, settings, progress),
        sweeps=_sweeps(scene, fits, settings, progress),
        seconds=time.perf_counter() - began,
    )


def recording_name(kind: str, *, noisy: bool) -> str:
    """File name of a recording."""
    return f"{kind}-noisy.csv" if noisy else f"{kind}.csv"


def _motions(
    planned_with: RobotDescription, settings: SurrogateSettings, progress: Progress
) -> tuple[Run, Run]:
    """Two motions within the limits of a robot whose masses and friction lie above the truth, so
    that the true torques keep their limits too."""
    progress("preparing the excitation")
    exciter = Exciter(compiled(planned_with), settings.excitation)
    progress(f"optimising the motion from {settings.starts} starts")
    first = exciter.optimise()
    progress("optimising the verification motion")
    return first.run, exciter.optimise(offset=VERIFICATION_OFFSET).run


def _times(run: Run, settings: SurrogateSettings) -> np.ndarray:
    return np.arange(round(run.duration * settings.rate)) / settings.rate


def _period(dynamics: Dynamics, run: Run, points: int) -> DriveMotion:
    """The first whole period after the ramp."""
    along = drive_motion(dynamics, run, run.ramp + np.linspace(0, run.motion.period, points))
    return DriveMotion(along.time - run.ramp, along.q, along.qd, along.qdd)


def _fits(
    scene: _SharedScene,
    priors: dict[str, RobotDescription],
    recordings: dict[str, pl.DataFrame],
    settings: SurrogateSettings,
    progress: Progress,
) -> tuple[SurrogateFit, ...]:
    fits = []
    with TemporaryDirectory() as folder:
        for noisy in (False, True):
            name = recording_name("identify", noisy=noisy)
            log = Path(folder) / name
            write_recording(recordings[name], log)
            for prior, robot in priors.items():
                for method in settings.methods:
                    progress(f"fitting {name} from {prior}, {method}")
                    fits.append(_fit(scene, prior, robot, log, noisy=noisy, method=method))
    return tuple(fits)


def _fit(
    scene: _SharedScene,
    prior: str,
    robot: RobotDescription,
    log: Path,
    *,
    noisy: bool,
    method: Method,
) -> SurrogateFit:
    began = time.perf_counter()
    result = identify(
        robot, [log], settings=Settings(method=method, friction="described", effects="none")
    )
    seconds = time.perf_counter() - began
    p = result.model.p
    return SurrogateFit(
        prior=prior,
        noisy=noisy,
        method=method,
        identification=result,
        seconds=seconds,
        accuracy=accuracy(scene.dynamics, scene.identification, scene.truth, p),
        verified=accuracy(scene.dynamics, scene.verification, scene.truth, p),
        terms=motion_terms(scene.dynamics, scene.period, p),
    )


def _descents(
    scene: _SharedScene,
    fits: tuple[SurrogateFit, ...],
    settings: SurrogateSettings,
    progress: Progress,
) -> dict[str, Descents]:
    """All minimisers on the recording without noise, from either prior."""
    descents = {}
    for fit in fits:
        if fit.noisy or not fit.certified:
            continue
        progress(f"watching other minimisers from {fit.prior}")
        objective = replace(fit.identification.problem.objective, gamma=settings.descent_gamma)
        judge = partial(_judged, scene, objective.reduction)
        descents[fit.prior] = descend(objective, judge, settings.iterations)
    return descents


def _judged(scene: _SharedScene, reduction: Reduction, x: np.ndarray) -> Accuracy:
    return accuracy(scene.dynamics, scene.period, scene.truth, reduction.parameters(x))


def _sweeps(
    scene: _SharedScene,
    fits: tuple[SurrogateFit, ...],
    settings: SurrogateSettings,
    progress: Progress,
) -> tuple[Sweep, ...]:
    sweeps = []
    for fit in fits:
        if not fit.certified:
            continue
        progress(f"varying γ from {fit.prior}, {'with' if fit.noisy else 'without'} noise")
        gammas, problem = np.array(settings.gammas), fit.identification
        points = sweep(scene.dynamics, problem, scene.period, scene.truth, gammas)
        sweeps.append(Sweep(fit.prior, fit.noisy, points))
    return tuple(sweeps)
