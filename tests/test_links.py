"""Links of README and the documentation lead somewhere; every page is reached."""

import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from links import DOCS, PAGES, ROOT, Link, anchors, external, links


@pytest.mark.slow
def test_links_lead_somewhere() -> None:
    broken = {
        (str(page.relative_to(ROOT)), link.target): why
        for page in PAGES
        for link in links(page)
        if not link.external and (why := link.broken())
    }
    assert not broken


def test_what_is_broken_is_found(tmp_path: Path) -> None:
    page = DOCS / "index.md"
    for target in ("nowhere.md", "theory.md#nothing", "#nothing", "../README.md", "images/x.png"):
        assert Link(page, target).broken()
    assert not Link(page, "theory.md#excitation").broken()
    text = (
        '# A\n\n## B `c` (d)\n\n## A\n\n[x](a.md) <img src="b.png">\n\n=== "T"\n\n    [y](c.md)\n'
    )
    own = tmp_path / "own.md"
    own.write_text(text)
    assert anchors(own) == {"a", "b-c-d", "a_1"}
    assert [link.target for link in links(own)] == ["a.md", "b.png", "c.md"]


def test_links_elsewhere_are_few_and_safe() -> None:
    assert all(target.startswith("https://") for target in external())


def test_every_page_is_in_the_navigation_once() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = re.sub(r"!ENV", "", text)

    def pages(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        children = entry.values() if isinstance(entry, dict) else entry
        return [page for child in children for page in pages(child)]

    listed = pages(YAML(typ="safe").load(text)["nav"])
    assert sorted(listed) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
