"""Sweeps of which some cases run always, and the others with --slow."""

from collections.abc import Iterable
from typing import Any

import pytest


def swept(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """All cases for `parametrize`; those that are not among the quick ones are slow."""
    return [x if x in quick else slow(x) for x in cases]


def slow(*values: Any) -> Any:
    """A case of these values that runs with --slow only."""
    return pytest.param(*values, marks=pytest.mark.slow)
