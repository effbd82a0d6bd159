"""Sec. VIII without the authors' recording: a stand-in robot, identified and verified.

The stages: motions, a fast one to identify and a slow one to verify as in Sec. VIII C, and a second
fast one; recordings of the stand-in, whose drive 4 has friction that no model here has; fits from
both regularisations of Table I with the paper's friction law; base parameters; drive 4 retuned by
hand as for Fig. 8; and the friction law chosen from the fast recording alone.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.identification.torque_error import predict
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.reproduce.surrogate import RecordingSettings
from deltaid.reproduce.table_one import RETUNED, ROBOT, prior_robot, slow, stand_in, unmodelled
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

# Names of the candidates; CHOSEN starts from the prior 'RG geom'.
BASE, SIMPLE, GEOM, RETUNED_4, CHOSEN = (
    "base parameters", "ID simple", "ID geom", "ID geom, drive 4 retuned", "ID geom, law chosen"
)  # fmt: skip
_PRIORS = {SIMPLE: "RG simple", GEOM: "RG geom"}
QUICK = RecordingSettings(harmonics=5, duration=10.0, repeats=1)


@dataclass(frozen=True)
class Candidate:
    """Parameters to compare on the verification motions.

    Attributes:
        robot: with the friction laws of the parameters.
        p: the parameters.
        model: their origin; None for parameters derived from another candidate.
    """

    robot: RobotDescription
    p: Parameters
    model: IdentifiedModel | None = None


@dataclass(frozen=True)
class Track:
    """One verification motion as measured, filtered and thinned to the rate that the filter allows.

    Attributes:
        time [s], speed [rad/s], measured [N m].
        noise: residual of the true model, root mean square [N m].
        speed_max, acceleration_max: of drive 4 [rad/s, rad/s²].
        rms: root mean square of measured minus predicted torque, by candidate [N m].
        predicted: torques of each candidate [N m].
    """

    time: Float[np.ndarray, " samples"]
    speed: Float[np.ndarray, "samples dof"]
    measured: Float[np.ndarray, "samples dof"]
    noise: Float[np.ndarray, " dof"]
    speed_max: float
    acceleration_max: float
    rms: dict[str, Float[np.ndarray, " dof"]]
    predicted: dict[str, Float[np.ndarray, "samples dof"]]


@dataclass(frozen=True)
class Irb360:
    """Sec. VIII with a stand-in for the machine.

    Attributes:
        settings: of motions and recordings.
        dynamics, truth: of the stand-in.
        priors: by column of Table I.
        recordings: by file name.
        candidates: to be compared, by name.
        tracks: the verification motions: 'slow', as in Sec. VIII C, and 'fast', as fast as the
            identification.
        seconds: duration of the whole computation.
    """

    settings: RecordingSettings
    dynamics: Dynamics
    truth: Parameters
    priors: dict[str, RobotDescription]
    recordings: dict[str, pl.DataFrame]
    candidates: dict[str, Candidate]
    tracks: dict[str, Track]
    seconds: float

    @property
    def models(self) -> dict[str, IdentifiedModel]:
        """The identified models among the candidates."""
        return {name: c.model for name, c in self.candidates.items() if c.model is not None}


def reproduce_irb360(
    settings: RecordingSettings | None = None, progress: Progress = lambda _: None
) -> Irb360:
    """Reproduce Sec. VIII with a stand-in.

    Raises:
        DeltaidError: no motion was found, or a fit did not converge.
    """
    settings, began = settings or RecordingSettings(), time.perf_counter()
    rng, robot = np.random.default_rng(settings.seed), load_robot(ROBOT)
    priors = {column: prior_robot(robot, column) for column in _PRIORS.values()}
    dynamics = compiled(stand_in(robot))
    truth = prior_parameters(dynamics.robot)
    runs = _motions(priors["RG geom"], settings, progress)
    progress("recording")
    recordings = {
        f"{name}.csv": simulate_recording(
            dynamics,
            truth,
            run,
            rng,
            duration=run.duration,
            rate=settings.rate,
            noise=SensorNoise(settings.torque_noise),
            unmodelled=unmodelled,
        )
        for name, run in runs.items()
    }
    with TemporaryDirectory() as folder:
        for name, recording in recordings.items():
            write_recording(recording, Path(folder) / name)
        candidates = _candidates(priors, Path(folder) / "identify.csv", progress)
        tracks, true = {}, Candidate(dynamics.robot, truth)
        for motion in ("slow", "fast"):
            progress(f"verifying on the {motion} motion")
            log = Path(folder) / f"{motion}.csv"
            (recording,) = open_recordings([log], dynamics.kinematics, keep_all=True)
            tracks[motion] = _track(runs[motion], settings, true, candidates, recording)
    seconds = time.perf_counter() - began
    return Irb360(settings, dynamics, truth, priors, recordings, candidates, tracks, seconds)


def _motions(
    robot: RobotDescription, settings: RecordingSettings, progress: Progress
) -> dict[str, Run]:
    """Optimised motions: fast ones from two sets of start values, and one with a slow drive 4."""
    progress("preparing the excitation")
    exciter = Exciter(compiled(robot), settings.excitation)
    progress("optimising the fast motions")
    runs = {"identify": exciter.optimise().run}
    again = replace(settings.excitation, repeats=1)
    runs["fast"] = Exciter(compiled(robot), again).optimise(offset=VERIFICATION_OFFSET).run
    progress("optimising the slow motion")
    runs["slow"] = Exciter(compiled(slow(robot)), again).optimise(offset=VERIFICATION_OFFSET).run
    return runs


def _candidates(
    priors: dict[str, RobotDescription], log: Path, progress: Progress
) -> dict[str, Candidate]:
    runs, plain = {}, Settings(friction="described", effects="none")
    for name, column in _PRIORS.items():
        progress(f"identifying from {column}")
        runs[name] = identify(priors[column], [log], settings=plain)
    progress("choosing friction laws")
    chosen = identify(priors["RG geom"], [log], settings=Settings(effects="none"))
    geom = runs[GEOM]
    return {
        BASE: Candidate(geom.model.robot, geom.problem.estimate.full),
        **{name: _candidate(result.model) for name, result in runs.items()},
        RETUNED_4: Candidate(geom.model.robot, _retuned(geom.model)),
        CHOSEN: _candidate(chosen.model),
    }


def _candidate(model: IdentifiedModel) -> Candidate:
    return Candidate(model.robot, model.p, model)


def _retuned(model: IdentifiedModel) -> Parameters:
    """Drive 4's viscous friction times five and its Coulomb friction times 0.75 (Sec. VIII C)."""
    p, names = model.p, model.layout.names
    for name, factor in zip(("viscous.drive4", "coulomb.drive4"), RETUNED, strict=True):
        p[names.index(name)] *= factor
    return p


def _track(
    run: Run,
    settings: RecordingSettings,
    truth: Candidate,
    candidates: dict[str, Candidate],
    recording: PreparedRecording,
) -> Track:
    """A verification motion. A filter h passes σ ‖h‖ of white noise of level σ."""
    dynamics, thinned = compiled(truth.robot), recording.filter.thinned
    tracked = {
        name: list(predict(compiled(candidate.robot), candidate.p, recording))
        for name, candidate in candidates.items()
    }
    predicted = {
        name: np.vstack([part.filtered_predicted for part in parts])
        for name, parts in tracked.items()
    }
    parts = tracked[GEOM]  # the measurement is the same for all candidates
    measured = np.vstack([part.filtered_measured for part in parts])
    z, zd, zdd = run.evaluate(np.arange(0, run.duration, 1 / settings.rate))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, truth.p) + unmodelled(qd)
    noise = settings.torque_noise * np.abs(tau).max(axis=0)
    rows = slice(None, None, thinned // recording.filter.stride)
    return Track(
        time=np.concatenate([part.time for part in parts])[::thinned],
        speed=np.vstack([part.speed for part in parts])[::thinned],
        measured=measured[rows],
        noise=noise * recording.filter.noise_gain,
        speed_max=float(np.abs(qd[:, 3]).max()),
        acceleration_max=float(np.abs(qdd[:, 3]).max()),
        rms={
            name: np.sqrt(np.mean((measured - torque) ** 2, axis=0))
            for name, torque in predicted.items()
        },
        predicted={name: torque[rows] for name, torque in predicted.items()},
    )
