"""Links of README and the documentation: where they lead, and which of them lead nowhere.

    python tests/links.py

lists every link that leads elsewhere, with the pages that have it. Links between pages are checked
by tests/test_docs.py, and once more, with the anchors of the API, by `zensical build --strict`.
"""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [*sorted(ROOT.glob("*.md")), *sorted(DOCS.rglob("*.md"))]
_MARKDOWN = MarkdownIt("commonmark").enable("table")
_INDENTED_TAB = re.compile(r'^=== ".*"\n\n((?:    .*\n|\n)+)', re.M)
_NOT_IN_SLUGS = re.compile(r"[^\w\s-]")


@dataclass(frozen=True)
class Link:
    """A link or picture of a page."""

    page: Path
    target: str

    @property
    def external(self) -> bool:
        """Whether it leads out of the repository."""
        return bool(re.match(r"[a-z]+:|//", self.target))

    def broken(self) -> str:
        """Why it leads nowhere, or nothing."""
        where, _, anchor = self.target.partition("#")
        path = (self.page.parent / where).resolve() if where else self.page
        if not path.exists() or not path.is_relative_to(ROOT):
            return f"there is no {where}"
        if self.page.is_relative_to(DOCS) and not path.is_relative_to(DOCS):
            return f"{where} is not among the pages of the site"
        if anchor and path.suffix == ".md" and anchor not in anchors(path):
            return f"{path.name} has no heading #{anchor}"
        return ""


class _Targets(HTMLParser):
    """Addresses in a piece of HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [
            value for name, value in attrs if name in ("href", "src", "srcset") and value
        ]


def links(page: Path) -> Iterator[Link]:
    """All of a page, in Markdown and in HTML; code has none."""
    text = _INDENTED_TAB.sub(lambda tab: tab[1].replace("    ", ""), page.read_text("utf-8"))
    for token in _walk(_MARKDOWN.parse(text)):
        found = [token.attrGet("href"), token.attrGet("src")]
        if token.type in ("html_block", "html_inline"):
            html = _Targets()
            html.feed(token.content)
            found += html.found
        for target in filter(None, found):
            # Endings that choose a picture by the page's colours.
            yield Link(page, str(target).removesuffix("#only-light").removesuffix("#only-dark"))


def anchors(page: Path) -> set[str]:
    """What a link can point at in a page: its headings, and in pages of the API its objects."""
    text = page.read_text("utf-8")
    tokens, slugs = _MARKDOWN.parse(text), set()
    for opening, inline in pairwise(tokens):
        if opening.type == "heading_open":
            words = "".join(part.content for part in inline.children or [])
            slugs.add(_once_more(_slug(words), slugs))
    return slugs | set(re.findall(r"^::: (\S+)$", text, re.M))


def _slug(words: str) -> str:
    plain = unicodedata.normalize("NFKD", words).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", _NOT_IN_SLUGS.sub("", plain).strip().lower())


def _once_more(slug: str, taken: set[str]) -> str:
    number = 1
    while (name := slug if number == 1 else f"{slug}_{number - 1}") in taken:
        number += 1
    return name


def _walk(tokens: list[Token]) -> Iterator[Token]:
    for token in tokens:
        yield token
        yield from _walk(token.children or [])


def external() -> dict[str, list[str]]:
    """Addresses elsewhere, each with the pages that have it."""
    found: dict[str, list[str]] = defaultdict(list)
    for page in PAGES:
        for link in links(page):
            if link.external:
                found[link.target].append(str(page.relative_to(ROOT)))
    return dict(sorted(found.items()))


if __name__ == "__main__":
    for target, pages in external().items():
        print(target, *pages)
