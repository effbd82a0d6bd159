"""The site of a fleet from outside: what it says, which files it has, and that names do no harm."""

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag

import numpy as np
import plotly.graph_objects as go
import pytest

from fleet_tables import TYPES, changed, name, write, write_tables
from html_page import HOSTILE, document, words


def figure(page: Path, text: str) -> dict[str, Any]:
    """The first figure of a page that has a text."""
    return next(json.loads(script) for script in document(page).scripts if text in script)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve robots: R003 with rising friction, R006 unlike its type, R008 without recordings."""
    folder = write_tables(tmp_path_factory.mktemp("fleet") / "plant", silent=(7,))
    write(folder)
    return folder


def test_the_first_page_says_which_robots_need_attention_and_why(fleet: Path) -> None:
    said = words(fleet / "site" / "index.html")
    assert "3 of 12 robots need attention, 1 of them now." in said
    assert "R008: none of its 20 recordings can be used: 20260518.parquet: drive q2: no" in said
    assert "R003: friction of q2 rises by 4.0 % a month since 2026-03-16 and reaches its" in said
    assert "R006: does not belong to its type: EE.m is 9 spreads" in said
    assert said.index("R008:") < said.index("R003:") < said.index("R006:")
    assert f"Fleet {fleet.name}" in said
    assert "12 robots of 2 types" in said


def test_every_robot_and_type_has_a_page_and_all_links_lead_somewhere(fleet: Path) -> None:
    site = fleet / "site"
    robots = {page.stem for page in (site / "robots").iterdir()}
    assert robots == {name(k) for k in range(12)}
    assert {page.stem for page in (site / "types").iterdir()} == set(TYPES)
    linked = set()
    for page in site.rglob("*.html"):
        found = document(page)
        links = [attributes.get("href") for tag, attributes in found.tags if tag == "a"]
        for link in [*links, *found.loaded]:
            path = unquote(urldefrag(str(link)).url)
            target = (page.parent / path).resolve() if path else page
            assert target.is_file(), (page, link)
            assert target.is_relative_to(site.resolve())
            linked.add(target)
    assert linked >= {page.resolve() for page in site.rglob("*.html")}


def test_a_robots_page_tells_of_drives_parameters_type_and_recordings(fleet: Path) -> None:
    said = words(fleet / "site" / "robots" / "R003.html")
    assert "Friction of q2 rises by 4.0 % a month since 2026-03-16" in said
    assert "3.1 % … 4.9 %" in said
    assert "2026-03-07 … 2026-03-27" in said
    assert "Fitted to the recordings of 2026-05" in said
    assert "Fitted to all recordings together" in said
    assert "in spreads" in said
    assert "5 of 5" in said  # periods that data decided
    assert "1 of them in quarantine" not in words(fleet / "site" / "robots" / "R001.html")
    refused = words(fleet / "site" / "robots" / "R008.html")
    assert "Act now." in refused
    assert "20260105.parquet: drive q2: no such column" in refused
    assert "do not belong" in words(fleet / "site" / "types" / f"{TYPES[1]}.html")


def test_plotly_takes_every_figure(fleet: Path) -> None:
    count = 0
    for page in ("index.html", "robots/R003.html", f"types/{TYPES[1]}.html"):
        for text in document(fleet / "site" / page).scripts:
            if text.startswith('{"data"'):
                go.Figure(json.loads(text))
                count += 1
    assert count >= 9


def test_a_panel_has_the_change_and_the_line_to_the_limit(fleet: Path) -> None:
    friction = figure(fleet / "site" / "robots" / "R003.html", '"rate"')
    rate, limit, interval = (
        next(trace for trace in friction["data"] if trace["name"] == key)
        for key in ("rate", "limit", "its 95 % interval")
    )
    assert rate["x"][0] == "2026-03-16 06:00"
    seen = [trace for trace in friction["data"] if trace["name"].startswith("friction")]
    assert rate["yaxis"] == limit["yaxis"] == seen[0]["yaxis"] == "y"
    assert interval["y"][2] < rate["y"][1] < interval["y"][1]
    assert {shape["x0"] for shape in friction["layout"]["shapes"]} == {
        "2026-03-16 06:00", "2026-03-07 06:00",
    }  # fmt: skip


def test_a_step_has_its_levels(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 3, 15, foreign=())
    changed(folder, "drift", "R003", "q2", state="stepped", step=0.2, rate=None, horizon=None)
    write(folder)
    page = folder / "site" / "robots" / "R003.html"
    assert "Friction of q2 has stepped by +20 % about 2026-03-16." in words(page)
    friction = figure(page, '"level"')
    level = next(trace for trace in friction["data"] if trace["name"] == "level")
    assert level["y"] == pytest.approx([2.0, 2.0, 2.4, 2.4])


def test_a_value_at_a_limit_is_not_that_of_the_prior(tmp_path: Path) -> None:
    folder = write_tables(tmp_path / "plant", robots=2, weeks=2)
    for origin, is_grey in (("limit", False), ("prior", True)):
        changed(folder, "parameters", name(0), decided_by=origin)
        page = write(folder).parent / "robots" / f"{name(0)}.html"
        assert ('class="muted"' in page.read_text(encoding="utf-8")) == is_grey


def test_temperature_is_taken_out_of_what_is_drawn(fleet: Path) -> None:
    friction = figure(fleet / "site" / "robots" / "R001.html", '"as recorded"')
    recorded, cooled = (np.array(trace["y"]) for trace in friction["data"][:2])
    assert friction["data"][1]["name"].endswith("at one temperature")
    assert np.std(cooled) < 0.75 * np.std(recorded)
    assert np.mean(cooled) == pytest.approx(np.mean(recorded), rel=1e-3)


def test_names_with_markup_or_paths_do_no_harm(tmp_path: Path) -> None:
    names = dict(enumerate((HOSTILE, "../../up", "CON", "r005", "R005", "Größe 7", ".", "?")))
    folder = write_tables(tmp_path / "plant", 9, 3, names=names, rising=(0,), foreign=(0,))
    changed(folder, "recordings", HOSTILE, type=HOSTILE, reason=HOSTILE, path=f"/{HOSTILE}/a.csv")
    changed(folder, "drift", HOSTILE, drive=HOSTILE, reason=HOSTILE)
    changed(folder, "friction", HOSTILE, drive=HOSTILE, unit=HOSTILE, quantity=HOSTILE)
    changed(folder, "members", HOSTILE, parameter=HOSTILE, type=HOSTILE, reason=HOSTILE)
    changed(folder, "parameters", HOSTILE, type=HOSTILE, decided_by=HOSTILE, unit=HOSTILE)
    write(folder)
    pages = list((folder / "site" / "robots").iterdir())
    assert len({page.name.casefold() for page in pages}) == 9
    assert all(page.stem.isascii() and not page.stem.startswith(".") for page in pages)
    assert "con.html" not in {page.name.casefold() for page in pages}
    assert {path.name for path in tmp_path.iterdir()} == {"plant"}
    for page in (folder / "site").rglob("*.html"):
        found = document(page)
        assert not [tag for tag, _ in found.tags if tag == "img"]
        assert not any("onerror" in attributes for _, attributes in found.tags)
        for text in found.scripts:
            if text:
                json.loads(text)
    assert HOSTILE in words(folder / "site" / "index.html")


def test_pages_of_robots_that_are_no_more_are_removed(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 3, 3, foreign=())
    write(folder)
    other = folder / "site" / "robots" / "notes.txt"
    other.write_text("mine")
    write_tables(folder, 2, 3, foreign=())
    write(folder)
    kept = {page.name for page in (folder / "site" / "robots").iterdir()}
    assert kept == {"R001.html", "R002.html", "notes.txt"}


def test_a_site_is_of_one_call_or_not_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_tables(tmp_path, 3, 3, foreign=())
    write(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    calls = list[int]()

    def fails(*_: object) -> str:
        calls.append(1)
        if len(calls) > 2:
            raise KeyboardInterrupt
        return "half"

    monkeypatch.setattr("deltaid.fleets.site.site._rendered", fails)
    with pytest.raises(KeyboardInterrupt):
        write(folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_the_drive_that_changed_comes_first(fleet: Path) -> None:
    page = document(fleet / "site" / "robots" / "R003.html")
    cells = [text.strip() for text in page.texts if text.strip() in ("q1", "q2", "q3")]
    assert cells[0] == "q2"


def test_a_page_of_a_year_stays_small(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 2, 52, per_week=7, rising=(1,), foreign=())
    write(folder)
    pages = (folder / "site" / "robots").iterdir()
    assert max(page.stat().st_size for page in pages) < 230_000
    (plotly,) = [path for path in folder.rglob("*.js") if path.stat().st_size > 1e6]
    assert plotly.parent == folder / "site"


def test_a_line_is_drawn_to_the_last_recording_at_least(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 3, 15, foreign=())
    changed(folder, "drift", "R003", horizon=None)
    write(folder)
    friction = figure(folder / "site" / "robots" / "R003.html", '"rate"')
    rate = next(trace for trace in friction["data"] if trace["name"] == "rate")
    seen = [trace["x"] for trace in friction["data"] if trace["name"].startswith("friction")]
    assert rate["x"][1] >= max(max(x) for x in seen)
