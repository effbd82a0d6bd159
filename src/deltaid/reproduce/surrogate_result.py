"""What reproducing Sec. VII is asked for, what it finds, and that as files that others can go on
with."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.conic import SOLVERS
from deltaid.files import require_writable, written_whole
from deltaid.identification.identify import Identification
from deltaid.model.options import Method
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import ExcitationSettings
from deltaid.motion.surrogate import write_recording
from deltaid.reproduce.accuracy import CLAIMS, Accuracy, DriveMotion, MotionTerms, SweepPoint
from deltaid.reproduce.descent import Descent, Descents
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import save_yaml


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


RESULTS, REPORT = "results.json", "report.html"
# Everything in the folder, with what it holds.
FILES = {
    REPORT: "tables and figures",
    RESULTS: "all numbers",
    "nominal.yaml": "the robot with the true parameters as prior",
    "RG1.yaml": "the robot with the regularisation below the truth as prior",
    "RG2.yaml": "the robot with the regularisation above the truth as prior",
    "identify.csv": "recording of the motion, without noise",
    "identify-noisy.csv": "the same with noise",
    "verify.csv": "recording of the verification motion, without noise",
    "verify-noisy.csv": "the same with noise",
    "ID1.yaml": "model identified from RG1 without noise, conic",
    "ID1-noisy.yaml": "the same with noise",
    "ID2.yaml": "model identified from RG2 without noise, conic",
    "ID2-noisy.yaml": "the same with noise",
}


def require_folder(folder: Path, files: Iterable[str]) -> None:
    """Find out whether the files of a folder can be written, before a long computation.

    Raises:
        DeltaidError: one cannot.
    """
    for name in files:
        require_writable(folder / name)


def write_files(result: Reproduction, folder: Path) -> None:
    """Write results.json, descriptions, recordings and models.

    Raises:
        DeltaidError: a file cannot be written.
    """
    for name, robot in {"nominal": result.nominal, **result.priors}.items():
        save_yaml(robot, folder / f"{name}.yaml")
    for name, recording in result.recordings.items():
        write_recording(recording, folder / name)
    for fit in result.fits:
        if fit.certified:
            fit.identification.model.save(folder / model_name(fit))
    write_results(as_dictionary(result), folder)


def write_results(content: dict[str, Any], folder: Path) -> Path:
    """Write results.json, and return its path.

    Raises:
        DeltaidError: the file cannot be written.
    """
    with written_whole(folder / RESULTS) as file:
        json.dump(content, file, indent=1, allow_nan=False, ensure_ascii=False)
        file.write("\n")
    return folder / RESULTS


def model_name(fit: SurrogateFit) -> str:
    """File of an identified model: ID1 comes from RG1, ID2 from RG2."""
    return f"{fit.prior.replace('RG', 'ID')}{'-noisy' if fit.noisy else ''}.yaml"


def as_dictionary(result: Reproduction) -> dict[str, Any]:
    """All numbers; shares, not per cent. The keys are explained in docs/results.md."""
    names, units = result.dynamics.layout.names, result.dynamics.layout.units
    columns = {"nominal": result.truth}
    for fit in result.fits:
        reduction = fit.identification.problem.reduction
        if fit.certified:
            columns[fit.prior] = reduction.p_reg
            columns[model_name(fit).removesuffix(".yaml")] = fit.identification.model.p
    return {
        "robot": result.nominal.name,
        "seed": result.settings.seed,
        "torque_noise": result.settings.torque_noise,
        "seconds": result.seconds,
        "motions": {
            "identification": _motion(result.run),
            "verification": _motion(result.verification),
        },
        "paper": [
            {"quantity": c.quantity, "share": c.share, "words": c.words, "place": c.place}
            for c in CLAIMS
        ],
        "fits": [_fit(fit) for fit in result.fits],
        "minimisers": [_descents(prior, d) for prior, d in result.descents.items()],
        "gamma_sweep": [_sweep(s, result) for s in result.sweeps],
        "parameters": [
            {"name": name, "unit": unit, **{key: float(p[i]) for key, p in columns.items()}}
            for i, (name, unit) in enumerate(zip(names, units, strict=True))
            if result.truth[i] != 0
        ],
    }


def _motion(run: Run) -> dict[str, Any]:
    return {
        "duration": run.duration,
        "period": run.motion.period,
        "periods": run.repeats,
        "ramp": run.ramp,
    }


def _fit(fit: SurrogateFit) -> dict[str, Any]:
    reached = fit.identification.model.fit
    return {
        "prior": fit.prior,
        "noise": fit.noisy,
        "method": fit.method,
        **_accuracy(fit.accuracy),
        "verification": _accuracy(fit.verified),
        "objective": reached.objective,
        "duality_gap": reached.duality_gap,
        "gamma": reached.gamma,
        "noise_level": reached.noise_level,
        "iterations": reached.iterations,
        "status": reached.status,
        "seconds": fit.seconds,
    }


def _accuracy(a: Accuracy) -> dict[str, Any]:
    return {
        "mass_diagonal": a.mass_diagonal,
        "mass_off_diagonal": a.mass_off_diagonal,
        "mass": a.mass.tolist(),
        "coriolis": a.coriolis.tolist(),
        "acceleration": a.acceleration.tolist(),
        "friction": a.friction.tolist(),
        "friction_coefficients": a.coefficients.tolist(),
        "cholesky_succeeds": a.definite,
        "samples": a.samples,
    }


def _descents(prior: str, descents: Descents) -> dict[str, Any]:
    return {
        "prior": prior,
        "gamma": descents.gamma,
        "conic": {
            "objective": descents.conic.objective,
            "duality_gap": descents.conic.duality_gap,
            "seconds": descents.conic_seconds,
        },
        "ways": [_descent(way) for way in descents.ways],
    }


def _descent(way: Descent) -> dict[str, Any]:
    return {
        "way": way.way,
        "steps": len(way.objective) - 1,
        "seconds": float(way.seconds[-1]),
        "objective": float(way.objective[-1]),
        "gradient": float(way.gradient[-1]),
        "distance": way.distance,
        "smallest_exponential": {"name": way.smallest_name, "share": way.smallest},
        "accuracy": _accuracy(way.at_end),
        "usual_tolerance": None
        if way.usual is None or way.at_usual is None
        else {
            "step": way.usual,
            "objective": float(way.objective[way.usual]),
            "accuracy": _accuracy(way.at_usual),
        },
    }


def _sweep(sweep: Sweep, result: Reproduction) -> dict[str, Any]:
    chosen = result.fit(sweep.prior, noisy=sweep.noisy).identification.model.fit.gamma
    return {
        "prior": sweep.prior,
        "noise": sweep.noisy,
        "chosen_gamma": chosen,
        "points": [
            {"gamma": p.gamma, "objective": p.objective, **_accuracy(p.accuracy)}
            for p in sweep.points
        ],
    }
