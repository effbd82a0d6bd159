"""What reproducing Sec. VIII finds, and that as files that others can go on with."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.identification.identify import Identification
from deltaid.motion.excitation.run import Run
from deltaid.motion.surrogate import write_recording
from deltaid.reproduce.surrogate_files import REPORT, RESULTS, write_results
from deltaid.reproduce.surrogate_result import RecordingSettings
from deltaid.reproduce.table_one import (
    COLUMNS,
    DETERMINED,
    RMS_BASE,
    RMS_IDENTIFIED,
    RMS_RETUNED,
    TABLE,
    Drive4Friction,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import save_yaml


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
