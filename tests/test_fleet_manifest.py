"""The manifest of a fleet: what it may say, what is told of its mistakes, and its page."""

import re
from pathlib import Path

import polars as pl
import pytest

from command import refused
from deltaid.fleets.fleet import find_fleet
from deltaid.fleets.manifest import Manifest
from deltaid.fleets.steps import TABLES
from plant import DAYS, TYPE, plant
from sessions import ROOT

FIRST = [f"north/{day}" for day in DAYS[:2]]
MANIFEST = f"type: {TYPE}\nrobots:\n  - robot: north\n    recordings: north/*.parquet\n"


def test_a_table_says_the_same_as_yaml(tmp_path: Path) -> None:
    own = plant(tmp_path).record(*FIRST)
    rows = {"robot": ["north"] * 2, "type": [TYPE] * 2, "load": [None, 0.5]}
    frame = pl.DataFrame(rows | {"recording": [f"{name}.parquet" for name in FIRST]})
    frame.write_csv(tmp_path / "fleet.csv")
    frame.write_parquet(tmp_path / "fleet.parquet")
    (tmp_path / "fleet.yaml").write_text(
        MANIFEST.replace("north/*.parquet", f"\n    - {FIRST[0]}.parquet\n    - path: "
                         f"{FIRST[1]}.parquet\n      load: 0.5"),
        encoding="utf-8",
    )  # fmt: skip
    found = [find_fleet(str(tmp_path / f"fleet.{kind}")) for kind in ("yaml", "csv", "parquet")]
    assert found[0].recordings == found[1].recordings == found[2].recordings
    assert [recording.load for recording in found[0].recordings] == [None, 0.5]
    assert [f"{recording.time:%Y-%m-%d}" for recording in found[0].recordings] == list(DAYS[:2])
    assert own.manifest.exists()


@pytest.mark.parametrize("name", ["'a\\0b'", "~nobody-there/a.csv", "a" * 4000])
def test_names_that_no_file_can_have_are_of_none(tmp_path: Path, name: str) -> None:
    own = plant(tmp_path)
    own.manifest.write_text(MANIFEST.replace("north/*.parquet", name.replace("'", '"')))
    (absent,) = find_fleet(str(own.manifest)).absent
    assert absent.reason.startswith("no such file\n  → ")


def test_a_folder_in_place_of_its_files_is_named_as_one(tmp_path: Path) -> None:
    own = plant(tmp_path)
    own.path("north/undated").parent.mkdir()
    own.manifest.write_text(MANIFEST.replace("north/*.parquet", "north"))
    (absent,) = find_fleet(str(own.manifest)).absent
    assert absent.reason.startswith("is a folder\n  → ")
    assert "north/*.csv" in absent.reason


def test_what_two_patterns_refuse_is_reported_once(tmp_path: Path) -> None:
    own = plant(tmp_path)
    own.path("north/undated").parent.mkdir()
    own.path("north/undated").touch()
    both = "[north/*.parquet, north/u*.parquet]"
    own.manifest.write_text(MANIFEST.replace("north/*.parquet", both), encoding="utf-8")
    (absent,) = find_fleet(str(own.manifest)).absent
    assert "nothing says when it was made" in absent.reason


@pytest.mark.parametrize("time", ["2026-02-03", "2026-02-03T08:30", "'2026-02-03 08:30:00'"])
def test_a_time_in_yaml_is_that_of_the_recording(tmp_path: Path, time: str) -> None:
    own = plant(tmp_path).record(*FIRST)
    entry = f"\n    - {{path: {FIRST[0]}.parquet, time: {time}}}"
    own.manifest.write_text(MANIFEST.replace("north/*.parquet", entry), encoding="utf-8")
    (found,) = find_fleet(str(own.manifest)).recordings
    assert f"{found.time:%Y-%m-%d}" == "2026-02-03"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# nothing\n", "fleet.yaml: is empty\n  → `deltaid schema fleet` prints what such a file"),
        (MANIFEST.replace("robot:", "robt:"), "line 3, robots[1].robt: unknown key"),
        (MANIFEST.replace(f"type: {TYPE}\n", ""), "robot north has no type"),
        (
            f"{MANIFEST}    - {{path: a.csv, time: 2026-13-05}}\n".replace("north/*.parquet", ""),
            "time: must be a day as 2026-01-31, or a time as 2026-01-31T08:30, not 2026-13-05",
        ),
        (
            MANIFEST.replace("north/*.parquet", "[{path: a.csv, time: 0001-01-01T00:00+05:00}]"),
            "time: must be a day as 2026-01-31",
        ),
        (
            MANIFEST.replace("robot: north", "robot: ../north"),
            'must be a name: a letter, then letters, digits and _, not "../north"',
        ),
        (MANIFEST + "period: year\n", "line 5, period: "),
        (MANIFEST + "  - robot: south\n    recordings: north/*05.parquet\n", "is given twice, for"),
        (
            MANIFEST + "  - robot: north\n    type: par4\n    recordings: n/*\n",
            "north is there twice",
        ),
        (MANIFEST + "  - robot: North\n    recordings: n/*\n", "differ in capital letters only"),
    ],
)
def test_a_mistake_of_the_manifest_is_one_message(tmp_path: Path, text: str, words: str) -> None:
    own = plant(tmp_path).record(*FIRST)
    own.manifest.write_text(text, encoding="utf-8")
    assert words in refused("fleet", own.manifest, "-o", own.output, folder=tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot,recording\n,a.csv\n", "row 2: robot is missing"),
        ("robot,recording,lood\nn,a.csv,1\n", "has the unknown column lood"),
        ("robot,time\nn,2026-01-01\n", "has no column recording"),
        ("robot,recording,load\nn,a.csv,1\nn,b.csv,much\n", "row 2: load: must be a number"),
        ("robot,recording,time\nn,a.csv,31/01/2026\n", "row 2: time: must be a day as 2026-"),
        ("robot,recording,time\nn,a.csv,20260131\n", "row 2: time: must be a day as 2026-"),
        ("robot,recording\n", "has no rows"),
        ("robot;recording;load\nn;a.csv;much\n", "row 2: load: must be a number"),
        ("robot,recording,type\nn,a.csv,h4\nN,b.csv,h4\n", "differ in capital letters only"),
        ("robot,recording,type\nn,a.csv,h4\nn,b.csv,i4\n", "has two types"),
    ],
)
def test_a_mistake_in_a_row_is_one_message(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "fleet.csv").write_text(text, encoding="utf-8")
    command = ("fleet", tmp_path / "fleet.csv", "-o", tmp_path / "out")
    assert words in refused(*command, folder=tmp_path)


def test_a_fleet_needs_a_folder_with_a_name(tmp_path: Path) -> None:
    """An unset variable of a script would fill the current folder."""
    own = plant(tmp_path).record(*FIRST)
    said = refused("fleet", own.manifest, "-o", "", folder=tmp_path)
    assert "-o '': nothing is given" in said


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("2026-01-31.csv", "2026-01-31 00:00:00"),
        ("line1_20260131_0830.csv", "2026-01-31 08:30:00"),
        ("log-2026-01-31T08-30-15.csv", "2026-01-31 08:30:15"),
        ("year=2026/month=01/day=31/part.csv", "2026-01-31 00:00:00"),
        ("2026/01/31/a.csv", "2026-01-31 00:00:00"),
    ],
)
def test_names_and_folders_say_when(tmp_path: Path, name: str, time: str) -> None:
    path = tmp_path / "r" / name
    path.parent.mkdir(parents=True)
    path.touch()
    text = f"type: {TYPE}\nrobots: [{{robot: a, recordings: 'r/**/*.csv'}}]\n"
    (tmp_path / "fleet.yaml").write_text(text, encoding="utf-8")
    (found,) = find_fleet(str(tmp_path / "fleet.yaml")).recordings
    assert str(found.time) == time


PAGE = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")


def test_all_keys_of_a_manifest_are_named() -> None:
    schema = Manifest.model_json_schema()
    for part in (schema, *schema["$defs"].values()):
        for key in part["properties"]:
            assert re.search(rf"^\| `{key}` \|", PAGE, re.M), key


@pytest.mark.parametrize("name", sorted(TABLES))
def test_all_columns_of_the_tables_are_named(name: str) -> None:
    text = PAGE.partition(f"\n`{name}.parquet`, ")[2] or PAGE.partition("\n`types.parquet`, ")[2]
    rows = text.partition("\n\n")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", rows))
    assert set(TABLES[name]) - {"key"} <= named
