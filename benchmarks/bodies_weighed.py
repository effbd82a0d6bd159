"""How well intervals of single bodies hold with scales, a base plate and strut gauges.

    pip install -e '.[test,benchmark]'
    python benchmarks/bodies_weighed.py [SEEDS]

Robots are drawn from their own prior (spread 0.2, consistent), and recorded with 1 % torque noise;
each leaves `tables/bodies_weighed.md`: predicted standard deviations over the scatter of errors,
and the share of 95 % intervals that hold, of all entries that data or measured values decide. The
tests run some seeds (`tests/test_sensors_in_fit.py`, `tests/test_weighings.py`).
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from _table import leave

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from deltaid.parallel import cores
from sensed import CASES, drawn, identified, sensed

SPREAD = 0.2
ROBOTS = ("clavel-delta3", "irb360-6-1600")
HEAD = (
    "robot",
    "with",
    "seeds",
    "entries",
    "std over scatter, rms",
    "least",
    "largest",
    "held",
    "worst entry",
)
# Entries that data decides in fewer of the robots than this are left out.
_MOSTLY = 0.9


def one(name: str, case: str, seed: int) -> tuple[np.ndarray, ...]:
    """Errors, standard deviations, whether intervals hold, and whether data decides, by entry."""
    rng, of = np.random.default_rng(1000 + seed), sensed(name, case, SPREAD)
    p = drawn(of.reduction, SPREAD, rng)
    _, found = identified(name, of, p, SPREAD, rng)
    return (
        np.array([each.value for each in found]) - p,
        np.array([each.std for each in found]),
        np.array([each.low <= x <= each.high for each, x in zip(found, p, strict=True)]),
        np.array([each.determined_by in ("data", "measured") for each in found]),
    )


def row(name: str, case: str, seeds: int, pool: ProcessPoolExecutor) -> tuple[object, ...]:
    """One row of the table."""
    results = list(pool.map(one, [name] * seeds, [case] * seeds, range(seeds)))
    errors, stds, held, decided = map(np.array, zip(*results, strict=True))
    some = decided.mean(axis=0) >= _MOSTLY
    scatter = np.sqrt(np.mean(errors[:, some] ** 2, axis=0))
    ratio = np.sqrt(np.mean(stds[:, some] ** 2, axis=0)) / scatter
    share = held[:, some].mean(axis=0)
    return (
        name,
        case,
        seeds,
        int(some.sum()),
        f"{np.sqrt(np.mean(ratio**2)):.3f}",
        f"{ratio.min():.2f}",
        f"{ratio.max():.2f}",
        f"{share.mean():.1%}",
        f"{share.min():.0%}",
    )


def main() -> int:
    """Count, print, and write a table."""
    seeds = int(sys.argv[1]) if sys.argv[1:] else 100
    with ProcessPoolExecutor(cores()) as pool:
        rows = [row(name, case, seeds, pool) for name in ROBOTS for case in CASES]
    leave(HEAD, rows, "Robots drawn from their priors; entries that data or a scale decides.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
