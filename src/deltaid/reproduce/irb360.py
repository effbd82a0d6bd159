"""Sec. VIII as far as it goes without the authors' recording: a stand-in, fitted and verified.

The stages: motions, fast to identify and slow to verify as in Sec. VIII C, and a second fast one;
recordings of the stand-in, whose drive 4 has friction that no model here has; fits from both
regularisations of Table I with the paper's friction law; base parameters; drive 4 retuned by hand
as for Fig. 8; and the friction law chosen from the fast recording alone.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import Identification, identify
from deltaid.identification.torque_error import predict
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.reproduce.surrogate_files import REPORT, RESULTS, write_results
from deltaid.reproduce.surrogate_result import RecordingSettings
from deltaid.reproduce.table_one import (
    COLUMNS,
    DETERMINED,
    RETUNED,
    RMS_BASE,
    RMS_IDENTIFIED,
    RMS_RETUNED,
    ROBOT,
    TABLE,
    Drive4Friction,
    prior_robot,
    slow,
    stand_in,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot, save_yaml


@dataclass(frozen=True)
class Candidate:
    """Parameters to compare on the verification motions.

    Attributes:
        robot: whose friction laws they belong to.
        p: the parameters.
        identification: where they come from; None for what is derived from another one.
    """

    robot: RobotDescription
    p: Parameters
    identification: Identification | None


@dataclass(frozen=True)
class Verified:
    """One candidate on one verification motion.

    Attributes:
        rms: root mean square of measured minus predicted torque, through the filter [N m].
        predicted: torques through the filter at the times of the motion's `Track` [N m].
    """

    rms: Float[np.ndarray, " dof"]
    predicted: Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class Track:
    """One verification motion as measured, through the filter, thinned to the rate it allows.

    Attributes:
        time [s], speed [rad/s], measured [N m].
        noise: what the true model leaves of the measured torques, root mean square [N m].
        speed_max, acceleration_max: of drive 4 [rad/s, rad/s²].
    """

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
        candidates: what is compared, by name.
        tracks: the verification motions: 'slow', as in Sec. VIII C, and 'fast', as fast as the
            identification.
        verified: every candidate on each of them, by both names.
        seconds: for all of it.
    """

    settings: RecordingSettings
    dynamics: Dynamics
    truth: Parameters
    friction: Drive4Friction
    priors: dict[str, RobotDescription]
    runs: dict[str, Run]
    recordings: dict[str, pl.DataFrame]
    candidates: dict[str, Candidate]
    tracks: dict[str, Track]
    verified: dict[tuple[str, str], Verified]
    seconds: float


QUICK = RecordingSettings(harmonics=5, duration=10.0, repeats=1)


# Everything in the folder.
FILES = (
    REPORT, RESULTS, "rg-simple.yaml", "rg-geom.yaml", "identify.csv", "slow.csv", "fast.csv",
    "id-simple.yaml", "id-geom.yaml", "id-geom-law-chosen.yaml",
)  # fmt: skip


def write_files(result: Irb360, folder: Path) -> tuple[Path, ...]:
    """Write results.json, priors, recordings and models.

    Raises:
        DeltaidError: a file cannot be written.
    """
    written = []
    for robot in result.priors.values():
        written.append(folder / f"{robot.name}.yaml")
        save_yaml(robot, written[-1])
    for name, recording in result.recordings.items():
        written.append(folder / name)
        write_recording(recording, written[-1])
    for name, candidate in result.candidates.items():
        if candidate.identification is not None:
            file = name.lower().replace(",", "").replace(" ", "-")
            written.append(folder / f"{file}.yaml")
            candidate.identification.model.save(written[-1])
    return (*written, write_results(as_dictionary(result), folder))


def as_dictionary(result: Irb360) -> dict[str, Any]:
    """All numbers in SI units. The keys are explained in docs/results.md."""
    names, truth = result.dynamics.layout.names, result.truth
    models = {
        name: candidate.identification.model
        for name, candidate in result.candidates.items()
        if candidate.identification
    }
    return {
        "seed": result.settings.seed,
        "torque_noise": result.settings.torque_noise,
        "seconds": result.seconds,
        "paper": {
            "columns": list(COLUMNS),
            "table": {name: list(values) for name, values in TABLE.items()},
            "determined": list(DETERMINED),
            "rms_base": list(RMS_BASE),
            "rms_identified": list(RMS_IDENTIFIED),
            "rms_retuned": RMS_RETUNED,
        },
        "truth": {
            name: float(value) for name, value in zip(names, truth, strict=True) if value != 0
        },
        "models": {
            name: {
                "parameters": [
                    p.model_dump() for p in model.parameters if p.determined_by != "structure"
                ],
                "friction": {
                    joint: law.model_dump(exclude_none=True)
                    for joint, law in model.robot.friction.items()
                },
                "choice": model.friction_choice and model.friction_choice.model_dump(),
            }
            for name, model in models.items()
        },
        "motions": {
            motion: {
                "speed_deg_s": float(np.rad2deg(track.speed_max)),
                "acceleration_deg_s2": float(np.rad2deg(track.acceleration_max)),
                "noise": track.noise.tolist(),
                "rms": {
                    name: result.verified[name, motion].rms.tolist() for name in result.candidates
                },
            }
            for motion, track in result.tracks.items()
        },
    }


# Names of what is compared; the law is chosen with 'RG geom' as prior.
BASE, SIMPLE, GEOM, RETUNED_4, CHOSEN = (
    "base parameters", "ID simple", "ID geom", "ID geom, drive 4 retuned", "ID geom, law chosen"
)  # fmt: skip
_PRIORS = {SIMPLE: "RG simple", GEOM: "RG geom"}


def reproduce_irb360(
    settings: RecordingSettings | None = None, progress: Progress = lambda _: None
) -> Irb360:
    """Do Sec. VIII with a stand-in.

    Raises:
        DeltaidError: no motion was found, or a fit did not converge.
    """
    settings, began = settings or RecordingSettings(), time.perf_counter()
    rng, friction = np.random.default_rng(settings.seed), Drive4Friction()
    robot = load_robot(ROBOT)
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
            unmodelled=friction.unmodelled,
        )
        for name, run in runs.items()
    }
    with TemporaryDirectory() as folder:
        for name, recording in recordings.items():
            write_recording(recording, Path(folder) / name)
        candidates = _candidates(priors, Path(folder) / "identify.csv", progress)
        tracks, verified = dict[str, Track](), dict[tuple[str, str], Verified]()
        for motion in ("slow", "fast"):
            progress(f"verifying on the {motion} motion")
            log = Path(folder) / f"{motion}.csv"
            (recording,) = open_recordings([log], dynamics.kinematics, keep_all=True)
            tracks[motion] = _track(runs[motion], settings, dynamics, truth, friction, recording)
            for name, candidate in candidates.items():
                verified[name, motion] = _verify(candidate, recording)
    return Irb360(
        settings=settings,
        dynamics=dynamics,
        truth=truth,
        friction=friction,
        priors=priors,
        runs=runs,
        recordings=recordings,
        candidates=candidates,
        tracks=tracks,
        verified=verified,
        seconds=time.perf_counter() - began,
    )


def _motions(
    robot: RobotDescription, settings: RecordingSettings, progress: Progress
) -> dict[str, Run]:
    """Optimised motions: fast ones from two sets of start values, and one with drive 4 slow."""
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
    found = {}
    for name, column in _PRIORS.items():
        progress(f"identifying from {column}")
        result = identify(
            priors[column], [log], settings=Settings(friction="described", effects="none")
        )
        found[name] = Candidate(result.model.robot, result.model.p, result)
    geom = found[GEOM].identification
    assert geom is not None
    progress("choosing friction laws")
    chosen = identify(priors["RG geom"], [log], settings=Settings(effects="none"))
    return {
        BASE: Candidate(geom.model.robot, geom.problem.estimate.full, None),
        **found,
        RETUNED_4: Candidate(geom.model.robot, _retuned(found[GEOM]), None),
        CHOSEN: Candidate(chosen.model.robot, chosen.model.p, chosen),
    }


def _retuned(candidate: Candidate) -> Parameters:
    """Drive 4's viscous friction times five and its Coulomb friction times 0.75 (Sec. VIII C)."""
    p, names = candidate.p.copy(), compiled(candidate.robot).layout.names
    for name, factor in zip(("viscous.drive4", "coulomb.drive4"), RETUNED, strict=True):
        p[names.index(name)] *= factor
    return p


def _verify(candidate: Candidate, recording: PreparedRecording) -> Verified:
    parts = list(predict(compiled(candidate.robot), candidate.p, recording))
    error = np.vstack([part.filtered_measured - part.filtered_predicted for part in parts])
    predicted = np.vstack([part.filtered_predicted for part in parts])
    rows = slice(None, None, recording.filter.thinned // recording.filter.stride)
    return Verified(np.sqrt(np.mean(error**2, axis=0)), predicted[rows])


def _track(
    run: Run,
    settings: RecordingSettings,
    dynamics: Dynamics,
    truth: Parameters,
    friction: Drive4Friction,
    recording: PreparedRecording,
) -> Track:
    """A verification motion. Of white noise the filter h leaves σ ‖h‖."""
    parts, thinned = list(predict(dynamics, truth, recording)), recording.filter.thinned
    z, zd, zdd = run.evaluate(np.arange(0, run.duration, 1 / settings.rate))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, truth) + friction.unmodelled(qd)
    noise = settings.torque_noise * np.abs(tau).max(axis=0)
    return Track(
        time=np.concatenate([part.time for part in parts])[::thinned],
        speed=np.vstack([part.speed for part in parts])[::thinned],
        measured=np.vstack([p.filtered_measured for p in parts])[
            :: thinned // recording.filter.stride
        ],
        noise=noise * recording.filter.noise_gain,
        speed_max=float(np.abs(qd[:, 3]).max()),
        acceleration_max=float(np.abs(qdd[:, 3]).max()),
    )
