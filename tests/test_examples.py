"""The examples run, write only where they are told to, and find what they simulate."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deltaid import IdentifiedModel, use_mechanism

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
PAGES = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
# Those that a page runs are run there, with what they print (sessions.py).
ON_PAGES = set(re.findall(r"\$ python examples/(\w+\.py)", PAGES))
# Those in programs of other people: test_export_drake.py, test_jax.py.
ELSEWHERE = {"in_drake.py", "in_jax.py"}
SCRIPTS = [
    path for path in sorted(EXAMPLES.glob("*.py")) if path.name not in {*ON_PAGES, *ELSEWHERE}
]


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_example_runs_in_a_folder(script: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in EXAMPLES.iterdir()}
    here, target = tmp_path / "here", tmp_path / "target"
    here.mkdir()
    done = subprocess.run(
        [sys.executable, script, target],
        cwd=here,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONIOENCODING": "utf-8"},
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    assert not list(here.iterdir())
    assert {path: path.stat().st_mtime_ns for path in EXAMPLES.iterdir()} == before
    if script.name == "own_mechanism.py":
        use_mechanism(EXAMPLES / "heli4" / "mechanism.py")
    model = IdentifiedModel.load(target / "model.yaml")
    assert model.consistent
    assert max(model.fit.nrmse) < 0.02
