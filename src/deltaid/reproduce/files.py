"""Files of `deltaid reproduce`: descriptions, recordings, models and all numbers.

docs/results.md explains the keys of results.json; all numbers are in SI units, and shares are not
in per cent.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.files import require_writable, written_whole
from deltaid.motion.surrogate import write_recording
from deltaid.reproduce.accuracy import CLAIMS, Accuracy
from deltaid.reproduce.descent import Descent, Descents
from deltaid.reproduce.irb360 import Irb360
from deltaid.reproduce.surrogate import Reproduction, SurrogateFit
from deltaid.reproduce.table_one import (
    COLUMNS,
    DETERMINED,
    RMS_BASE,
    RMS_IDENTIFIED,
    RMS_RETUNED,
    TABLE,
)
from deltaid.robot.load import save_yaml

RESULTS, REPORT = "results.json", "report.html"
# Files of both examples, and those of the surrogate with a note on their content.
SURROGATE_FILES = {
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
IRB360_FILES = (
    REPORT, RESULTS, "rg-simple.yaml", "rg-geom.yaml", "identify.csv", "slow.csv", "fast.csv",
    "id-simple.yaml", "id-geom.yaml", "id-geom-law-chosen.yaml",
)  # fmt: skip


def require_folder(folder: Path, files: Iterable[str]) -> None:
    """Check before a long computation that the files of a folder can be written.

    Raises:
        DeltaidError: a file cannot be written.
    """
    for name in files:
        require_writable(folder / name)


def write_files(result: Reproduction | Irb360, folder: Path) -> None:
    """Write results.json, descriptions, recordings and models.

    Raises:
        DeltaidError: a file cannot be written.
    """
    if isinstance(result, Irb360):
        robots = {robot.name: robot for robot in result.priors.values()}
        models = {
            name.lower().replace(",", "").replace(" ", "-"): model
            for name, model in result.models.items()
        }
    else:
        robots = {"nominal": result.dynamics.robot, **result.priors}
        models = {model_name(fit): fit.identification.model for fit in result.certified}
    for name, robot in robots.items():
        save_yaml(robot, folder / f"{name}.yaml")
    for name, recording in result.recordings.items():
        write_recording(recording, folder / name)
    for name, model in models.items():
        model.save(folder / f"{name}.yaml")
    with written_whole(folder / RESULTS) as file:
        json.dump(as_dictionary(result), file, indent=1, allow_nan=False, ensure_ascii=False)
        file.write("\n")


def model_name(fit: SurrogateFit) -> str:
    """File name of an identified model: ID1 from RG1, ID2 from RG2."""
    return f"{fit.name}{'-noisy' if fit.noisy else ''}"


def as_dictionary(result: Reproduction | Irb360) -> dict[str, Any]:
    """All numbers of an example, as results.json has them."""
    shared = {
        "seed": result.settings.seed,
        "torque_noise": result.settings.torque_noise,
        "seconds": result.seconds,
    }
    return shared | (_irb360(result) if isinstance(result, Irb360) else _surrogate(result))


def _surrogate(result: Reproduction) -> dict[str, Any]:
    names, units = result.dynamics.layout.names, result.dynamics.layout.units
    columns = {"nominal": result.truth}
    for fit in result.certified:
        columns[fit.prior] = fit.identification.problem.reduction.p_reg
        columns[model_name(fit)] = fit.identification.model.p
    motions = {"identification": result.run, "verification": result.verification}
    return {
        "robot": result.dynamics.robot.name,
        "motions": {
            name: {
                "duration": run.duration,
                "period": run.motion.period,
                "periods": run.repeats,
                "ramp": run.ramp,
            }
            for name, run in motions.items()
        },
        "paper": [
            {
                "quantity": claim.quantity,
                "share": claim.share,
                "words": claim.words,
                "place": f"Sec. VII, {claim.place}",
            }
            for claim in CLAIMS
        ],
        "fits": [_fit(fit) for fit in result.fits],
        "minimisers": [_minimisers(*each) for each in result.descents.items()],
        "gamma_sweep": [
            {
                "prior": fit.prior,
                "noise": fit.noisy,
                "chosen_gamma": fit.identification.model.fit.gamma,
                "points": [
                    {"gamma": p.gamma, "objective": p.objective, **_accuracy(p.accuracy)}
                    for p in fit.sweep
                ],
            }
            for fit in result.certified
        ],
        "parameters": [
            {"name": name, "unit": unit, **{key: float(p[i]) for key, p in columns.items()}}
            for i, (name, unit) in enumerate(zip(names, units, strict=True))
            if result.truth[i] != 0
        ],
    }


def _minimisers(prior: str, descents: Descents) -> dict[str, Any]:
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


def _irb360(result: Irb360) -> dict[str, Any]:
    truth = result.dynamics.layout.named(result.truth)
    return {
        "paper": {
            "columns": list(COLUMNS),
            "table": {name: list(values) for name, values in TABLE.items()},
            "determined": list(DETERMINED),
            "rms_base": list(RMS_BASE),
            "rms_identified": list(RMS_IDENTIFIED),
            "rms_retuned": RMS_RETUNED,
        },
        "truth": {name: value for name, value in truth.items() if value != 0},
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
            for name, model in result.models.items()
        },
        "motions": {
            motion: {
                "speed_deg_s": float(np.rad2deg(track.speed_max)),
                "acceleration_deg_s2": float(np.rad2deg(track.acceleration_max)),
                "noise": track.noise.tolist(),
                "rms": {name: rms.tolist() for name, rms in track.rms.items()},
            }
            for motion, track in result.tracks.items()
        },
    }
