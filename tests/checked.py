"""Descriptions with mistakes and recordings to check them on."""

import json
from pathlib import Path
from typing import Any

import numpy as np

import deltaid
from deltaid.checks.verdicts import as_written, with_changes
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.verdict import Verdict
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import load_robot, yaml_text

Data = dict[str, Any]


def scaled(data: Data, factor: float, part: str = "") -> Data:
    """A description with all lengths, or those of one part, multiplied."""
    lengths = {
        "limbs": ("base_radius", "platform_radius", "upper_arm", "strut", "base_points",
                  "platform_points"),
        "workspace": ("radius", "z"),
        "telescope": ("stroke",),
        "platform": ("half_length", "length"),
    }  # fmt: skip

    def times(value: Any) -> Any:
        return [times(entry) for entry in value] if isinstance(value, list) else value * factor

    result = json.loads(json.dumps(data))
    for name, keys in lengths.items():
        for key in keys if name.startswith(part) else ():
            if key in (result.get(name) or {}):
                result[name][key] = times(result[name][key])
    if not part:
        for limits in result["drive_limits"].values():
            if "position" in limits:
                limits["position"] = times(limits["position"])
        for body in result["bodies"].values():
            for shape in body["prior"]:
                for key in {"length", "outer_radius", "inner_radius", "centre"} & set(shape):
                    shape[key] = times(shape[key])
    return result


def written(data: Data, path: Path) -> Path:
    path.write_text(yaml_text(data), encoding="utf-8")
    return path


def changed_file(folder: Path, changes: dict[str, Any]) -> Path:
    """Clavel's robot with some values changed, in a file."""
    return written(with_changes(as_written("clavel-delta3"), changes), folder / "robot.yaml")


def verdict_of(found: tuple[Verdict, ...], key: str) -> Verdict:
    matches = [verdict for verdict in found if verdict.key == key]
    assert len(matches) == 1, found
    return matches[0]


def moved(name: str, pace: float = 1.0, which: tuple[int, ...] = (0, 1, 2, 3)) -> deltaid.Recording:
    """Ten seconds of a random motion, slowed down, of some of the task coordinates."""
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(3)
    time = np.arange(2500) / 250
    z, zd, zdd = random_motion(dynamics.kinematics, rng).evaluate(pace * time)
    chosen = np.isin(np.arange(dynamics.dof), which)
    z = np.where(chosen, z, dynamics.kinematics.home)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, pace * zd * chosen, pace**2 * zdd * chosen)
    tau = dynamics.torque(z, qd, qdd, 1.1 * prior_parameters(dynamics.robot))
    tau += 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape) + 1e-6 * rng.normal(
        size=tau.shape
    )
    return deltaid.Recording.from_arrays(t=time, q=q, qd=qd, qdd=qdd, tau=tau)
