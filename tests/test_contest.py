"""Which patterns a residual is said to have."""

import numpy as np
import pytest

from deltaid.effects.contest import account
from deltaid.effects.rigid_fit import Candidate
from deltaid.estimation.span import Span

ROWS = 1000


@pytest.mark.parametrize(("second", "found"), [(4.0, "one"), (12.0, "four")])
def test_of_two_patterns_that_explain_nearly_the_same_the_one_of_fewer_columns(
    second: float, found: str
) -> None:
    rng = np.random.default_rng(0)
    Q, _ = np.linalg.qr(rng.standard_normal((ROWS, 5)))
    span = Span(Q[:, :1], np.ones((1, 1)))
    noise = rng.standard_normal(ROWS)
    noise -= Q @ (Q.T @ noise)
    left = 30 * Q[:, 1] + second * Q[:, 2] + noise
    patterns = [Candidate("four", "", Q[:, 1:]), Candidate("one", "", Q[:, 1:2])]
    first = account(patterns, lambda _: (), np.arange(ROWS) // 25, span, left).found[0]
    assert first.candidate.kind == found
