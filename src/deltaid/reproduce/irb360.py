"""Sec. VIII as far as it goes without the authors' recording: a stand-in, fitted and verified.

The stages: motions, fast to identify and slow to verify as in Sec. VIII C, and a second fast one;
recordings of the stand-in, whose drive 4 has friction that no model here has; fits from both
regularisations of Table I with the paper's friction law; base parameters; drive 4 retuned by hand
as for Fig. 8; and the friction law chosen from the fast recording alone.
"""

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.identification.torque_error import predict
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.reproduce.irb360_result import (
    BASE,
    CHOSEN,
    GEOM,
    RETUNED_4,
    SIMPLE,
    Candidate,
    Irb360,
    Track,
    Verified,
)
from deltaid.reproduce.surrogate_result import RecordingSettings
from deltaid.reproduce.table_one import RETUNED, ROBOT, Drive4Friction, prior_robot, slow, stand_in
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

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
