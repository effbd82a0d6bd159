"""Damaged files of every kind: one message with place and cure, or a read; no traceback.

`benchmarks/damaged_files.py` does the same with hundreds of files of each kind.
"""

import random
from pathlib import Path

import pytest

from damage import complaint, damaged, outcome
from deltaid.dynamics.dynamics import Dynamics
from kinds_of_files import KINDS, ROWS

COUNT = 6


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(tmp_path: Path, clavel: Dynamics, kind: str) -> None:
    of, path, rng = KINDS[kind], tmp_path / KINDS[kind].name, random.Random(11)
    of.save(path)
    data = path.read_bytes()
    ends = set()
    for _ in range(COUNT):
        path.write_bytes(damaged(data, rng))
        found = outcome(path, of.columns, ROWS, clavel.kinematics)
        assert not complaint(found, path)
        ends.add(found.end)
    assert "refused" in ends
