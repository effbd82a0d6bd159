"""What a model does not know, carried to what follows from it: forces in struts, tracking error.

    python examples/monte_carlo.py [FOLDER]

A robot with known truth is recorded and identified twice: as it is, and with a strut and the
platform weighed. Models are drawn from what each of the two knows, and for all of them the force in
a strut and the tracking error of a controller that has the identified model are computed. Files are
written into FOLDER, or into a temporary folder that is removed.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import deltaid

ROBOT, FORCE, SCALE = "clavel-delta3", "strut1.platform.x", 0.0005
# Models for forces, which cost next to nothing, and for simulations, which do.
MODELS, SIMULATED = 400, 4


def main(folder: Path) -> None:
    """Identify, draw, and compare."""
    robot, rng = deltaid.load_robot(ROBOT), np.random.default_rng(1)
    dynamics = deltaid.Dynamics(robot)
    truth = deltaid.surrogate_parameters(robot, rng)
    recorded, used = (deltaid.random_motion(dynamics.kinematics, rng) for _ in range(2))
    log = deltaid.simulate_recording(
        dynamics, truth, recorded, rng, noise=deltaid.SensorNoise(torque=0.01)
    )
    masses = {body: float(truth[dynamics.layout.names.index(f"{body}.m")]) for body in ("S", "P")}
    weighed = robot.changed(
        measured=[
            {"of": body, "mass": mass + SCALE * rng.standard_normal(), "std": SCALE}
            for body, mass in masses.items()
        ]
    )
    for name, description in (("torques alone", robot), ("weighed too", weighed)):
        path = folder / ("model.yaml" if description is robot else "weighed.yaml")
        deltaid.identify(description, log).model.save(path)
        print(f"{name}:")
        of_forces(path, truth, used)
        of_tracking(path, used)


def of_forces(path: Path, truth: np.ndarray, motion: deltaid.FourierMotion) -> None:
    """The largest pull in a strut along a motion, as drawn models have it."""
    model = deltaid.load(path)
    z, zd, zdd = motion.evaluate(np.linspace(0.0, motion.period, 500))
    _, qd, qdd = model.dynamics.kinematics.drive_motion(z, zd, zdd)
    forces = deltaid.ConstraintForces(model.robot)
    k = forces.index(FORCE)
    pulls = [forces.evaluate(z, qd, qdd, p)[:, k].max() for p in model.sample(MODELS).p]
    low, high = np.quantile(pulls, [0.025, 0.975])
    true = forces.evaluate(z, qd, qdd, truth)[:, k].max()
    print(f"  largest pull {FORCE}: {low:.1f} to {high:.1f} N (95 %), in truth {true:.1f} N")


def of_tracking(path: Path, motion: deltaid.FourierMotion) -> None:
    """How far off the platform is where the robot is a drawn model and not the identified one."""
    model = deltaid.load(path)
    how = {"controller": "pd-feedforward", "duration": 1.0}
    errors = [
        deltaid.simulate(model, motion, plant=plant, **how).error.platform_rms
        for plant in model.sample(SIMULATED, seed=1).models()
    ]
    print(f"  tracking error: {1e3 * min(errors):.3f} to {1e3 * max(errors):.3f} mm")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        target = Path(sys.argv[1])
        target.mkdir(parents=True, exist_ok=True)
        main(target)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
