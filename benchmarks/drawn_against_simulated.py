"""Whether drawn recordings of `drawn_fleet.py` say what simulated ones do: base parameters of both.

python benchmarks/drawn_against_simulated.py [RECORDINGS]
"""

import sys
from collections.abc import Sequence

import numpy as np
from _drawn_templates import SETTINGS, simulated
from _table import STATED, leave
from drawn_fleet import NOISE, drawn_type

from deltaid.dynamics.parameters import prior_parameters
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.gather import gathered
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from plants import made_alike


def _compared(name: str, count: int) -> tuple[object, ...]:
    """Recordings of one robot, simulated and drawn on the same motions: what fits to each say."""
    robot = load_robot(name)
    kind = drawn_type(robot, motions=2)
    truth = made_alike(robot, prior_parameters(robot), np.random.default_rng(5))
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"simulated": [], "drawn": []}
    for k in range(count):
        drawn = [kind.drawn("a", k, truth, wander=0.0)]
        found["drawn"].append(_estimate(robot, drawn, truth))
        table = simulated(kind.dynamics, truth, k % 2, NOISE, 1000 + k)
        file = gathered(robot, table, settings=SETTINGS)
        found["simulated"].append(_estimate(robot, [file], truth))
    row: list[object] = [name, count]
    for picks in found.values():
        errors, halves = (np.array(x) for x in zip(*picks, strict=True))
        row += [f"{np.median(np.abs(errors) / halves):.2f}"]
        row += [f"{np.mean(np.abs(errors) <= halves):.1%}"]
    halves = {kind: np.array([s for _, s in picks]) for kind, picks in found.items()}
    ratio = np.exp(np.mean(np.log(halves["drawn"])) - np.mean(np.log(halves["simulated"])))
    return (*row, f"{ratio:.2f}")


def _estimate(
    robot: RobotDescription, files: Sequence[FactorFile], truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of base parameters and half their 95 % intervals."""
    problem = identify_gathered(robot, files, SETTINGS).problem
    estimate = problem.estimate
    return estimate.values - problem.base.combination() @ truth, estimate.interval


def main() -> None:
    stated = STATED["drawn_against_simulated"]["recordings"]
    count = int(sys.argv[1]) if len(sys.argv) > 1 else stated
    rows = [_compared(name, count) for name in ("clavel-delta3", "irb360-6-1600")]
    head = ("robot", "recordings", "simulated: median error / interval", "interval holds it",
            "drawn: median error / interval", "interval holds it", "drawn / simulated")  # fmt: skip
    note = (
        "Base parameters from recordings of 12 s that were simulated, and from drawn ones: errors "
        "as shares of half their 95 % intervals, and intervals against each other (geometric mean)."
    )
    leave(head, rows, note, recordings=count)


if __name__ == "__main__":
    main()
