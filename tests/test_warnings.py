"""Every warning says what was seen, the likeliest cause and the next step."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltaid.errors import Doubt
from sessions import ROOT

SOURCES = sorted((ROOT / "src" / "deltaid").rglob("*.py"))
# What verdicts and fits say is made elsewhere (`Verdict`, `identification/doubts.py`).
COLLECTED = {"warnings", "noticed", "doubts", "told"}


def calls(tree: ast.AST, name: str) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name:
            yield node


def text(node: ast.expr) -> str:
    """The words that stand in an expression."""
    parts = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
    return "".join(part for part in parts if isinstance(part, str))


def test_a_doubt_is_one_sentence() -> None:
    doubt = Doubt("it rained", cause="a cloud", cure="wait", key="clock")
    assert doubt == "it rained; likeliest cause: a cloud; wait"
    assert doubt.key == "clock"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_no_warning_is_bare(path: Path) -> None:
    """What is collected as a warning is a `Doubt`, and none has an empty cause or cure."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for call in calls(tree, "Doubt"):
        words = {word.arg: word.value for word in call.keywords}
        assert {"cause", "cure"} <= set(words)
        for value in (words["cause"], words["cure"]):
            assert not isinstance(value, ast.Constant) or value.value
            assert not text(value).endswith(".")
        assert "likeliest" not in text(call), "said twice"
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            whose = node.func.value
            name = getattr(whose, "attr", getattr(whose, "id", ""))
            if node.func.attr == "append" and name in COLLECTED:
                assert "check" in path.parts or not isinstance(
                    node.args[0], ast.Constant | ast.JoinedStr
                ), ast.unparse(node)
