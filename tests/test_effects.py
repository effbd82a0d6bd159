"""Effects are taken from one list: what is not in it is missed, and nothing else is."""

import importlib
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import deltaid
from deltaid.effects.all import EFFECTS
from deltaid.effects.effect import DescribedEffect, Effect

PACKAGE = Path(deltaid.__file__).parent
# In a process of its own: how many effects there are, and what a demo says of its model.
PROGRAM = """
import sys
from deltaid.cli.app import main
from deltaid.effects.all import EFFECTS
print(len(EFFECTS))
sys.argv = ["deltaid", "demo", "clavel-delta3"]
main()
"""


def test_each_effect_has_a_file_and_a_name_of_its_own_and_is_listed() -> None:
    for module in pkgutil.iter_modules([str(PACKAGE / "effects")], "deltaid.effects."):
        importlib.import_module(module.name)
    classes = {*Effect.__subclasses__(), *DescribedEffect.__subclasses__()} - {DescribedEffect}
    assert {type(effect) for effect in EFFECTS} == classes
    assert len({effect.kind for effect in EFFECTS}) == len(EFFECTS)
    assert len({type(effect).__module__ for effect in EFFECTS}) == len(EFFECTS)


def test_nothing_but_the_list_knows_an_effect() -> None:
    """So each of them may be deleted."""
    names = {type(effect).__module__ for effect in EFFECTS}
    for path in PACKAGE.rglob("*.py"):
        imported = set(re.findall(r"^from ([\w.]+) import", path.read_text("utf-8"), re.MULTILINE))
        assert imported & names == (names if path.name == "all.py" else set()), path


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.kind)
def test_an_effect_is_short_and_can_be_detected(effect: Effect) -> None:
    kind = type(effect)
    assert kind.candidates is not Effect.candidates or kind.search is not Effect.search
    path = PACKAGE / "effects" / f"{kind.__module__.rpartition('.')[2]}.py"
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ripple", "drift", "place"])
def test_without_an_effect_the_package_identifies(name: str, tmp_path: Path) -> None:
    copy = tmp_path / "src" / "deltaid"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "effects" / f"{name}.py").unlink()
    listed = copy / "effects" / "all.py"
    text = listed.read_text(encoding="utf-8")
    (owner,) = re.findall(rf"from deltaid[.]effects[.]{name} import (\w+)", text)
    kept = [line for line in text.splitlines() if owner not in line]
    listed.write_text("\n".join(kept), encoding="utf-8")

    without, whole = (_demo(src, tmp_path) for src in (copy.parent, PACKAGE.parent))
    assert without[0] == str(len(EFFECTS) - 1)
    (truth,) = (line for line in whole if line.startswith("Against the truth: mass matrix within"))
    assert truth in without


def _demo(src: Path, folder: Path) -> list[str]:
    """What a demo prints with the package of a folder."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(src), "COLUMNS": "300"},
        capture_output=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
