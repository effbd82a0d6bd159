"""The whole way for a machine that is not in the catalogue: excite, record, identify, verify.

Its geometry is a Python function (heli4/mechanism.py), all else a description (heli4/robot.yaml).
The recordings are simulated; with a machine, run the motion files on it and log positions and
torques.

    python own_mechanism.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import deltaid

HERE = Path(__file__).resolve().parent / "heli4"


def main(folder: Path) -> None:
    """Do all of it; files go to `folder`."""
    deltaid.use_mechanism(HERE / "mechanism.py")
    robot = deltaid.load_robot(HERE / "robot.yaml")
    dynamics, rng = deltaid.Dynamics(robot), np.random.default_rng(0)

    exciter = deltaid.Exciter(dynamics, deltaid.ExcitationSettings(duration=10.0, starts=2))
    motions = {"identify": exciter.optimise(), "verify": exciter.optimise(offset=100)}

    truth = deltaid.surrogate_parameters(robot, rng)  # in place of the machine
    for name, motion in motions.items():
        motion.save(folder / f"{name}-motion.csv")
        run, noise = motion.run, deltaid.SensorNoise(torque=0.02)
        recording = deltaid.simulate_recording(
            dynamics, truth, run, rng, duration=run.duration, noise=noise
        )
        recording.write_csv(folder / f"{name}.csv")

    result = deltaid.identify(robot, [folder / "identify.csv"])
    result.model.save(folder / "model.yaml")
    error, _ = deltaid.validate(result.model, folder / "verify.csv")
    print("torque error of the drives:", ", ".join(f"{100 * e:.2g} %" for e in error.nrmse))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        target = Path(sys.argv[1])
        target.mkdir(parents=True, exist_ok=True)
        main(target)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
