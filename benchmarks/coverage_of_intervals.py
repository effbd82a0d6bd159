"""How often 95 % intervals hold the truth, over many seeds.

    pip install -e '.[test,benchmark]'
    python benchmarks/coverage_of_intervals.py [SEEDS]
    python benchmarks/coverage_of_intervals.py --priors [SEEDS]

Base parameters by kinds of noise leave `tables/coverage_of_intervals.md`. With `--priors`:
parameters of bodies of random robots, described well and badly, by what decided them, which leaves
`tables/coverage_of_labels.md`: so far of 12 robots a row, where 20 are stated. The tests run some
seeds of both (`tests/test_scatter.py`, `tests/test_labels.py`).
"""

import sys
from collections import Counter

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.robot.load import load_robot
from interval_coverage import KINDS, RATE, ROBOTS, covered, covered_by_white_formula, estimates
from poor_priors import PLAIN, outcome

HEAD = ("robot", "noise", "seeds", "mean", "worst parameter", "by the formula for white noise")
KINDS_OF_ROBOTS = ("clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "i4", "par4")
# Priors are the question, not laws of friction; gears may wind up as `identify` has it.
SETTINGS = PLAIN.changed(compliance="estimate")
LABELS = ("data", "sum", "limit", "prior")
LABELS_HEAD = (
    "robot", "priors", "robots", *(f"hold: {label}" for label in LABELS), "M, 90 %", "M, worst",
    "with a prior widened",
)  # fmt: skip


def main() -> None:
    counts = [int(each) for each in sys.argv[1:] if each != "--priors"]
    if "--priors" in sys.argv:
        _labels(*counts or [STATED["coverage_of_labels"]["robots"]])
    else:
        _intervals(*counts or [STATED["coverage_of_intervals"]["seeds"]])


def _intervals(seeds: int) -> None:
    rows = []
    for name in ROBOTS:
        for kind in KINDS:
            truth, found = estimates(name, kind, seeds)
            share, white = covered(truth, found), covered_by_white_formula(truth, found)
            figures = (share.mean(), share.min(), white.mean())
            rows.append((name, kind, seeds, *(f"{figure:.1%}" for figure in figures)))
    note = "Share of 95 % intervals of base parameters that hold the truth, mean over parameters."
    leave(HEAD, rows, note, seeds=seeds)


def _labels(seeds: int) -> None:
    rows = []
    for name in KINDS_OF_ROBOTS:
        robot = load_robot(name)
        run = Exciter(compiled(robot), ExcitationSettings(starts=1, rate=RATE)).optimise().run
        for poor in (False, True):
            hold, every, errors, widened = Counter[str](), Counter[str](), [], 0
            for seed in range(seeds):
                result = outcome(
                    robot, run, seed, poor=poor, duration=run.duration, rate=RATE, settings=SETTINGS
                )
                held, counted = result.held()
                hold, every = hold + held, every + counted
                errors.append(result.mass_error)
                corrections = getattr(result.found.model, "corrections", ())
                widened += any(each.kind == "prior" for each in corrections)
            shares = (
                f"{hold[label]}/{every[label]} = {hold[label] / every[label]:.0%}"
                if every[label]
                else "–"
                for label in LABELS
            )
            mass = f"{np.quantile(errors, 0.9):.2%}", f"{max(errors):.2%}"
            priors = "2 to 20 times off" if poor else "within twice"
            rows.append((name, priors, seeds, *shares, *mass, f"{widened / seeds:.0%}"))
            print(*rows[-1], flush=True)
    note = (
        "Share of 95 % intervals of parameters of bodies that hold the truth, by what decided "
        "them, and errors of M; random bodies, optimised motions, 2 % torque noise."
    )
    leave(LABELS_HEAD, rows, note, name="coverage_of_labels", robots=seeds)


if __name__ == "__main__":
    main()
