"""Damaged files of every kind: one message with place and cure, or a read; no traceback.

`benchmarks/damaged_files.py` does the same with hundreds of files of each kind.
"""

import random
from pathlib import Path

import numpy as np
import pytest

from damage import complaint, damaged, outcome
from deltaid.dynamics.dynamics import Dynamics
from deltaid.recording.formats.mat5 import DamagedMatError, Numbers
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


def test_an_array_of_a_mat_file_that_ends_behind_its_variable_is_refused() -> None:
    data = memoryview(np.arange(6.0).tobytes())
    np.testing.assert_array_equal(Numbers(8, "<f8", (5,)).array(data), np.arange(1.0, 6.0))
    with pytest.raises(DamagedMatError, match="6 numbers ends behind the end of its variable"):
        Numbers(8, "<f8", (6,)).array(data)
