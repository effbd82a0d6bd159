"""Recordings with known truth: the shared logs where present, and the oracle's own."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from oracle.delta import Body, DeltaOracle

LOGS = Path(__file__).resolve().parents[2] / "shared" / "logs"
needs_logs = pytest.mark.skipif(
    not LOGS.is_dir(), reason=f"recordings with known truth are not at {LOGS.name}/ beside the repo"
)
CATALOGUE = {"delta3": "clavel-delta3", "delta4": "irb360-6-1600"}


def inertia_vector(body: Body) -> list[float]:
    """The ten parameters (4) of an oracle's body."""
    I = body.inertia
    return [body.m, *body.mc, I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2]]


def describe(oracle: DeltaOracle, share: float = 1.0) -> RobotDescription:
    """A description of an oracle's robot whose priors are a share of the truth.

    The catalogue robot gives the reduction tables, limits and everything that is not measured.
    """
    data = load_robot(CATALOGUE["delta4" if oracle.has_telescope else "delta3"]).model_dump(
        mode="json"
    )
    data["limbs"] |= {
        "base_radius": oracle.base_radius,
        "platform_radius": oracle.platform_radius,
        "upper_arm": oracle.upper_arm,
        "strut": oracle.strut,
    }
    for name, body in data["bodies"].items():
        p = share * np.array(inertia_vector(oracle.bodies[name]))
        keys = ("xx", "yy", "zz", "xy", "yz", "xz")
        body["prior"] = {
            "mass": p[0],
            "first_moment": p[1:4].tolist(),
            "inertia": dict(zip(keys, p[4:].tolist(), strict=True)),
        }
    joints = list(data["friction"])
    for joint, viscous, coulomb in zip(joints, oracle.viscous, oracle.coulomb, strict=True):
        data["friction"][joint] = {"viscous": share * viscous, "coulomb": share * coulomb}
    data["rotor_inertia"] = {
        f"drive{i + 1}": share * J for i, J in enumerate(oracle.rotor_inertia) if J > 0
    }
    return RobotDescription.model_validate(data)


def true_parameters(oracle: DeltaOracle) -> np.ndarray:
    """p of an oracle, in the order of its description."""
    names = ("U", "S", "P") + (("TU", "TL", "EE") if oracle.has_telescope else ())
    inertias = [value for name in names for value in inertia_vector(oracle.bodies[name])]
    rotors = [J for J in oracle.rotor_inertia if J > 0]
    return np.array([*inertias, *oracle.viscous, *oracle.coulomb, *rotors])


def shared_oracle(name: str) -> DeltaOracle:
    """The robot behind a shared recording."""
    robot, truth = (
        json.loads((LOGS / name / f"{kind}.json").read_text()) for kind in ("robot", "truth")
    )
    return DeltaOracle.from_json(robot, truth)


def typical_oracle(rng: np.random.Generator, *, telescope: bool) -> DeltaOracle:
    """A robot of the usual build: tubes along the links, whatever the reductions assume.

    Sizes and masses are random; bodies are scaled from the catalogue's priors.
    """
    from deltaid.motion.surrogate import surrogate_parameters

    robot = load_robot(CATALOGUE["delta4" if telescope else "delta3"])
    dynamics = Dynamics(robot)
    p, layout, limbs = surrogate_parameters(robot, rng), dynamics.layout, robot.limbs
    bodies = {}
    for name in layout.bodies:
        m, mcx, mcy, mcz, xx, yy, zz, xy, yz, xz = p[layout.body(name)]
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        bodies[name] = Body(m, np.array([mcx, mcy, mcz]), tensor)
    rotors = np.zeros(len(robot.drives))
    rotors[[robot.drives.index(d) for d in robot.rotor_drives]] = p[layout.rotor]
    return DeltaOracle(
        base_radius=limbs.base_radius * rng.uniform(0.95, 1.05),
        platform_radius=limbs.platform_radius * rng.uniform(0.95, 1.05),
        upper_arm=limbs.upper_arm * rng.uniform(0.98, 1.02),
        strut=limbs.strut * rng.uniform(0.98, 1.02),
        bodies=bodies,
        has_telescope=telescope,
        viscous=p[layout.viscous],
        coulomb=p[layout.coulomb],
        rotor_inertia=rotors,
    )


def record(
    oracle: DeltaOracle, path: Path, rng: np.random.Generator, *, samples: int = 600
) -> np.ndarray:
    """Write a noise-free recording whose torques come from the oracle; returns z along it."""
    kinematics = Dynamics(describe(oracle)).kinematics
    motion = random_motion(kinematics, rng)
    time = np.arange(samples) * (motion.period / samples)
    z, zd, zdd = motion.evaluate(time)
    q, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    tau = oracle.inverse_dynamics(q, qd, qdd)
    columns = {"t": time}
    for name, values in (("q", q), ("qd", qd), ("qdd", qdd), ("tau", tau)):
        columns |= {f"{name}{i + 1}": values[:, i] for i in range(values.shape[1])}
    pl.DataFrame(columns).write_csv(path)
    return z
