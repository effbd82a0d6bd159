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


@pytest.mark.parametrize(
    ("rank", "bends", "noise", "first"),
    [
        (1, False, 1.0, "force"),  # of as few columns
        (2, False, 1.0, "zero"),
        (2, False, 0.1, "force"),  # leaves much less
        (2, True, 0.1, "zero"),
    ],
)
def test_a_zero_goes_before_what_explains_little_more(
    rank: int, bends: bool, noise: float, first: str
) -> None:
    rng = np.random.default_rng(1)
    Q, _ = np.linalg.qr(rng.standard_normal((ROWS, 4)))
    white = noise * rng.standard_normal(ROWS)
    residual = 30 * Q[:, 1] + white - Q @ (Q.T @ white)
    zero = np.sqrt([0.95, 0.05]) @ Q[:, [1, 3]].T
    candidates = [
        Candidate("force", "", Q[:, 1 : 1 + rank], bends=bends),
        Candidate("zero", "", zero[:, None], is_preferred=True, bends=True),
    ]
    span = Span(Q[:, :1], np.ones((1, 1)))
    detected = account(candidates, lambda _: (), np.arange(ROWS) // 25, span, residual).found
    assert detected[0].candidate.kind == first
