"""`deltaid online`: what a recording with known loads and pushes shows, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from command import accepted, json_of, refused, run
from deltaid.online.replay import open_replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.watch import watch
from picking import HELD, MASS, PUSHES, picked

TOLD = ("--gripper", "gripper", "--payload-max", 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model and a recording; no test changes these."""
    place = tmp_path_factory.mktemp("line")
    picked().model.identified.save(place / "model.yaml")
    picked().table.write_csv(place / "log.csv")
    return place


@pytest.fixture(scope="module")
def results(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What the command says of it as JSON, and the table and page that it wrote."""
    out = tmp_path_factory.mktemp("told")
    files = ("-o", out / "time.parquet", "--report", out / "page.html")
    return json_of("online", folder / "model.yaml", folder / "log.csv", *TOLD, *files), out


def test_loads_are_those_that_were_held(results: tuple[dict[str, Any], Path]) -> None:
    loads = results[0]["loads"]
    assert [(load["start"], load["end"]) for load in loads] == [pytest.approx(h) for h in HELD]
    for load in loads:
        mass = load["entries"][0]
        assert mass["low"] < MASS < mass["high"] < mass["low"] + 0.1
        assert load["mass_soon"]["value"] == pytest.approx(MASS, abs=0.06)
        assert load["mass_soon"]["low"] < MASS < load["mass_soon"]["high"]


def test_pushes_are_found_where_and_as_hard_as_they_were(
    results: tuple[dict[str, Any], Path],
) -> None:
    contacts = results[0]["contacts"]
    assert len(contacts) == len(PUSHES)
    for contact, (start, end, drive, size) in zip(contacts, PUSHES, strict=True):
        assert start < contact["start"] < start + 0.01
        assert end < contact["end"] < end + 0.05
        assert contact["place"] == ("platform" if drive is None else f"drive{drive + 1}")
        found = contact["force"] if drive is None else [contact["effort"]]
        np.testing.assert_allclose(found, size, atol=0.2 * float(np.linalg.norm(size)))


def test_what_is_reported(results: tuple[dict[str, Any], Path]) -> None:
    found = results[0]
    assert 0.5 < found["smallest_force"]["best"] < found["smallest_force"]["worst"] < 30
    assert found["cycles"] == 10_000
    assert found["bad"] == 0
    assert found["has_gripper"]
    # It was recorded with the friction that the model has.
    for joint in found["friction"]:
        assert abs(joint["value"] - joint["before"]) < 3 * joint["std"] + 0.1


def test_table_and_page(results: tuple[dict[str, Any], Path]) -> None:
    table = pl.read_parquet(results[1] / "time.parquet")
    assert len(table) == 10_000
    middle = table.filter((pl.col("t") > 4.0) & (pl.col("t") < 4.9))
    assert middle["mass"].mean() == pytest.approx(MASS, abs=0.05)
    assert not table.filter(pl.col("held") == 0)["mass"].to_numpy().any()
    pushed = table.filter((pl.col("t") > 3.53) & (pl.col("t") < 3.6))
    assert pushed["contact_size"].to_numpy().min() > 1
    assert pushed["force_x"].mean() == pytest.approx(25, abs=3)
    page = (results[1] / "page.html").read_text(encoding="utf-8")
    assert "limb of drive2" in page
    assert "2 loads and 2 contacts" in page


def test_no_gripper_says_what_is_lost(folder: Path) -> None:
    outcome = accepted("online", folder / "model.yaml", folder / "log.csv", "--payload-max", 2)
    assert "found from torques alone" in outcome.out
    assert "do not separate a push straight up or down" in outcome.out
    assert "limb of drive2" in outcome.out


def test_fewer_false_alarms_need_more_force() -> None:
    replay = open_replay(picked().model, picked().table[:3000])
    few, many = (watch(picked().model, replay, OnlineSettings(false_alarms=n)) for n in (1e-3, 1e3))
    assert few.best > 1.2 * many.best
    assert not few.touches


def test_recorded_velocities_are_taken() -> None:
    t = picked().table[:4000]
    rates = {f"qd{i}": np.gradient(t[f"q{i}"].to_numpy(), 1e-3) for i in (1, 2, 3)}
    replay = open_replay(picked().model, t.with_columns(**rates), gripper="gripper")
    assert replay.has_velocity
    found = watch(picked().model, replay, OnlineSettings(largest_mass=2.0))
    assert found.loads[0].mass.value == pytest.approx(MASS, abs=0.05)
    assert [touch.place for touch in found.touches] == ["platform"]


def test_a_hole_begins_anew_without_a_contact() -> None:
    t = picked().table
    replay = open_replay(picked().model, pl.concat([t[:1500], t[1800:3200]]), gripper="gripper")
    assert sum(rows.begins for rows in replay.rows()) == 2
    found = watch(picked().model, replay, OnlineSettings(largest_mass=2.0))
    assert found.touches == ()
    assert found.cycles == 2900
    assert any("1 gap" in doubt for doubt in found.doubts)


@pytest.mark.slow
def test_torques_that_lag_are_not_taken_for_contacts_without_a_word() -> None:
    late = [pl.col(f"q{i}").shift(5).fill_null(strategy="backward") for i in (1, 2, 3)]
    replay = open_replay(picked().model, picked().table.with_columns(late))
    found = watch(picked().model, replay, OnlineSettings())
    assert any("ms early against positions" in doubt for doubt in found.doubts)


@pytest.mark.slow
def test_what_is_doubtful_stands_everywhere(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    files = (folder / "model.yaml", folder / "log.csv", *TOLD, "--lag", 3, "--report", page)
    outcome = run("online", *files, "--json")
    (doubt,) = json.loads(outcome.out)["warnings"]
    assert "3 ms late is corrected" in doubt
    assert doubt in " ".join(outcome.err.split())
    text = page.read_text(encoding="utf-8")
    assert "read a warning below" in text
    assert "3 ms late is corrected" in text


def test_what_is_refused(folder: Path, tmp_path: Path) -> None:
    model, log = folder / "model.yaml", folder / "log.csv"

    def says(*arguments: object) -> str:
        return refused("online", *arguments, folder=tmp_path)

    assert "prior" in says("clavel-delta3", log)
    assert "nosuch" in says(model, log, "--gripper", "nosuch")
    assert "--payload-max" in says(model, log, "--payload-max", -1)
    assert "--false-alarms" in says(model, log, "--false-alarms", 0)
    assert "--grip-time" in says(model, log, "--grip-time", -1)
    assert "no effect without --gripper" in says(model, log, "--grip-time", 0.1)
    for lag in ("late", "1,2", "estimate"):
        assert "--lag" in says(model, log, "--lag", lag)
    assert "50 ms" in says(model, log, "--lag", 90)
    assert ".parquet or .csv" in says(model, log, "-o", tmp_path / "x.txt")
    assert ".html" in says(model, log, "--report", tmp_path / "x.txt")
    assert "missing.csv" in says(model, folder / "missing.csv")
    mapping = tmp_path / "columns.yaml"
    mapping.write_text("load: {column: gripper}\n")
    assert "already" in says(model, log, "--columns", mapping, "--gripper", "gripper")
    slow = tmp_path / "slow.csv"
    pl.read_csv(log)[::20].write_csv(slow)
    assert "rows a second" in says(model, slow)
