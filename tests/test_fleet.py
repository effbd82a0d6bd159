"""A fleet on this machine: what is done is not done again, and what is bad stops nothing else."""

import json
import os
import shutil
from pathlib import Path

import polars as pl
import pytest

from command import run
from deltaid.fleet import cluster
from deltaid.fleet.fleet import find_fleet
from deltaid.fleet.store import Store
from plant import DAYS, TYPE, Plant, plant, recordings

FIRST = [f"north/{day}" for day in DAYS[:2]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    """All recordings, in one call, beside one that is none."""
    found = plant(tmp_path_factory.mktemp("whole")).record(*recordings())
    found.path("south/2026-01-09").write_bytes(found.path("south/2026-01-07").read_bytes()[:-900])
    found.run()
    return found


def test_a_robot_and_a_period_are_rows_of_one_table(whole: Plant) -> None:
    table = whole.table()
    assert table.select("robot", "period", "recordings").unique(maintain_order=True).rows() == [
        (robot, period, count)
        for robot in ("north", "south")
        for period, count in (("2026-W02", 2), ("2026-W03", 1), ("all", 3))
    ]
    mass = table.filter(pl.col("parameter") == "coulomb.drive1", pl.col("period") == "all")
    assert mass["decided_by"].to_list() == ["data", "data"]
    assert mass["value"][1] / mass["value"][0] == pytest.approx(1.2, abs=0.02)
    assert ((table["low"] <= table["value"]) & (table["value"] <= table["high"])).all()


def test_what_is_no_recording_is_told_and_stops_nothing(whole: Plant) -> None:
    refused = pl.read_csv(whole.output / "quarantine.csv")
    assert refused.select("what", "robot").rows() == [("recording", "south")]
    assert "south/2026-01-09.parquet" in refused["which"][0]
    assert "is no Parquet file" in refused["reason"][0]
    told = whole.table("recordings.parquet").filter(pl.col("reason") != "")
    assert told["path"].to_list() == refused["which"].to_list()


def test_nothing_is_done_again(whole: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (whole.output / "parameters.parquet").read_bytes()
    monkeypatch.setattr(cluster, "require_dask", lambda: pytest.fail("workers were started"))
    assert whole.run().computed == (0, 0)
    assert (whole.output / "parameters.parquet").read_bytes() == before


def test_the_command_tells_what_it_has_done(whole: Plant) -> None:
    done = run("fleet", whole.manifest, "-o", whole.output, "--cutoff", 15, "--friction",
               "described", "--json")  # fmt: skip
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert {key: told[key] for key in ("robots", "used", "gathered", "fits", "fitted")} == {
        "robots": 2, "used": 6, "gathered": 0, "fits": 6, "fitted": 0,
    }  # fmt: skip
    assert [line["which"] for line in told["quarantine"]] == [str(whole.path("south/2026-01-09"))]


def test_days_that_come_later_give_the_same_bits(whole: Plant, tmp_path: Path) -> None:
    """Meanwhile a factor file is cut short, a recording is thrown away, another one copied."""
    own = plant(tmp_path / "own", robots=("north",)).record(*FIRST)
    assert own.run().computed == (2, 2)
    own.record(f"north/{DAYS[2]}").path(FIRST[1]).unlink()
    shutil.copy(own.path(FIRST[0]), own.path("north/2026-01-08"))
    cut = next((own.output / "factors" / "north").glob("2026-01-05*"))
    cut.write_bytes(cut.read_bytes()[:-500])
    second = own.run()
    assert second.computed == (3, 2)
    assert [line.which for line in second.quarantine] == [str(own.path("north/2026-01-08"))]
    assert "is a copy of" in second.quarantine[0].reason
    assert own.table().equals(whole.table().filter(pl.col("robot") == "north"))
    gone = own.table("recordings.parquet").filter(~pl.col("there"))
    assert gone["path"].to_list() == [str(own.path(FIRST[1]))]


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
    found = [
        find_fleet(str(tmp_path / f"fleet.{kind}"), Store()) for kind in ("yaml", "csv", "parquet")
    ]
    assert found[0].recordings == found[1].recordings == found[2].recordings
    assert [one.load for one in found[0].recordings] == [None, 0.5]
    assert [f"{one.time:%Y-%m-%d}" for one in found[0].recordings] == list(DAYS[:2])
    assert own.manifest.exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MANIFEST.replace("robot:", "robt:"), "line 3, robots.0.robt: unknown key"),
        (MANIFEST.replace(f"type: {TYPE}\n", ""), "robot north has no type"),
        (MANIFEST + "period: year\n", "line 5, period: "),
        (MANIFEST + "  - robot: south\n    recordings: north/*05.parquet\n", "is given twice, for"),
        (MANIFEST + "  - robot: north\n    type: par4\n    recordings: n/*\n", "has two types"),
    ],
)
def test_a_mistake_of_the_manifest_is_one_message(tmp_path: Path, text: str, words: str) -> None:
    own = plant(tmp_path).record(*FIRST)
    own.manifest.write_text(text, encoding="utf-8")
    refused = run("fleet", own.manifest, "-o", own.output, width=300)
    assert refused.code == 2
    assert refused.errors == 1
    assert words in refused.err
    assert not own.output.exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot,recording\n,a.csv\n", "row 2: robot is missing"),
        ("robot,recording,lood\nn,a.csv,1\n", "has the unknown column lood"),
        ("robot,time\nn,2026-01-01\n", "has no column recording"),
        ("robot,recording,load\nn,a.csv,1\nn,b.csv,much\n", "row 2: load: must be a number"),
        ("robot,recording,time\nn,a.csv,31/01/2026\n", "row 2: time: must be written as 2026-"),
        ("robot,recording,time\nn,a.csv,20260131\n", "row 2: time: must be written as 2026-"),
        ("robot,recording\n", "has no rows"),
    ],
)
def test_a_mistake_in_a_row_is_one_message(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "fleet.csv").write_text(text, encoding="utf-8")
    refused = run("fleet", tmp_path / "fleet.csv", "-o", tmp_path / "out", width=300)
    assert refused.code == 2
    assert words in refused.err


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
    (found,) = find_fleet(str(tmp_path / "fleet.yaml"), Store()).recordings
    assert str(found.time) == time


def test_a_robot_without_a_description_and_a_log_without_a_date_stop_nothing(whole: Plant) -> None:
    text = whole.manifest.read_text(encoding="utf-8")
    own = whole.folder / "more.yaml"
    (whole.folder / "x").mkdir()
    (whole.folder / "x" / "a.csv").touch()
    (whole.folder / "x" / "2026-01-01.csv").touch()
    own.write_text(text + "  - robot: x\n    type: x.yaml\n    recordings: x/*\n", encoding="utf-8")
    copy = whole.folder / "copy"
    shutil.copytree(whole.output, copy, copy_function=os.link)
    done = run("fleet", own, "-o", copy, "--cutoff", 15, "--friction", "described", width=300)
    assert done.code == 0, done.err
    assert "x/a.csv: nothing says when it was made" in done.err
    assert "x.yaml: no such file" in done.err or "no robot file" in done.err
