"""How often ranges of constraint forces hold the truth, over many recordings.

    pip install .
    python benchmarks/force_ranges.py

Each recording is of another surrogate of the 4-DOF Delta (parameters up to 30 % from the prior, as
in `deltaid demo`), 10 s of a random motion with 2 % torque noise. All forces at a few samples of
another motion are counted: those that torques determine, whose ranges the recording decides, and
all others, whose ranges the prior decides and which hold the truth as often as the prior is right.
"""

from collections.abc import Iterator

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.identification.identify import identify
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.joint_forces.ranges import Ranges, evidence
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

ROBOT, RECORDINGS, SAMPLES, STRUT_SPACING = "irb360-6-1600", 40, 3, 0.12


def main() -> None:
    robot = load_robot(ROBOT)
    assert robot.limbs is not None
    limbs = robot.limbs.changed(strut_spacing=STRUT_SPACING)
    robot = robot.changed(limbs=limbs)
    held: dict[str, list[bool]] = {"forces that torques determine": [], "all others": []}
    for seed in range(RECORDINGS):
        for is_determined, holds in _ranges(robot, np.random.default_rng(seed)):
            held["forces that torques determine" if is_determined else "all others"].append(holds)
    print(f"{ROBOT}, {RECORDINGS} recordings")
    for what, each in held.items():
        share = f"{sum(each)} of {len(each)} ranges hold the truth, {np.mean(each):.1%}"
        print(f"{what}: {share}")


def _ranges(robot: RobotDescription, rng: np.random.Generator) -> Iterator[tuple[bool, bool]]:
    """Of each force of one recording whether torques determine it, and whether its range holds."""
    dynamics = compiled(robot)
    kinematics, truth = dynamics.kinematics, surrogate_parameters(robot, rng)
    recording = simulate_recording(
        dynamics, truth, random_motion(kinematics, rng), rng, duration=10.0, noise=SensorNoise()
    )
    model = identify(robot, recording).model
    found, known = evidence(model, recording)
    motion = random_motion(kinematics, rng)
    z, zd, zdd = motion.evaluate(rng.uniform(0, motion.period, SAMPLES))
    _, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    ranges = Ranges(found, known, model.p)
    for c in ConstraintForces(robot).coefficients(z, qd, qdd).reshape(-1, len(truth)):
        if not np.any(c):
            continue
        interval = ranges.force_range(c)
        holds = interval.low <= c @ truth <= interval.high
        yield not known.openness(c).half_width, bool(holds)


if __name__ == "__main__":
    main()
