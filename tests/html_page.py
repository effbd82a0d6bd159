"""A page of a report as a browser reads it."""

from html.parser import HTMLParser
from pathlib import Path

HOSTILE = "</script><img src=x onerror=alert(1)>&amp;"


class Document(HTMLParser):
    """Tags with their attributes, contents of scripts, and all other text."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.texts: list[str] = []
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.texts.append(data)

    @property
    def headings(self) -> list[str]:
        """Entries of the contents list."""
        links = [a.get("href") or "" for tag, a in self.tags if tag == "a"]
        return [link for link in links if link.startswith("#section")]

    @property
    def loaded(self) -> list[str]:
        """Everything that a browser would fetch."""
        names = ("src", "srcset", "data", "poster", "action", "background", "xlink:href")
        found = [a[name] for _, a in self.tags for name in names if a.get(name)]
        found += [a["href"] for tag, a in self.tags if tag != "a" and a.get("href")]
        return [str(link) for link in found if not str(link).startswith("data:")]


def document(page: Path) -> Document:
    return Document(page.read_text(encoding="utf-8"))


def words(page: Path) -> str:
    return " ".join(" ".join(document(page).texts).replace("\N{NO-BREAK SPACE}", " ").split())
