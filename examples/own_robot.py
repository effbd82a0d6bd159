"""The tutorial in Python: a robot of one's own, its log in degrees, rpm and ampere, its model.

    python examples/own_robot.py [FOLDER]

There is no machine here, so the script makes one: bodies and friction that differ from what
robot.yaml believes, moved along two random motions, and logged as drives log. From there on it does
what you would do. Everything is written into FOLDER, or into a temporary folder that is removed.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

import deltaid

HERE = Path(__file__).parent
GEAR, TORQUE_CONSTANT = 10, 0.12  # as in columns.yaml
ZERO_DEG = np.array([0.0, 1.5, 0.0])


def main(folder: Path) -> None:
    """Run all steps of the tutorial in a folder."""
    for name in ("robot.yaml", "columns.yaml"):
        shutil.copyfile(HERE / name, folder / name)
    robot = deltaid.load_robot(folder / "robot.yaml")
    dynamics = deltaid.Dynamics(robot)
    rng = np.random.default_rng(0)
    truth = make_truth(dynamics, rng)
    for name in ("identify", "verify"):
        record(dynamics, truth, rng, folder / f"{name}.csv")

    base = deltaid.base(robot)
    print(f"{base.rank} combinations of {len(dynamics.layout.names)} parameters show in torques")

    columns = deltaid.load_mapping(folder / "columns.yaml")
    result = deltaid.identify(robot, [folder / "identify.csv"], columns=columns)
    model = result.model
    for parameter in model.parameters:
        if parameter.determined_by == "data":
            print(
                f"{parameter.name:15} {parameter.value:9.5f} ± {parameter.std:.5f} {parameter.unit}"
            )
    print("not from the data:", *(p.name for p in model.parameters if p.determined_by == "prior"))
    model.save(folder / "model.yaml")

    error, _ = deltaid.validate(model, folder / "verify.csv", columns=columns)
    print("torque error on another motion, share of the torque:", error.nrmse.round(4))

    model = deltaid.IdentifiedModel.load(folder / "model.yaml")
    q, still = np.zeros((1, dynamics.dof)), np.zeros((1, dynamics.dof))
    print("torque that holds the arms level:", dynamics.inverse_dynamics(q, still, still, model.p))
    print("mass matrix there:", dynamics.mass_matrix(q, model.p)[0].round(5), sep="\n")
    off = dynamics.mass_matrix(q, model.p) / dynamics.mass_matrix(q, truth) - 1
    print(f"its diagonal is within {abs(np.diag(off[0])).max():.1%} of the truth, but")
    for name in ("P.m", "S.m"):
        true_value = truth[dynamics.layout.names.index(name)]
        print(f"{name} is {model.value(name):.4f} and in truth {true_value:.4f} kg")


def make_truth(dynamics: deltaid.Dynamics, rng: np.random.Generator) -> np.ndarray:
    """Parameters that nobody knows: bodies up to 30 % off the prior, friction of its own."""
    truth, layout = deltaid.surrogate_parameters(dynamics.robot, rng), dynamics.layout
    truth[layout.viscous] = [0.26, 0.24, 0.30]
    truth[layout.coulomb] = [1.4, 1.2, 1.5]
    return truth


def record(
    dynamics: deltaid.Dynamics, truth: np.ndarray, rng: np.random.Generator, path: Path
) -> None:
    """Write a log as columns.yaml declares it: joint angles up, motor speeds, motor currents."""
    motion = deltaid.random_motion(dynamics.kinematics, rng, period=5.0, harmonics=10)
    ideal = deltaid.simulate_recording(dynamics, truth, motion, rng, duration=20.0)
    q, qd, tau = (ideal.select(f"{name}{i}" for i in (1, 2, 3)).to_numpy() for name in
                  ("q", "qd", "tau"))  # fmt: skip
    noise = 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    angle = np.round((ZERO_DEG - np.rad2deg(q)) * 2**17 / 360) * 360 / 2**17
    speed = np.round(-qd * GEAR * 60 / (2 * np.pi), 1)
    current = np.round(-(tau + noise) / (GEAR * TORQUE_CONSTANT), 3)
    columns = {"time_ms": 1000 * ideal["t"].to_numpy()}
    for name, values in (("angle", angle), ("speed", speed), ("current", current)):
        columns |= {f"{name}{i + 1}": values[:, i] for i in range(3)}
    pl.DataFrame(columns).write_csv(path)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        target = Path(sys.argv[1])
        target.mkdir(parents=True, exist_ok=True)
        main(target)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
