"""How often 95 % intervals of base parameters hold the truth, over many seeds of noise.

    pip install -e '.[test,benchmark]'
    python benchmarks/coverage_of_intervals.py [SEEDS]

Leaves `tables/coverage_of_intervals.md`. The tests run some seeds of it (`tests/test_coverage.py`).
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from _table import leave

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from interval_coverage import KINDS, ROBOTS, covered, covered_by_white_formula, estimates

HEAD = ("robot", "noise", "seeds", "mean", "worst parameter", "by the formula for white noise")


def main() -> int:
    """Count, print, and write the table."""
    seeds, rows = int(sys.argv[1]) if len(sys.argv) > 1 else 200, []
    for name in ROBOTS:
        for kind in KINDS:
            with TemporaryDirectory() as folder:
                truth, found = estimates(name, kind, seeds, Path(folder))
            share, white = covered(truth, found), covered_by_white_formula(truth, found)
            figures = (share.mean(), share.min(), white.mean())
            rows.append((name, kind, seeds, *(f"{figure:.1%}" for figure in figures)))
    note = "Share of 95 % intervals of base parameters that hold the truth, mean over parameters."
    leave(HEAD, rows, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
