"""A fleet's static site: pages that share style, scripts and Plotly, without a server."""

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from urllib.parse import quote

import polars as pl
from plotly.offline import get_plotlyjs

from deltaid.files import DEVICES, together
from deltaid.fleets.place import Place
from deltaid.fleets.site.overview import overview
from deltaid.fleets.site.robot_page import robot_page
from deltaid.fleets.site.state import Tables, robots_of, with_spreads
from deltaid.fleets.site.type_page import type_page
from deltaid.view.html import contents, environment, part
from deltaid.view.page import Page

SITE, ROBOTS, TYPES = "site", "robots", "types"
_UP = "../"


def write_site(tables: Mapping[str, pl.DataFrame], place: Place) -> None:
    """Write the site of a fleet into the folder `SITE` of the fleet's folder.

    Pages of robots that the tables no longer have are removed. On this machine either all pages
    are of this call, or none is.

    Raises:
        DeltaidError: a page cannot be written.
    """
    written = set[str]()
    with together():
        for page, text in _pages(with_spreads(tables), f"Fleet {place.name}"):
            place.write(f"{SITE}/{page}", text.encode())
            written.add(f"{SITE}/{page}")
    for folder in (ROBOTS, TYPES):
        there = place.listing(f"{SITE}/{folder}").keys() - written
        place.remove(page for page in there if page.endswith(".html"))


def _pages(tables: Tables, title: str) -> Iterable[tuple[str, str]]:
    robots = robots_of(tables)
    kinds = sorted({robot.type for robot in robots} | set(tables["types"]["type"]))
    labels = {kind: label or "(no type)" for kind, label in type_labels(kinds).items()}
    pages, of_types = file_names(robot.name for robot in robots), file_names(kinds)
    links = {name: quote(f"{ROBOTS}/{file}") for name, file in pages.items()}
    types = {kind: quote(f"{TYPES}/{file}") for kind, file in of_types.items()}
    yield from ((name, part(name)) for name in ("page.css", "page.js"))
    yield from ((name, part(name, "fleets/site")) for name in ("site.css", "site.js"))
    yield "plotly.js", get_plotlyjs()
    yield "index.html", _rendered(overview(tables, robots, title, links, types, labels))
    home = (title, f"{_UP}index.html")
    for robot in robots:
        label = labels[robot.type]
        page = _rendered(robot_page(robot, label), home, (label, _UP + types[robot.type]))
        yield f"{ROBOTS}/{pages[robot.name]}", page
    above = {name: _UP + link for name, link in links.items()}
    for kind, label in labels.items():
        page = _rendered(type_page(kind, label, tables, robots, above), home)
        yield f"{TYPES}/{of_types[kind]}", page


def _rendered(page: Page, *way: tuple[str, str]) -> str:
    """A page, below those on the way to it, which link to it; files it shares are at the root."""
    template = environment("fleets/site").get_template("site.html.jinja")
    return template.render(**contents(page), root=_UP if way else "", way=way)


_PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}")
_UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")
_TAKEN = re.compile(DEVICES, re.IGNORECASE)


def file_names(names: Iterable[str]) -> dict[str, str]:
    """A file's name for each name: the same where it is plain, else with a part of its checksum.

    Letters alone tell two files apart, whether small or capital.
    """
    given = list(dict.fromkeys(names))
    alike = Counter(name.casefold() for name in given)
    files = dict[str, str]()
    for name in given:
        files[name] = f"{name}.html"
        plain = _PLAIN.fullmatch(name) and not _TAKEN.fullmatch(name)
        if not plain or alike[name.casefold()] > 1:
            start = _UNSAFE.sub("-", name).strip("-")[:40] or "robot"
            files[name] = f"{start}-{hashlib.sha256(name.encode()).hexdigest()[:8]}.html"
    return files


def type_labels(types: Iterable[str]) -> Mapping[str, str]:
    """Short names of types: a description's file without its folder if that is unique."""
    given = list(dict.fromkeys(types))
    short = {name: PurePosixPath(name.replace("\\", "/")).name or name for name in given}
    count = Counter(short.values())
    return {name: short[name] if count[short[name]] == 1 else name for name in given}
