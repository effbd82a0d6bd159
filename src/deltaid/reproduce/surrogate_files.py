"""Files of `reproduce surrogate`: descriptions, recordings, models and all numbers."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from deltaid.files import require_writable, written_whole
from deltaid.motion.excitation.run import Run
from deltaid.motion.surrogate import write_recording
from deltaid.reproduce.accuracy import CLAIMS, Accuracy
from deltaid.reproduce.descent import Descent, Descents
from deltaid.reproduce.surrogate_result import Reproduction, SurrogateFit, Sweep
from deltaid.robot.load import save_yaml

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
