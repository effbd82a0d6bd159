"""What masks cost a clean recording: widths of intervals and errors of M, with and without them.

    pip install -e '.[test]'
    python benchmarks/masks.py [SEEDS]

Each recording is identified twice, as usual and with all rows kept. Leaves `tables/masks.md`. The
tests run some seeds of it (`tests/test_mask_results.py`).
"""

import sys
from collections.abc import Sequence

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave

from interrupted import Cost, cost_of_masks

ROBOTS = ("clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "par4")
RATES = (200.0, 1000.0, 4000.0)
HEAD = (
    "robot", "rate [Hz]", "rows excluded", "known less", "at most", "width", "widest seed",
    "M, all rows", "M, masked",
)  # fmt: skip
NOTE = """\
8 s of random motion, torque noise of 2 % of the largest torque, encoders of 12 to 20 bits with a
gear of 10 or none, a combination a seed. *Known less*: by how much standard deviations of the base
parameters would grow for noise of one and the same level, because of the excluded rows, in
the geometric mean and for the worst parameter of all seeds. *Width*: of the 95 % intervals that
data decides, masked over all rows: median over the parameters, geometric mean over the seeds; and
the seed where it is largest. Intervals come from the scatter between some 30 stretches or places,
which has chance in it, 15 to 20 % each. Where the widest seed is over 1.02, the two scatter nearly
alike: stretches a little more with all rows, places with masks. *M*: largest error along the
motion, geometric mean."""


def mean(ratios: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(ratios))))


def row(name: str, rate: str, costs: Sequence[Cost]) -> tuple[str, ...]:
    widths = [float(np.median(cost.widths)) for cost in costs]
    return (
        name,
        rate,
        f"{np.mean([cost.lost for cost in costs]):.2%}",
        f"{mean([mean(cost.known_less) for cost in costs]) - 1:.1%}",
        f"{max(float(cost.known_less.max()) for cost in costs) - 1:.1%}",
        f"{mean(widths):.3f}",
        f"{max(widths):.3f}",
        f"{mean([cost.errors[0] for cost in costs]):.2%}",
        f"{mean([cost.errors[1] for cost in costs]):.2%}",
    )


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else STATED["masks"]["seeds"]
    rows, everything = list[tuple[str, ...]](), list[Cost]()
    for rate in RATES:
        for name in ROBOTS:
            costs = [cost_of_masks(name, rate, seed) for seed in range(seeds)]
            rows.append(row(name, f"{rate:g}", costs))
            everything += costs
    rows.append(row("all", "", everything))
    leave(HEAD, rows, NOTE, seeds=seeds)


if __name__ == "__main__":
    main()
