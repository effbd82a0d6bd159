"""Commands with damaged files: one message with place and cure, and nothing is left behind.

`benchmarks/damaged_files.py` runs 20,000 cases of these lines, and 10,000 changed bits.
"""

import random
from collections import Counter
from pathlib import Path

import pytest

from damage import changed_bit
from damaged_commands import LINES, judged, make_inputs
from deltaid.errors import DeltaidError
from sealed_files import SEALED

# Lines whose good files take no second.
QUICK = [line for line in LINES if line.cases >= 500]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_inputs(tmp_path_factory.mktemp("inputs") / "good")


def test_damaged_files_in_command_lines(inputs: Path, tmp_path: Path) -> None:
    ends = Counter[str]()
    for i, line in enumerate(QUICK):
        ended = judged(line, inputs, tmp_path / "case", random.Random(i))
        assert not ended.why, f"{line.name}: {ended.why}"
        ends[ended.end] += 1
    assert ends["refused"] > len(QUICK) / 2


@pytest.mark.parametrize("kind", ["factor file", "fleet table", "fleet member"])
def test_no_changed_bit_is_read(inputs: Path, tmp_path: Path, kind: str) -> None:
    pattern, read = SEALED[kind]
    (path, *_), rng = sorted(inputs.glob(pattern)), random.Random(kind)
    copy = tmp_path / path.name
    for _ in range(100):
        copy.write_bytes(changed_bit(path.read_bytes(), rng))
        with pytest.raises(DeltaidError, match=r"is damaged|has no checksum"):
            read(copy)
