"""The study of rounding in `benchmarks/`: what it changes of a recording, and what it counts."""

import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from same_answer import changed, differences, half_width

SHARE = 1e-12


def test_measured_numbers_change_by_a_share_and_what_is_equal_stays_so() -> None:
    x = np.random.default_rng(0).standard_normal(400)
    log = pl.DataFrame({"q": np.repeat(x, 2), "gripper": np.tile([0.0, 1.0], 400)})
    found = changed(log, SHARE)
    moved = found["q"].to_numpy() / log["q"].to_numpy() - 1
    np.testing.assert_allclose(np.abs(moved), SHARE, rtol=1e-3)
    assert 0.4 < np.mean(moved > 0) < 0.6
    np.testing.assert_array_equal(found["q"][::2], found["q"][1::2])
    assert found["gripper"].equals(log["gripper"])


def test_decisions_of_one_of_both_count_and_values_in_half_widths() -> None:
    first = {"decisions": ["lag", "law"], "values": {"a": (1.0, 0.5), "b": (0.0, 2.0), "c": (0, 1)}}
    second = {"decisions": ["law", "gain"], "values": {"a": (1.2, 9.0), "b": (-1.0, 2.0)}}
    decisions, change = differences(first, second)
    assert decisions == ["gain", "lag"]
    assert change == pytest.approx(0.5)
    assert half_width(1.0, 4.0) == 1.5
