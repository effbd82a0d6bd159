"""`deltaid check`: exit codes, cures written, JSON, report; its page lists every verdict."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import deltaid
from checked import changed_file, moved, scaled, written
from command import run
from deltaid.checks.evidence import evidence
from deltaid.checks.verdicts import KEYS, as_written, with_changes
from deltaid.dynamics.dynamics import compiled
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.recording.opening import open_log
from deltaid.robot.load import load_robot
from logs import noisy, recorded, write
from sessions import ROOT


def test_exit_codes(tmp_path: Path) -> None:
    assert run("check", "clavel-delta3").code == 0
    data = as_written("clavel-delta3")
    doubtful = written(with_changes(data, {"friction.drive1": None}), tmp_path / "doubtful.yaml")
    assert run("check", doubtful).code == 3
    wrong = written(scaled(data, 1000), tmp_path / "wrong.yaml")
    assert run("check", wrong).code == 4
    broken = written({"name": "nothing"}, tmp_path / "broken.yaml")
    outcome = run("check", broken)
    assert (outcome.code, outcome.out) == (2, "")
    assert run("check", "clavel-delta3", tmp_path / "no.csv").code == 2


def test_what_is_written_loads_and_is_better(tmp_path: Path) -> None:
    data = scaled(with_changes(as_written("clavel-delta3"), {"friction.drive1": None}), 1000)
    robot = written(data, tmp_path / "robot.yaml")
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    outcome = run("check", robot, "--write", first)
    assert outcome.code == 4
    assert f"wrote {first}" in outcome.out.replace("\n", "")
    first.write_text(f"# ours\n{first.read_text('utf-8')}", "utf-8")
    assert run("check", first, "--write", second).code == 3  # the friction is left
    assert second.read_text("utf-8").startswith("# ours\n")
    assert run("check", second).code == 0
    assert load_robot(second).limbs == load_robot("clavel-delta3").limbs


def test_nothing_proposed_is_said(tmp_path: Path) -> None:
    path = tmp_path / "fixed.yaml"
    outcome = run("check", "clavel-delta3", "--write", path)
    assert "nothing was written" in outcome.out
    assert not path.exists()


def test_json_has_all_fields(tmp_path: Path) -> None:
    outcome = run("check", changed_file(tmp_path, {"bodies.P.prior[0].mass": 1000.0}), "--json")
    value = json.loads(outcome.out)
    assert (value["robot"], value["grade"]) == ("clavel-delta3", "wrong")
    verdict = next(entry for entry in value["verdicts"] if entry["key"] == "prior-scale")
    assert set(verdict) == {
        "key", "grade", "subject", "seen", "number", "unit", "cause", "cure", "proposals"
    }  # fmt: skip
    assert verdict["proposals"] == [{"file": "robot", "changes": {"bodies.P.prior[0].mass": 1.0}}]


@pytest.mark.parametrize("width", [80, 200])
def test_lines_to_paste_are_yaml_of_the_whole_list(width: int, tmp_path: Path) -> None:
    outcome = run("check", changed_file(tmp_path, {"bodies.P.prior[0].mass": 1000.0}), width=width)
    lines = outcome.out.split("# into the robot file\n")[1]
    from ruamel.yaml import YAML

    pasted = YAML(typ="safe", pure=True).load(lines)
    assert pasted == {
        "bodies": {"P": {"prior": as_written("clavel-delta3")["bodies"]["P"]["prior"]}}
    }
    assert max(map(len, outcome.out.splitlines())) <= width


def test_report_holds_verdicts_and_lines(tmp_path: Path) -> None:
    path = tmp_path / "check.html"
    run("check", changed_file(tmp_path, {"bodies.P.prior[0].mass": 1000.0}), "--report", path)
    page = path.read_text(encoding="utf-8")
    assert "a mass in grams" in page
    assert "<pre" in page
    assert "Drawing of the robot: " in page


def test_the_page_of_a_description_that_cannot_be_read_has_no_drawing(tmp_path: Path) -> None:
    path = tmp_path / "check.html"
    robot = changed_file(tmp_path, {"limbs.strut": 800.0})  # mm, and no loop closes
    outcome = run("check", robot, "--report", path)
    assert outcome.code == 4
    page = path.read_text(encoding="utf-8")
    assert "Wrong: one thing to be corrected" in page
    assert "Drawing of the robot" not in page
    assert "limbs: {strut: 0.8}" in page


def test_mapping_and_robot_go_into_two_files(tmp_path: Path, monkeypatch: Any) -> None:
    """Proposals for both files, as several checks may make them."""
    log = tmp_path / "log.csv"
    rows = evidence(load_robot("clavel-delta3"), moved("clavel-delta3")).rows
    names = ["t", *(f"{kind}{i}" for kind in ("q", "tau") for i in (1, 2, 3))]
    columns = np.column_stack([rows.time, rows.q, rows.tau * [1, -1, 1]])
    np.savetxt(log, columns, delimiter=",", header=",".join(names), comments="")
    wrong = Verdict(
        "torque-sign", Grade.WRONG, "seen", proposals=(
            Proposal("mapping", (("torque[1].sign", -1),)),
            Proposal("robot", (("friction.drive1.coulomb", 6.0),)),
        ),
    )  # fmt: skip
    monkeypatch.setattr("deltaid.checks.check.of_recording", lambda *_: (wrong,))
    outcome = run("check", "clavel-delta3", log, "--write", tmp_path / "fixed.yaml")
    assert outcome.code == 4
    mapping = deltaid.load_mapping(tmp_path / "fixed-columns.yaml")
    assert mapping.torque is not None
    assert [column.sign for column in mapping.torque] == [1, -1, 1]
    assert mapping.position[0].unit == "rad"
    robot = load_robot(tmp_path / "fixed-robot.yaml")
    assert robot.friction["drive1"].coulomb == 6.0
    assert open_log(log, compiled(robot).kinematics, mapping).samples == len(rows.time)


def test_recordings_that_share_a_mapping_have_it_corrected(tmp_path: Path) -> None:
    frame = noisy(recorded(3000)).with_columns(tau2=-pl.col("tau2"))
    logs = [write(tmp_path / name, frame) for name in ("a.csv", "b.csv")]
    mapping, other = tmp_path / "columns.yaml", tmp_path / "other.yaml"
    for path in (mapping, other):
        path.write_text("# ours\ntorque: {columns: [tau1, tau2, tau3], unit: N m}\n", "utf-8")
    fixed = tmp_path / "fixed.yaml"
    given = ("check", "clavel-delta3", *logs, "--write", fixed, "--columns", mapping)
    apart = run(*given, "--columns", other)
    assert "check its recording alone" in apart.err
    assert not fixed.exists()
    assert run(*given).code == 4
    assert fixed.read_text("utf-8").startswith("# ours\n")
    cured = deltaid.check("clavel-delta3", logs, columns=mapping).cured_columns()
    assert cured.torque == deltaid.load_mapping(fixed).torque
    assert run("check", "clavel-delta3", *logs, "--columns", fixed).code in (0, 3)


def test_warnings_of_reading_are_printed_once_as_identify_prints_them(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", noisy(recorded(3000)))
    header, rows = log.read_text("utf-8").split("\n", 1)
    log.write_text(f"{header}\ns,rad,rad,rad,Nm,Nm,Nm\n{rows}", "utf-8")
    commands = ("check", "identify")
    outcomes = (run(command, "clavel-delta3", log) for command in commands)
    checked, identified = (" ".join(outcome.err.split()) for outcome in outcomes)
    assert checked.count("row 2 is taken for units (s, rad") == 1
    assert checked in identified  # which adds warnings of its fit
    verdicts = deltaid.check("clavel-delta3", log)
    assert any("row 2 is taken for units" in text for text in verdicts.warnings)
    page = tmp_path / "check.html"
    given = json.loads(run("check", "clavel-delta3", log, "--json", "--report", page).out)[
        "warnings"
    ]
    assert given == list(verdicts.warnings)
    assert "row 2 is taken for units" in page.read_text(encoding="utf-8")


def test_warnings_of_a_recording_that_is_refused_are_printed(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", recorded(60))
    header, rows = log.read_text("utf-8").split("\n", 1)
    log.write_text(f"{header}\ns,rad,rad,rad,Nm,Nm,Nm\n{rows}", "utf-8")
    outcome = run("check", "clavel-delta3", log)
    assert outcome.code == 4
    assert "row 2 is taken for units" in " ".join(outcome.err.split())


@pytest.mark.parametrize("gravity", [-9.81, 9.81])
def test_what_is_too_short_to_judge_columns_is_no_good_verdict(
    tmp_path: Path, gravity: float
) -> None:
    robot = changed_file(tmp_path, {"gravity": [0.0, 0.0, gravity]})
    log = write(tmp_path / "log.csv", moved("clavel-delta3").to_frame()[:750])
    outcome = run("check", robot, log, "--json")
    assert outcome.code in (3, 4)  # 4 where the fit reveals gravity
    (verdict,) = (v for v in json.loads(outcome.out)["verdicts"] if v["key"] == "drive-order")
    assert (verdict["grade"], verdict["number"]) == ("cannot tell", 2.996)
    assert "direction of gravity" in verdict["seen"]
    assert "record longer" in verdict["cure"]
    keys = {verdict.key for verdict in deltaid.identify(robot, log, force=True).verdicts}
    assert "drive-order" not in keys


# The page.


CODE = "\n".join(
    path.read_text(encoding="utf-8")
    for room in ("checks", "effects") for path in (ROOT / "src/deltaid" / room).rglob("*.py")
)  # fmt: skip


def test_the_page_lists_every_key_and_no_other() -> None:
    page = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    keys = [key for group in KEYS.values() for key in group]
    assert re.findall(r"^### `([a-z-]+)`", page, re.M) == keys
    assert re.findall(r"^## About (.*)$", page, re.M) == list(KEYS)
    for section in page.split("\n### ")[1:]:
        assert "```" in section, f"no example: {section[:30]}"


def test_every_key_is_said_somewhere_and_no_other() -> None:
    keys = {key for group in KEYS.values() for key in group}
    assert set(re.findall(r'Verdict\(\s*"([a-z-]+)"', CODE)) <= keys
    assert {key for key in keys if f'"{key}"' not in CODE} == set()


def test_what_is_good_is_one_line() -> None:
    short, full = run("check", "clavel-delta3"), run("check", "clavel-delta3", "--full")
    assert "friction" not in short.out
    assert re.fullmatch(r"\d+ good\n", short.out)
    assert full.out.startswith(f"{short.out}\n")
    assert full.out.count("good  ") > 4


def test_cause_and_fix_stand_below_what_was_detected(tmp_path: Path) -> None:
    robot = changed_file(tmp_path, {"bodies.P.prior[0].mass": 1000.0})
    lines = run("check", robot, "--full", terminal=True).out.splitlines()
    assert lines[0].startswith("1 wrong, ")
    assert lines[3].startswith("wrong  ")  # below the names of the columns: the most severe first
    below = [line.strip() for line in lines[4:]]
    cause = below.index("likely: a mass in grams")
    assert below[cause + 1].startswith("→ give kilograms and metres")
