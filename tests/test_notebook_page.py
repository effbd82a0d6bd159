"""The notebook of the documentation runs, stores what it gives today, and is the page."""

import copy
from typing import Any

import pytest

import notebook_page
from sessions import ROOT


@pytest.fixture(scope="module")
def old() -> Any:
    return notebook_page.stored()


@pytest.fixture(scope="module")
def new() -> Any:
    return notebook_page.executed()


@pytest.mark.slow
def test_it_gives_what_it_stores(old: Any, new: Any) -> None:
    assert not list(notebook_page.differences(old, new))


def test_the_page_shows_what_it_stores(old: Any) -> None:
    page = notebook_page.PAGE.read_text(encoding="utf-8")
    assert page == notebook_page.page(old), "python tests/notebook_page.py --renew"
    pictures = {path.name for path in notebook_page.PICTURES.iterdir()}
    assert {name for name in pictures if f"(images/notebook/{name})" in page} == pictures
    assert len(pictures) == 3
    assert "notebook.md" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_it_goes_the_whole_way(new: Any) -> None:
    code = "\n".join(cell["source"] for cell in notebook_page.code(new))
    for step in ("load_robot", "optimise", "check", "cured_columns", "identify", "validate",
                 "report", "save", "inverse_dynamics", "evaluate", "export"):  # fmt: skip
        assert step in code
    outputs = [output for cell in notebook_page.code(new) for output in cell["outputs"]]
    texts = [output.get("data", {}).get("text/plain", "") for output in outputs]
    assert any("Good: predicts torques of an unseen motion" in text for text in texts)


def test_what_is_out_of_date_is_found(old: Any) -> None:
    """Words, numbers, figures and outputs that are others."""
    cells = notebook_page.code(old)
    words = next(k for k, cell in enumerate(cells) if cell["source"].startswith("checks ="))
    figure = next(k for k, cell in enumerate(cells) if cell["source"] == "motion.plot()")
    proof = next(k for k, cell in enumerate(cells) if cell["source"].startswith("other ="))

    def changed(k: int, change: Any) -> list[str]:
        other = copy.deepcopy(old)
        change(notebook_page.code(other)[k]["outputs"])
        return list(notebook_page.differences(other, old))

    def say(outputs: Any) -> None:
        outputs[0]["data"]["text/plain"] = outputs[0]["data"]["text/plain"].replace("wrong", "odd")

    def count(outputs: Any) -> None:
        text = outputs[0]["data"]["text/plain"]
        outputs[0]["data"]["text/plain"] = text.replace("0.", "5.")

    def draw(outputs: Any) -> None:
        outputs[0]["metadata"]["figure"] += "; scatter more"

    assert not list(notebook_page.differences(old, old))
    assert changed(words, say)
    assert changed(proof, count)
    assert changed(figure, draw)
    assert changed(words, lambda outputs: outputs.clear())
