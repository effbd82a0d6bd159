"""Recordings whose torques are sampled in another way, identified: named and corrected."""

import numpy as np
import pytest

from drives import case
from drives.identify import identified
from drives.judge import judge


@pytest.mark.parametrize(
    ("row", "kind", "value", "within"),
    [
        ("filter-5ms", "filter", 5e-3, 3e-4),
        ("hold-2ms", "hold", 2e-3, 1e-9),
        ("noisy-hold", "hold", 2e-3, 1e-9),
        ("clocks", "clock", 500.0, 25.0),
        ("late-gear", "lag", 3e-3, 1e-4),
    ],
)
def test_its_cause_is_named_and_the_model_is_right(
    row: str, kind: str, value: float, within: float
) -> None:
    made = case(row, "delta3", 0)
    result = identified(made)
    errors = judge(made, result)
    assert errors.M < 3e-3
    assert errors.friction < 1e-2
    found = [
        abs(correction.value or 0.0)
        for correction in result.model.corrections
        if correction.kind == kind
    ]
    assert found
    np.testing.assert_allclose(found, value, atol=within)


def test_late_torques_are_no_filter() -> None:
    kinds = [
        correction.kind for correction in identified(case("lag", "delta3", 0)).model.corrections
    ]
    assert set(kinds) == {"lag"}
