"""Whether optimised motions keep all limits between the points that they were optimised on.

    pip install .
    python benchmarks/limits_held.py [SEEDS]

Two studies: one start of every seed at a robot's own limits, on a grid ten times finer; and
Clavel's Delta with random limits, over the whole run from rest to rest. Leaves
`tables/limits_held.md`; the tests run a few of either (`tests/test_excitation.py`).
"""

import sys

import numpy as np
from _table import STATED, leave

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.excitation.optimize import largest_use, optimise
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

ROBOTS = ("irb360-6-1600", "clavel-delta3")
HEAD = ("robot", "limits", "motions", "largest use of a limit", "motions beyond a limit")


def main() -> None:
    rows = []
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else STATED["limits_held"]["motions"]
    for name in ROBOTS:
        problem = Exciter(compiled(load_robot(name)), ExcitationSettings()).problem
        optima = [optimise(problem, range(seed, seed + 1)).x for seed in range(seeds)]
        use = [largest_use(problem, x, 10 * problem.samples).max() for x in optima]
        rows.append(_row(name, "its own", use))
    rows.append(_row(ROBOTS[1], "random", [_random_limits(seed) for seed in range(seeds)]))
    note = "Use of limits between the points that motions were optimised on."
    leave(HEAD, rows, note, motions=seeds)


def _row(name: str, limits: str, use: list[float]) -> tuple[object, ...]:
    beyond = sum(share > 1 for share in use)
    return name, limits, len(use), f"{max(use):.2%}", beyond


def _random_limits(seed: int) -> float:
    """Largest use of a limit by a run within limits of that seed."""
    rng = np.random.default_rng(seed)
    data = load_robot(ROBOTS[1]).model_dump(mode="json")
    torque = rng.uniform(40, 200)
    data |= {
        "workspace": {"shape": "cylinder", "radius": rng.uniform(0.1, 0.5), "z": [-1.1, -0.85]},
        "platform_speed": rng.uniform(0.5, 5),
        "platform_acceleration": rng.uniform(5, 60),
        "strut_swing_deg": rng.uniform(15, 60),
        "drive_limits": {f"drive{i}": {"torque": torque} for i in (1, 2, 3)},
    }
    robot = RobotDescription.model_validate(data)
    result = Exciter(compiled(robot), ExcitationSettings(starts=1)).optimise()
    return max(limit.share for limit in result.limits)


if __name__ == "__main__":
    main()
