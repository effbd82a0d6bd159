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

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.identification.torque_error import predict
from deltaid.mechanism.kinematics import Samples
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.excitation.settings import VERIFICATION_OFFSET
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.reproduce.irb360_result import (
    Candidate,
    Irb360,
    Irb360Settings,
    Track,
    Verified,
)
from deltaid.reproduce.table_one import (
    RETUNED,
    ROBOT,
    Drive4Friction,
    prior_robot,
    slow,
    stand_in,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

# Names of what is compared; the law is chosen with 'RG geom' as prior.
BASE, SIMPLE, GEOM, RETUNED_4, CHOSEN = (
    "base parameters", "ID simple", "ID geom", "ID geom, drive 4 retuned", "ID geom, law chosen"
)  # fmt: skip
_PRIORS = {SIMPLE: "RG simple", GEOM: "RG geom"}


@dataclass(frozen=True)
class _Scene:
    """The stand-in and its motions."""

    dynamics: Dynamics
    truth: Parameters
    friction: Drive4Friction
    runs: dict[str, Run]

    def unmodelled(self, qd: Samples) -> Samples:
        """What drive 4 has and no model."""
        tau = np.zeros_like(qd)
        tau[:, 3] = self.friction.torque(qd[:, 3])
        return tau

    def record(
        self, motion: str, settings: Irb360Settings, rng: np.random.Generator
    ) -> pl.DataFrame:
        """A motion as the drives would log it."""
        return simulate_recording(
            self.dynamics,
            self.truth,
            self.runs[motion],
            rng,
            duration=self.runs[motion].duration,
            rate=settings.rate,
            noise=SensorNoise(settings.torque_noise),
            unmodelled=self.unmodelled,
        )


def reproduce_irb360(
    settings: Irb360Settings | None = None, progress: Progress = lambda _: None
) -> Irb360:
    """Do Sec. VIII with a stand-in.

    Raises:
        DeltaidError: no motion was found, or a fit did not converge.
    """
    settings, began = settings or Irb360Settings(), time.perf_counter()
    rng, friction = np.random.default_rng(settings.seed), Drive4Friction()
    robot = load_robot(ROBOT)
    priors = {column: prior_robot(robot, column) for column in _PRIORS.values()}
    dynamics = compiled(stand_in(robot))
    truth = prior_parameters(dynamics.robot)
    scene = _Scene(dynamics, truth, friction, _motions(priors["RG geom"], settings, progress))
    progress("recording")
    recordings = {f"{name}.csv": scene.record(name, settings, rng) for name in scene.runs}
    with TemporaryDirectory() as folder:
        for name, recording in recordings.items():
            write_recording(recording, Path(folder) / name)
        candidates = _candidates(priors, Path(folder) / "identify.csv", progress)
        tracks, verified = dict[str, Track](), dict[tuple[str, str], Verified]()
        for motion in ("slow", "fast"):
            progress(f"verifying on the {motion} motion")
            log = Path(folder) / f"{motion}.csv"
            (recording,) = open_recordings([log], dynamics.kinematics, keep_all=True)
            tracks[motion] = _track(scene.runs[motion], settings, scene, recording)
            for name, candidate in candidates.items():
                verified[name, motion] = _verify(candidate, recording)
    return Irb360(
        settings=settings,
        dynamics=dynamics,
        truth=truth,
        friction=friction,
        priors=priors,
        runs=scene.runs,
        recordings=recordings,
        candidates=candidates,
        tracks=tracks,
        verified=verified,
        seconds=time.perf_counter() - began,
    )


def _motions(
    robot: RobotDescription, settings: Irb360Settings, progress: Progress
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
    """Everything that the fast recording gives."""
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
    rows = slice(None, None, recording.thinned // recording.stride)
    return Verified(np.sqrt(np.mean(error**2, axis=0)), predicted[rows])


def _track(
    run: Run, settings: Irb360Settings, scene: _Scene, recording: PreparedRecording
) -> Track:
    """A verification motion. Of white noise the filter h leaves σ ‖h‖."""
    parts, thinned = list(predict(scene.dynamics, scene.truth, recording)), recording.thinned
    z, zd, zdd = run.evaluate(np.arange(0, run.duration, 1 / settings.rate))
    _, qd, qdd = scene.dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = scene.dynamics.torque(z, qd, qdd, scene.truth) + scene.unmodelled(qd)
    noise = settings.torque_noise * np.abs(tau).max(axis=0)
    return Track(
        time=np.concatenate([part.time for part in parts])[::thinned],
        speed=np.vstack([part.speed for part in parts])[::thinned],
        measured=np.vstack([p.filtered_measured for p in parts])[:: thinned // recording.stride],
        noise=noise * recording.filter.noise_gain,
        speed_max=float(np.abs(qd[:, 3]).max()),
        acceleration_max=float(np.abs(qdd[:, 3]).max()),
    )
