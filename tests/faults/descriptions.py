"""Faults of descriptions: missing or wrong units, priors, limits, workspaces."""

import copy
from dataclasses import replace
from typing import Any

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.robot.load import catalogue_text, load_robot
from faults.case import Case
from faults.tools import ImpossibleError, drives, kind, random_drive, rotary
from plants import log_uniform

_LENGTHS = ("base_radius", "platform_radius", "upper_arm", "strut", "base_points",
            "platform_points")  # fmt: skip


def written(case: Case) -> dict[str, Any]:
    """Plain data of the catalogue file of a case."""
    from ruamel.yaml import YAML

    return YAML(typ="safe", pure=True).load(catalogue_text(case.robot.name))


@kind("friction")
def friction_missing(case: Case, rng: np.random.Generator) -> Case:
    """Friction is missing for all joints, or for one drive."""
    data = written(case)
    if rng.uniform() < 0.6:
        del data["friction"]
        return replace(case, data=data, size="all")
    name = drives(case)[random_drive(case, rng)]
    del data["friction"][name]
    return replace(case, data=data, size=name)


@kind("limits")
def limits_missing(case: Case, rng: np.random.Generator) -> Case:
    """Limits are missing altogether, or for the platform."""
    data = written(case)
    del data["platform_speed"], data["platform_acceleration"]
    every = rng.uniform() < 0.6
    if every:
        del data["drive_limits"]
    return replace(case, data=data, size="all" if every else "of the platform")


def _scaled(node: Any, factor: float) -> Any:
    if isinstance(node, list):
        return [_scaled(entry, factor) for entry in node]
    return node * factor


@kind("length-unit", related=("prior-scale", "workspace", "torque-limit"))
def millimetres(case: Case, rng: np.random.Generator) -> Case:
    """All lengths are in millimetres; a desktop robot's could pass for metres."""
    data = written(case)
    small = rng.uniform() < 0.7
    factor = 1e3 * (rng.uniform(0.03, 0.08) if small else 1.0)
    for key in _LENGTHS:
        if key in data["limbs"]:
            data["limbs"][key] = _scaled(data["limbs"][key], factor)
    for key in ("half_length", "length"):
        if key in data.get("platform", {}):
            data["platform"][key] *= factor
    if "ratio" in data.get("platform", {}) and data["platform"]["kind"] == "i4":
        data["platform"]["ratio"] /= factor
    if "telescope" in data:
        data["telescope"].pop("stroke", None)
    for key in ("radius", "z"):
        data["workspace"][key] = _scaled(data["workspace"][key], factor)
    for limits in data["drive_limits"].values():
        if "position" in limits:
            limits["position"] = _scaled(limits["position"], factor)
    return replace(case, data=data, size="a desktop robot" if small else "all of a large one")


@kind("prior-scale", related=("torque-limit",))
def prior_scale(case: Case, rng: np.random.Generator) -> Case:
    """Masses in grams, or one body's mass 50 to 1000 times too large."""
    data = written(case)
    every, factor = rng.uniform() < 0.5, 1e3
    names = list(data["bodies"])
    if not every:
        names, factor = [str(rng.choice(names))], log_uniform(rng, 50, 1000)
    for name in names:
        for shape in data["bodies"][name]["prior"]:
            shape["mass"] *= factor
    return replace(case, data=data, size=f"{factor:.3g} times, {', '.join(names)}")


@kind("workspace")
def workspace_cut(case: Case, rng: np.random.Generator) -> Case:
    """Drives' ranges cover 30 to 70 % of the workspace, or the workspace is out of reach."""
    data = written(case)
    if rng.uniform() < 0.4:
        factor = rng.uniform(1.8, 2.5)
        data["workspace"]["radius"] *= factor
        return replace(case, data=data, size=f"workspace {factor:.2g} times as wide")
    share, turns = rng.uniform(0.3, 0.7), rotary(case)
    workspace, oracle = case.robot.workspace, case.setting.plant.oracle
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = [(workspace.radius * np.cos(a), workspace.radius * np.sin(a), z)
           for a in around for z in workspace.z]  # fmt: skip
    home = case.robot.home
    q = oracle.positions(np.hstack([np.array(rim), np.tile(home[3:], (len(rim), 1))]))
    if not np.all(np.isfinite(q)):
        raise ImpossibleError("the workspace is out of reach")
    middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0) * share
    for k, name in enumerate(drives(case)[: len(oracle.limbs)]):
        ends = [middle[k] - half[k], middle[k] + half[k]]
        key = "angle_deg" if turns[k] else "position"
        ends = np.rad2deg(ends) if turns[k] else ends
        data["drive_limits"][name] = data["drive_limits"][name] | {key: [float(e) for e in ends]}
    return replace(case, data=data, size=f"drives' ranges {share:.0%} of the workspace")


@kind("torque-limit")
def torque_limit(case: Case, rng: np.random.Generator) -> Case:
    """A drive's torque limit is 10 to 70 % of its holding torque at home."""
    data, dynamics = written(case), compiled(load_robot(case.robot.name))
    home = case.robot.home[None]
    still = np.zeros_like(home)
    held = np.abs(dynamics.torque(home, still, still, prior_parameters(case.robot)))[0]
    share, drive = rng.uniform(0.1, 0.7), int(rng.integers(3))
    name = drives(case)[drive]
    key = "torque" if rotary(case)[drive] else "force"
    data["drive_limits"][name] = data["drive_limits"][name] | {key: float(share * held[drive])}
    return replace(case, data=copy.deepcopy(data), size=f"{share:.0%} of {name}")
