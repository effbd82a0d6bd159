"""Messages in plain English: sentences of at most 30 words, without words that an engineer would
not say; gathered from the sources of the whole package."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from deltaid.errors import counted, few
from deltaid.model.verdict import plus_minus

SOURCE = Path(__file__).resolve().parents[1] / "src" / "deltaid"
LONGEST = 30  # words a sentence
FORBIDDEN = re.compile(
    r"\b(told|tells?|(?:put|puts) right|mend(?:s|ed)?|left out|leaves? out|what is left|"
    r"looked at|look(?:s|ed)? for|stands? out|outstanding|seen|alike|wander(?:s|ed)?|warmth|slack|"
    r"felt)\b",
    re.IGNORECASE,
)
# Lists of words that columns of recordings may have are not sentences.
NO_MESSAGES = ("recording/column_meanings.py",)


def messages(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of every literal of at least four words that is no docstring.

    A formatted value counts as one word.
    """
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        match node:
            case ast.Constant(value=str(text)):
                pass
            case ast.JoinedStr(values=parts):
                text = "".join(p.value if isinstance(p, ast.Constant) else "0" for p in parts)
                values = [p.value for p in parts if isinstance(p, ast.FormattedValue)]
                yield from messages(ast.Tuple(values))
            case _:
                yield from messages(node)
                continue
        if len(text.split()) >= 4:
            yield node.lineno, text


def complaints(text: str) -> list[str]:
    """Forbidden words of a text, and the first words of sentences that are too long."""
    found = [match[0] for match in FORBIDDEN.finditer(text)]
    sentences = re.split(r"(?<=[.;:!?])\s+|\n", text)
    return found + [s[:40] for s in sentences if len(s.split()) > LONGEST]


def test_complaints_find_words_and_lengths() -> None:
    tree = ast.parse(
        'def f():\n    """What is told."""\n    raise E(f"{x} was left out " "here, too")'
    )
    [(line, text)] = messages(tree)
    assert (line, complaints(text)) == (3, ["left out"])
    assert complaints("word " * LONGEST + "end.")
    assert not complaints("word " * LONGEST)


def test_messages_are_short_and_plain() -> None:
    paths = [p for p in sorted(SOURCE.rglob("*.py")) if not p.as_posix().endswith(NO_MESSAGES)]
    gathered = [
        (f"{path.relative_to(SOURCE)}:{line}", text)
        for path in paths
        for line, text in messages(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert len(gathered) > 2000
    bad = {place: found for place, text in gathered if (found := complaints(text))}
    assert not bad, "\n".join(f"{place}: {complaint}" for place, complaint in bad.items())


def test_a_long_list_says_how_many_more_there_are() -> None:
    assert few(["a", "b"], 2) == "a, b"
    assert few(["a", "b", "c", "d", "e"], 3) == "a, b, c and 2 more"
    assert few(["a", "b", "c"], 1, "; ") == "a; and 2 more"


def test_half_widths_have_one_digit_and_no_power_of_ten() -> None:
    assert plus_minus(178.3, 57.2) == "178 ± 60"
    assert plus_minus(0.01512, 0.0023, 2) == "0.015 ± 0.002"
    assert plus_minus(2, 0.96) == "2 ± 1"


def test_only_one_of_a_thing_has_no_s() -> None:
    assert [counted(count, "row") for count in range(3)] == ["0 rows", "1 row", "2 rows"]
