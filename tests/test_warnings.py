"""Every warning says what was seen, the likeliest cause and the next step."""

import ast
from collections.abc import Iterator

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


def bare(tree: ast.AST) -> Iterator[ast.AST]:
    """Warnings with no cause, no cure, a full stop, or words that `Doubt` adds."""
    for call in calls(tree, "Doubt"):
        words = {word.arg: word.value for word in call.keywords}
        parts = [word for word in (words.get("cause"), words.get("cure")) if word is not None]
        empty = any(isinstance(part, ast.Constant) and not part.value for part in parts)
        ended = any(text(part).endswith(".") for part in parts)
        if len(parts) < 2 or empty or ended or "likeliest" in text(call):
            yield call


def collected(tree: ast.AST) -> Iterator[ast.AST]:
    """Bare words that are appended to a list of warnings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            whose = node.func.value
            name = getattr(whose, "attr", getattr(whose, "id", ""))
            words = node.args and isinstance(node.args[0], ast.Constant | ast.JoinedStr)
            if node.func.attr == "append" and name in COLLECTED and words:
                yield node


def test_no_warning_is_bare() -> None:
    """What is collected as a warning is a `Doubt`, and none has an empty cause or cure."""
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found = [*bare(tree), *(() if "checks" in path.parts else collected(tree))]
        assert not found, f"{path.name}: {[ast.unparse(node) for node in found]}"


def test_bare_warnings_are_found() -> None:
    for code in (
        'Doubt("x", cause="a")',
        'Doubt("x", cause="", cure="b")',
        'Doubt("x", cause="a", cure="b.")',
        'Doubt("x; likeliest cause: y", cause="a", cure="b")',
    ):
        assert list(bare(ast.parse(code))), code
    assert not list(bare(ast.parse('Doubt("x", cause="a", cure="b")')))
    assert list(collected(ast.parse('self.warnings.append("x")')))
    assert not list(collected(ast.parse("warnings.append(doubt)")))
