"""Effects are taken from one list: what is not in it is missed, and nothing else is."""

import importlib
import inspect
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


def test_each_effect_has_a_name_of_its_own_and_is_listed() -> None:
    for module in pkgutil.iter_modules([str(PACKAGE / "effects")], "deltaid.effects."):
        importlib.import_module(module.name)
    classes = {*Effect.__subclasses__(), *DescribedEffect.__subclasses__()} - {DescribedEffect}
    assert {type(effect) for effect in EFFECTS} == classes
    assert len({effect.kind for effect in EFFECTS}) == len(EFFECTS)


def test_nothing_but_the_list_knows_an_effect() -> None:
    """So each of them may be deleted."""
    for effect in EFFECTS:
        name, module = type(effect).__name__, type(effect).__module__
        own = PACKAGE / "effects" / f"{module.rpartition('.')[2]}.py"
        knows = [
            path
            for path in PACKAGE.rglob("*.py")
            if re.search(rf"^from {module} import [^#\n]*?\b{name}\b", _imports(path), re.MULTILINE)
        ]
        assert [path.name for path in knows if path != own] == ["all.py"], name


def _imports(path: Path) -> str:
    """Imports of a file, each in one line."""
    text = path.read_text(encoding="utf-8")
    return re.sub(r"\(\s*([^)]*)\)", lambda found: " ".join(found[1].split()), text)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.kind)
def test_an_effect_is_short_and_can_be_detected(effect: Effect) -> None:
    kind = type(effect)
    assert kind.candidates is not Effect.candidates or kind.search is not Effect.search
    assert len(inspect.getsource(kind).splitlines()) <= 150


@pytest.mark.slow
@pytest.mark.parametrize("owner", ["PositionRipple", "LoadChange", "PlaceDependence"])
def test_without_an_effect_the_package_identifies(owner: str, tmp_path: Path) -> None:
    copy = tmp_path / "src" / "deltaid"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    listed = copy / "effects" / "all.py"
    text = re.sub(
        rf"\b{owner}(\(\))?, ?|, {owner}$", "", listed.read_text(encoding="utf-8"), flags=re.M
    )
    listed.write_text(text, encoding="utf-8")
    (defined,) = (
        path for path in copy.glob("effects/*.py") if f"class {owner}(" in path.read_text("utf-8")
    )
    parts = re.split(r"(?=^class |^def |^@)", defined.read_text(encoding="utf-8"), flags=re.M)
    kept = [part for part in parts if not part.startswith(start)]
    defined.write_text("".join(kept), encoding="utf-8")

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
