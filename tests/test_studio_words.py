"""What the pages of the studio say in place of the command line's options and keys."""

import ast
import re
from pathlib import Path

import pytest

import deltaid
from deltaid.studio.words import page_words

ROOMS = ("checks", "control", "estimation", "exports", "identification", "joint_forces",
         "recording", "robot")  # fmt: skip


def _texts() -> set[str]:
    """Strings of the rooms that name an option, as far as they are literal."""
    texts = set[str]()
    for room in ROOMS:
        for path in (Path(deltaid.__file__).parent / room).rglob("*.py"):
            if " --" in (source := path.read_text(encoding="utf-8")):
                nodes = ast.walk(ast.parse(source))
                constants = [node.value for node in nodes if isinstance(node, ast.Constant)]
                texts |= {text for text in constants if isinstance(text, str) and " --" in text}
    return texts


def test_no_message_names_an_option_on_a_page() -> None:
    texts = _texts()
    assert len(texts) > 20
    assert [text for text in texts if re.search(r"--[a-z]", page_words(text))] == []


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("declare its unit and gear with --columns MAPPING.yaml",
         "declare its unit and gear on the page Recording"),
        ("column mapping, torque[0]: unit 'A' is not a unit of N m",
         "torque of drive 1: unit 'A' is not a unit of N m"),
        ("a current also needs its torque_constant in N m/A", "a current also needs its N m per A"),
        ("approximate it (--plain-friction)",
         "approximate it (Friction: nearest viscous and Coulomb friction)"),
        ("record longer, or take a lower --cutoff", "record longer, or take a lower cut-off"),
        ("check these with `deltaid check`", "check these with the page Check"),
        ("give --payload MASS too", "give “payload” MASS too"),
        ("12 -- 14 rows", "12 -- 14 rows"),
        ("repair it; `deltaid check` shows more, --force continues anyway",
         "repair it; the page Check shows more"),
    ],
)  # fmt: skip
def test_a_message_is_in_the_words_of_a_page(said: str, shown: str) -> None:
    assert page_words(said) == shown
