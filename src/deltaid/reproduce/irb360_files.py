"""Results of `reproduce irb360` as numbers and files that others can go on with."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.files import written_whole
from deltaid.motion.surrogate import write_recording
from deltaid.reproduce.irb360_result import Irb360
from deltaid.reproduce.surrogate_files import REPORT, RESULTS
from deltaid.reproduce.table_one import (
    COLUMNS,
    DETERMINED,
    RMS_BASE,
    RMS_IDENTIFIED,
    RMS_RETUNED,
    TABLE,
)
from deltaid.robot.load import save_yaml

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
    for candidate in result.candidates:
        if candidate.identification is not None:
            file = candidate.name.lower().replace(",", "").replace(" ", "-")
            written.append(folder / f"{file}.yaml")
            candidate.identification.model.save(written[-1])
    written.append(folder / RESULTS)
    with written_whole(written[-1]) as file:
        json.dump(as_dictionary(result), file, indent=1, allow_nan=False, ensure_ascii=False)
        file.write("\n")
    return tuple(written)


def as_dictionary(result: Irb360) -> dict[str, Any]:
    """All numbers in SI units. The keys are explained in docs/cli.md."""
    names, truth = result.dynamics.layout.names, result.truth
    models = {c.name: c.identification.model for c in result.candidates if c.identification}
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
            track.motion: {
                "speed_deg_s": float(np.rad2deg(track.speed_max)),
                "acceleration_deg_s2": float(np.rad2deg(track.acceleration_max)),
                "noise": track.noise.tolist(),
                "rms": {
                    c.name: result.result(c.name, track.motion).rms.tolist()
                    for c in result.candidates
                },
            }
            for track in result.tracks
        },
    }
