"""Sec. VII from excitation to numbers: a robot whose truth is known, identified from two priors.

The stages: two optimised motions, one to identify and one to verify; recordings of both, without
noise and as a drive would log them; fits from a regularisation below the truth (RG1) and one above
it (RG2), by both solvers; their accuracy along both motions; where other minimisers of the paper's
objective stop; and how all of it depends on γ.
"""

import time
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.reduction import Reduction
from deltaid.identification.identify import identify
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.reproduce.accuracy import Accuracy, accuracy, drive_motion, motion_terms, sweep
from deltaid.reproduce.descent import Descents, descend
from deltaid.reproduce.surrogate_result import Reproduction, SurrogateFit, SurrogateSettings, Sweep
from deltaid.reproduce.table_one import ABOVE, BELOW, ROBOT, nominal_robot, regularisation
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot


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
    along = drive_motion(
        dynamics, run, run.ramp + np.linspace(0, run.motion.period, settings.points)
    )
    period = replace(along, time=along.time - run.ramp)  # the first whole one
    result = Reproduction(
        settings=settings,
        dynamics=dynamics,
        nominal=nominal,
        truth=truth,
        priors=priors,
        run=run,
        verification=verification,
        period=period,
        terms=motion_terms(dynamics, period, truth),
        recordings=recordings,
    )
    result = replace(result, fits=_fits(result, progress))
    descents, sweeps = _descents(result, progress), _sweeps(result, progress)
    seconds = time.perf_counter() - began
    return replace(result, descents=descents, sweeps=sweeps, seconds=seconds)


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
            found = identify(result.priors[prior], [log], settings=chosen)
            seconds, p = time.perf_counter() - began, found.model.p
            fast, other = (accuracy(dynamics, along, result.truth, p) for along in motions)
            terms = motion_terms(dynamics, result.period, p)
            fits.append(SurrogateFit(prior, noisy, method, found, seconds, fast, other, terms))
    return tuple(fits)


def _descents(result: Reproduction, progress: Progress) -> dict[str, Descents]:
    """All minimisers on the recording without noise, from either prior."""
    descents, settings = dict[str, Descents](), result.settings
    for fit in result.fits:
        if fit.certified and not fit.noisy:
            progress(f"watching other minimisers from {fit.prior}")
            objective = fit.identification.problem.objective
            objective = replace(objective, gamma=settings.descent_gamma)
            judge = partial(_judged, result, objective.reduction)
            descents[fit.prior] = descend(objective, judge, settings.iterations)
    return descents


def _judged(result: Reproduction, reduction: Reduction, x: np.ndarray) -> Accuracy:
    return accuracy(result.dynamics, result.period, result.truth, reduction.parameters(x))


def _sweeps(result: Reproduction, progress: Progress) -> tuple[Sweep, ...]:
    sweeps, gammas = list[Sweep](), np.array(result.settings.gammas)
    for fit in result.fits:
        if fit.certified:
            progress(f"varying γ from {fit.prior}, {'with' if fit.noisy else 'without'} noise")
            points = sweep(result.dynamics, fit.identification, result.period, result.truth, gammas)
            sweeps.append(Sweep(fit.prior, fit.noisy, points))
    return tuple(sweeps)
