"""Fixes keep a user's file: every line that is not fixed stays as it is, character by character."""

import difflib
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import run
from deltaid.robot.load import catalogue, catalogue_text, described_in, plain_data
from deltaid.robot.yaml_edit import edited, with_changes
from logs import recorded

FILE = """\
# The robot of cell 3.
name:   cell-3      # as on the plate
limbs:
    upper_arm: 0.350 # m, measured
    strut:     800   # to the centres
    radii: {base: 0.2, platform: 0.0450}   # drawing 17
friction:
    drive1: {viscous: 1.0e-2, coulomb: 0.30}

# Limits of the supplier.
position:
  - column: "Axis 1"
    unit: deg
  - {column: Axis 2, unit: deg}
"""


def lines_changed(before: str, after: str) -> list[str]:
    pairs = difflib.ndiff(before.splitlines(), after.splitlines())
    return [line[0] + line[2:] for line in pairs if line[:1] in "+-"]


@pytest.mark.parametrize(
    ("path", "value", "changed"),
    [
        ("limbs.strut", 0.8, ["-    strut:     800   # to the centres",
                              "+    strut:     0.8   # to the centres"]),
        ("limbs.radii.platform", 0.05, ["-    radii: {base: 0.2, platform: 0.0450}   # drawing 17",
                                        "+    radii: {base: 0.2, platform: 0.05}   # drawing 17"]),
        ("friction.drive2", {"viscous": 0.1}, ["+    drive2: {viscous: 0.1}"]),
        ("position[0].sign", -1, ["+    sign: -1"]),
        ("position[1].sign", -1, ["-  - {column: Axis 2, unit: deg}",
                                  "+  - {column: Axis 2, unit: deg, sign: -1}"]),
        ("position[1].unit", None, ["-  - {column: Axis 2, unit: deg}", "+  - {column: Axis 2}"]),
        ("position[0].unit", None, ["-    unit: deg"]),
        ("gravity", [0.0, 0.1, -9.8], ["+gravity: [0.0, 0.1, -9.8]"]),
    ],
)  # fmt: skip
def test_one_value_changes_one_line(path: str, value: object, changed: list[str]) -> None:
    data = plain_data(FILE, "file")
    after = edited(FILE, {path: value}, with_changes(data, {path: value}), "file")
    assert lines_changed(FILE, after) == changed
    assert plain_data(after, "file") == with_changes(data, {path: value})


def test_what_cannot_be_edited_in_place_keeps_its_comments() -> None:
    text = "a: &same 1.50 # first\nb: *same\nc:\n- 1 # one\n- 2\n"
    change: dict[str, object] = {"a": 2.0, "c": [3]}
    after = edited(text, change, with_changes(plain_data(text, "x"), change), "x")
    assert plain_data(after, "x") == {"a": 2.0, "b": 1.5, "c": [3]}
    assert "# first" in after


@pytest.mark.parametrize("robot", catalogue())
def test_a_catalogue_robot_keeps_every_other_line(robot: str) -> None:
    text = catalogue_text(robot)
    data = plain_data(text, robot)
    for path, value in (("platform_speed", 1.25), ("friction.drive1.viscous", 0.125)):
        after = edited(text, {path: value}, with_changes(data, {path: value}), robot)
        assert len(lines_changed(text, after)) <= 2
        assert plain_data(after, robot) == with_changes(data, {path: value})
        described_in(after, robot)


def test_check_changes_only_the_lines_that_it_fixes(tmp_path: Path) -> None:
    log, mapping, fixed = tmp_path / "log.csv", tmp_path / "own.yaml", tmp_path / "fixed.yaml"
    recorded(3000).with_columns(tau2=-pl.col("tau2"), q2=np.rad2deg(1) * pl.col("q2")).write_csv(
        log
    )
    text = (
        "# drives of cell 3, by Ada\n"
        "torque:\n"
        "- {column: tau1, unit: N m, gear: 1.00}  # calibrated in May\n"
        "- {column: tau2, unit: N m, gear: 1.00}\n"
        "- {column: tau3, unit: N m, gear: 1.00}\n"
        "time: {column: t, unit: s}\n"
        "position:   # encoders\n"
        "- {column: q1, unit: rad}\n"
        "- {column: q2, unit: deg}   # of the old maker\n"
        "- {column: q3, unit: rad}\n"
    )
    mapping.write_text(text)
    run("check", "clavel-delta3", log, "--columns", mapping, "--write", fixed)
    assert lines_changed(text, fixed.read_text()) == [
        "-- {column: tau2, unit: N m, gear: 1.00}",
        "+- {column: tau2, unit: N m, gear: 1.00, sign: -1}",
    ]
