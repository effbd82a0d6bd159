"""Whether the reported 95 % intervals contain the truth as often as they say: some seeds of noise.

Over 200 of them: `python benchmarks/coverage_of_intervals.py`.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from interval_coverage import ROBOTS, covered, covered_by_white_formula, estimates, wandering

SEEDS = 100


@pytest.mark.parametrize("name", ROBOTS)
def test_intervals_cover_as_often_as_they_say(name: str, tmp_path: Path) -> None:
    share = covered(*estimates(name, "white", SEEDS, tmp_path, wandering))
    # One parameter in all seeds: a chance of 1e-4 lies beyond this bound at 93 %.
    low = binom.ppf(1e-4, SEEDS, 0.93) / SEEDS
    assert 0.92 <= share.mean() <= 0.975
    assert np.all(share >= low), share


@pytest.mark.parametrize(("kind", "oftener"), [("coloured", 2.4), ("ripple", 4.0)])
def test_noise_that_is_not_white_is_noticed(kind: str, oftener: float, tmp_path: Path) -> None:
    """The formula for white noise misses the truth so many times as often; without the scatter
    between spans of time it would be twice as often of coloured noise."""
    truth, found = estimates(ROBOTS[0], kind, SEEDS, tmp_path, wandering)
    share, white = covered(truth, found), covered_by_white_formula(truth, found)
    assert 0.92 <= share.mean() <= 0.975
    assert np.all(share >= 0.8), share
    assert 1 - white.mean() > oftener * (1 - share.mean())
