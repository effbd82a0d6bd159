"""Of many samples a figure draws those that matter."""

import numpy as np
import pytest

from deltaid.view.comparison import even_rows, extreme_rows, peak_rows

MOST = 1000


@pytest.mark.parametrize("samples", [0, 1, 999, 1000, 1001, 123_457])
@pytest.mark.parametrize("last", [False, True])
def test_a_spike_is_drawn_wherever_it_stands(samples: int, last: bool) -> None:
    values = np.random.default_rng(0).normal(size=samples)
    values[::7] = np.nan
    spike = samples - 1 if last else samples // 3
    values[spike : spike + 1] = -50.0
    peaks, ends = peak_rows(np.abs(values), MOST), extreme_rows(values, 100)
    assert len(peaks) <= MOST
    assert len(ends) == 2 * -(-samples // 100)
    assert (spike in peaks) == (spike in ends) == bool(samples)
    assert np.all(np.diff(peaks) > 0)
    assert np.all(np.diff(ends) >= 0)
    assert len(values[even_rows(samples, MOST)]) <= MOST


def test_a_hole_stays_a_hole_and_hides_nothing() -> None:
    values = np.array([np.nan, np.nan, np.nan, 3.0, np.nan, -1.0])
    np.testing.assert_array_equal(values[extreme_rows(values, 2)], [np.nan, np.nan, 3, 3, -1, -1])
    np.testing.assert_array_equal(values[peak_rows(np.abs(values), 3)], [np.nan, 3.0, -1.0])
