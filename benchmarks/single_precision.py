"""How far the exported C code in single precision is from the package, towards singularities.

    python benchmarks/single_precision.py [ROBOT …]

Inputs and parameters are floats for both. Poses lie within 2.5 times the workspace's box, on the
home pose's branch; speeds and accelerations are random. Each figure is the largest difference of
all poses and robots, as a share of the largest entry of its pose's result. The last columns are the
same code with every number a single float. Leaves `tables/single_precision.md`.
"""

import tempfile
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import _alone  # noqa: F401
import casadi as ca
import numpy as np
from _table import leave
from _timing import options

from c_library import Library, build
from deltaid.dynamics.parameters import prior_parameters
from deltaid.exports.digits import Care
from deltaid.exports.text import SINGLE
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model
from deltaid.robot.load import load_robot
from exports import CONDITIONS, floats, of_home_branch

ROBOTS = [
    "clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "par4", "i4-linear", "par4-linear",
]  # fmt: skip
EACH, DRAWN = 60, 40_000
NOTE = """Largest difference of exported C code in single precision from the package at the same
floats, as a share of the largest entry of each result, by the condition of the Jacobian; the last
columns with every number a single float. `gcc -O2`."""


def main() -> None:
    worst: dict[str, np.ndarray] = {}
    robots = options(__doc__, robots=ROBOTS).robots
    for name in robots:
        robot = load_robot(name)
        model = Model(robot, floats(prior_parameters(robot)), name)
        z, condition = poses(model)
        wanted = expected(model, z)
        for k in (0, 1):
            found = single(model, z, wanted, plain=k == 1)
            for function, values in found.items():
                off = np.abs(values - wanted[function]).reshape(len(z), -1).max(axis=1)
                off = off / np.abs(wanted[function]).reshape(len(z), -1).max(axis=1)
                row = worst.setdefault(function, np.zeros((2, len(CONDITIONS))))
                for i, (low, high) in enumerate(CONDITIONS):
                    chosen = off[(low <= condition) & (condition < high)]
                    row[k, i] = max(row[k, i], np.nan_to_num(chosen, nan=np.inf).max(initial=0))
    head = [f"{plain}{low} to {high}" for plain in ("", "plain, ") for low, high in CONDITIONS]
    rows = [(name, *(f"{x:.0e}" for x in row.ravel())) for name, row in worst.items()]
    leave(("condition", *head), rows, NOTE, robots=len(robots))


def poses(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Poses of every condition that Python finds from their drives' coordinates as floats."""
    kinematics, (z, condition) = model.dynamics.kinematics, of_home_branch(model, DRAWN)
    kept = [np.flatnonzero((low <= condition) & (condition < high))[:EACH]
            for low, high in CONDITIONS]  # fmt: skip
    chosen = np.concatenate(kept)
    z, condition = z[chosen], condition[chosen]
    again = [kinematics.forward_unchecked(row[None]) for row in floats(kinematics.inverse(z))]
    same = [bool(good[0]) and np.abs(a[0] - row).max() < 1e-3 for (a, good), row in
            zip(again, z, strict=True)]  # fmt: skip
    return z[same], condition[same]


def expected(model: Model, z: np.ndarray) -> dict[str, np.ndarray]:
    """The package's results and, under names with an underscore before, what they are of."""
    rng, dynamics = np.random.default_rng(1), model.dynamics
    qd, qdd = floats(2 * rng.standard_normal(z.shape)), floats(10 * rng.standard_normal(z.shape))
    p, kinematics = model.p, dynamics.kinematics
    q = floats(kinematics.inverse(z))
    exact = np.vstack([kinematics.forward(row[None]) for row in q])
    tau = floats(dynamics.torque(z, qd, qdd, p))
    bias = dynamics.torque(z, qd, 0 * qdd, p)
    e = dynamics.equations
    mass = ca.Function("M", [e.z, e.p], [e.M])
    M = np.array([np.asarray(mass(row, p)) for row in z])
    return {
        "_z": z, "_q": q, "_qd": qd, "_qdd": qdd, "_tau": tau,
        "inverse_kinematics": kinematics.inverse(z),
        "forward_kinematics": exact,
        "jacobian": kinematics.jacobian(z),
        "mass_matrix": M,
        "gravity": dynamics.torque(z, 0 * qd, 0 * qdd, p),
        "bias": bias,
        "inverse_dynamics_at": dynamics.torque(z, qd, qdd, p),
        "inverse_dynamics": dynamics.torque(exact, qd, qdd, p),
        "forward_dynamics": np.linalg.solve(M, (tau - bias)[..., None])[..., 0],
        "constraint_forces": ConstraintForces(model.robot).evaluate(z, qd, qdd, p),
    }  # fmt: skip


GIVEN = {
    "inverse_kinematics": "_z", "jacobian": "_z", "mass_matrix": "_z", "gravity": "_z",
    "bias": "_z _qd", "inverse_dynamics_at": "_z _qd _qdd", "forward_dynamics": "_z _qd _tau",
    "forward_kinematics": "_q", "inverse_dynamics": "_q _qd _qdd",
    "constraint_forces": "_z _qd _qdd",
}  # fmt: skip


def single(
    model: Model, z: np.ndarray, wanted: dict[str, np.ndarray], *, plain: bool
) -> dict[str, np.ndarray]:
    none = patch.object(Care, "pairs", lambda *_: frozenset[int]()) if plain else nullcontext()
    with tempfile.TemporaryDirectory() as folder:
        with none:
            further = ("constraint-forces",)
            library = build(model, Path(folder), "-O2", precision=SINGLE, further=further)
        return {name: called(library, name, z, wanted) for name in GIVEN}


def called(library: Library, name: str, z: np.ndarray, wanted: dict[str, np.ndarray]) -> np.ndarray:
    """A function at every pose; NaN where it fails. Poses that are searched start near theirs."""
    results, near = np.full(wanted[name].shape, np.nan), z + 2e-3
    for i in range(len(z)):
        given = [wanted[x][i] for x in GIVEN[name].split()]
        out = near[i].copy() if name == "forward_kinematics" else results[i].ravel()
        outs = (near[i].copy(), out) if name == "inverse_dynamics" else (out,)
        if not library.fill(name, *given, outs=outs):
            results[i] = out.reshape(results[i].shape)
    return results


if __name__ == "__main__":
    main()
