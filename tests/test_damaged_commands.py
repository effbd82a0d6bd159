"""Commands with damaged files: one message with place and cure, and nothing is left behind.

`benchmarks/damaged_files.py` runs 20,000 cases of these lines, and 10,000 changed bits.
"""

import random
from collections import Counter
from pathlib import Path

import pytest

from command import Outcome
from damage import changed_bit
from damaged_commands import LINES, NAMED, Line, judged, lay_out, make_inputs, run_alone, run_line
from deltaid.errors import DeltaidError
from sealed_files import SEALED

# Lines whose good files take no second; and often a log that is filtered, and a model.
OFTEN = ("base robot.yaml log.csv: log.csv", "validate model.yaml full.csv: model.yaml")
QUICK = [line for line in LINES if line.cases >= 500] + 15 * [NAMED[name] for name in OFTEN]


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


@pytest.mark.slow
def test_a_case_ends_as_in_a_process_of_its_own(inputs: Path, tmp_path: Path) -> None:
    """Cases share a process, with all that it has loaded, compiled and kept; so 25 of them that
    have run one after the other run once more, each alone."""
    place, ends = tmp_path / "case", dict[Line, Outcome]()
    lines = [line for line in LINES if not line.text.startswith("studio")]
    for line in random.Random(1).sample(lines, 25):
        lay_out(line, inputs, place, random.Random(line.name))
        ends[line] = run_line(line, place)
    for line, outcome in ends.items():
        lay_out(line, inputs, place, random.Random(line.name))
        assert run_alone(line, place) == outcome, line.name


@pytest.mark.parametrize("kind", ["factor file", "fleet table", "fleet member"])
def test_no_changed_bit_is_read(inputs: Path, tmp_path: Path, kind: str) -> None:
    pattern, read = SEALED[kind]
    (path, *_), rng = sorted(inputs.glob(pattern)), random.Random(kind)
    copy = tmp_path / path.name
    for _ in range(100):
        copy.write_bytes(changed_bit(path.read_bytes(), rng))
        with pytest.raises(DeltaidError, match=r"is damaged|has no checksum"):
            read(copy)
