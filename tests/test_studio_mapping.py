"""Columns of foreign recordings: what is proposed, and a mapping as the form edits it."""

from pathlib import Path

import numpy as np
import pytest

from deltaid.errors import DeltaidError
from deltaid.recording.contents import read_contents
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.proposed_mapping import Column, proposed_mapping
from deltaid.robot.load import parse
from deltaid.studio.edits import (
    entries,
    incomplete,
    read,
    with_column,
    with_time,
    with_value,
    written,
)
from deltaid.studio.look import mapping_cured, preview, signals
from foreign_logs import foreign, german
from logs import recorded

TURNING = (False, False, False)


def columns(*names: str, low: float = -1.0, high: float = 1.0, drives: int = 3) -> list[Column]:
    """A time and numbered columns, drive by drive."""
    numbered = [name.replace("#", str(i + 1)) for i in range(drives) for name in names]
    return [Column("time"), *(Column(name, low=low, high=high) for name in numbered)]


def test_what_was_asked_for_is_not_what_was_measured() -> None:
    found = proposed_mapping(columns("q#_desired", "tau#_cmd", "pos_error#"), TURNING)
    assert set(found.data) == {"time"}
    assert found.missing == ("position", "torque")
    found = proposed_mapping(columns("pos#_set", "pos#_act", "pos#", "torque#"), TURNING)
    names = [entry["column"] for entry in found.data["position"]]
    assert names == ["pos1_act", "pos2_act", "pos3_act"]


def test_numbers_of_another_count_of_drives_are_not_guessed() -> None:
    assert "position" not in proposed_mapping(columns("q#", drives=2), TURNING).data
    assert len(proposed_mapping(columns("q#", drives=4), TURNING).data["position"]) == 3


def test_degrees_are_recognised_by_their_size_and_the_reason_says_so() -> None:
    found = proposed_mapping(columns("pos#", "vel#", "torque#", low=-50.0, high=60.0), TURNING)
    assert found.data["position"][0]["unit"] == "deg"
    assert found.data["velocity"][0]["unit"] == "deg/s"  # as positions are
    assert any("up to 60, so degrees are assumed" in reason for reason in found.reasons)
    assert proposed_mapping(columns("pos#", high=6.2), TURNING).data["position"][0]["unit"] == "rad"


def test_a_stated_unit_is_taken() -> None:
    given = [Column("t", unit="ms"), *(Column(f"q{i}", unit="deg", high=1.0) for i in (1, 2, 3))]
    found = proposed_mapping(given, TURNING)
    assert found.data["time"] == {"column": "t", "unit": "ms"}
    assert found.data["position"][2] == {"column": "q3", "unit": "deg"}


def test_a_foreign_recording_is_read_as_it_was(tmp_path: Path) -> None:
    log = recorded(1500)
    path = str(foreign(tmp_path / "axes.csv", log))
    found = read_contents(path, TURNING)
    assert found.rows == 1500
    assert found.proposal.complete
    parse(written(found.proposal.data, "x"), ColumnMapping, where="x")
    seen = preview(path, "clavel-delta3", found.proposal.data)
    shown = [(curve.quantity, curve.unit) for curve in seen.curves]
    assert shown == 3 * [("position", "deg")] + 3 * [("torque", "N m")]
    np.testing.assert_allclose(seen.curves[1].values, np.rad2deg(log["q2"]), atol=1e-9)
    np.testing.assert_allclose(seen.curves[5].values, log["tau3"], atol=1e-9)
    np.testing.assert_allclose(seen.curves[0].time, log["t"], atol=1e-9)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeltaidError, match="no such file"):
        read_contents(str(tmp_path / "none.csv"), TURNING)
    (tmp_path / "words.csv").write_text("a,b\n1,x\n2,y\n")
    partly = read_contents(str(tmp_path / "words.csv"), TURNING)
    assert [(column.address, column.high) for column in partly.columns] == [("a", 2.0), ("b", None)]


def test_a_cure_goes_into_a_mapping_that_is_there_or_not(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    recorded(300).write_csv(path)
    wanted = [("torque[1].sign", -1)]
    text = mapping_cured(str(path), "clavel-delta3", None, wanted)
    data = read(text, "mapping.yaml")
    assert [entry.get("sign", 1) for entry in data["torque"]] == [1, -1, 1]
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(text)
    again = mapping_cured(str(path), "clavel-delta3", str(mapping), [("position[0].zero", 1.5)])
    mapping.write_text(again)
    read_back = load_mapping(mapping)
    assert isinstance(read_back.torque, tuple)
    assert isinstance(read_back.position, tuple)
    assert read_back.torque[1].sign == -1
    assert read_back.position[0].zero == 1.5


def test_one_value_changes_nothing_else() -> None:
    text = (
        "load: {column: held, name: box}\n"
        "position: {columns: [a, b, c], unit: deg, sign: [1, -1, 1], gear: 10}\n"
    )
    data = read(text, "mapping.yaml")
    changed = with_value(data, "position", 2, "sign", -1, 3, alike=True)
    assert changed["load"] == data["load"]
    assert [entry.get("sign", 1) for entry in changed["position"]] == [1, -1, -1]
    assert [entry["gear"] for entry in changed["position"]] == [10, 10, 10]
    changed = with_value(changed, "position", 0, "unit", "rad", 3, alike=True)
    assert [entry["unit"] for entry in changed["position"]] == ["rad", "rad", "rad"]
    changed = with_value(changed, "position", 0, "gear", 1.0, 3, alike=False)
    assert [entry.get("gear", 1) for entry in changed["position"]] == [1, 10, 10]
    assert data == read(text, "mapping.yaml")
    written(changed, "mapping.yaml")


DRIVES = ("drive1", "drive2", "drive3")
GERMAN = [
    "Zeitstempel [ms]",
    *(f"Istposition Achse {i} [°]" for i in (1, 2, 3)),
    *(f"Motorstrom Achse {i} [A]" for i in (1, 2, 3)),
]


def test_a_mapping_that_is_half_written_is_no_file_yet() -> None:
    data = with_value({}, "torque", 1, "column", "i2", 3, alike=True)
    assert incomplete(data, DRIVES) == "torque of drive1: choose its column"
    for drive in (0, 2):
        data = with_value(data, "torque", drive, "column", f"i{drive + 1}", 3, alike=True)
    assert incomplete(data, DRIVES) == "torque of drive1: choose its unit"
    data = with_value(data, "torque", 0, "unit", "A", 3, alike=True)
    assert incomplete(data, DRIVES) == "torque of drive1: a current in A needs its N m per A"
    data = with_value(data, "torque", 0, "torque_constant", 0.1, 3, alike=True)
    assert incomplete(data, DRIVES) == ""
    data = with_value(data, "torque", 1, "unit", "N m", 3, alike=False)
    assert incomplete(data, DRIVES) == "torque of drive2: N m is no current; clear its N m per A"
    data = with_value(data, "torque", 1, "unit", "rpm", 3, alike=False)
    assert incomplete(data, DRIVES) == "torque of drive2: rpm is no unit of torque"
    for drive in range(3):
        data = with_value(data, "torque", drive, "column", None, 3, alike=True)
    assert "torque" not in data
    # What a mapping does not name has its usual names, if the recording has columns of these.
    assert incomplete(data, DRIVES) == ""
    assert incomplete(data, DRIVES, GERMAN) == "position: choose the column of drive1"
    usual = ["t", *(f"{q}{i}" for q in ("q", "tau") for i in (1, 2, 3))]
    assert incomplete(data, DRIVES, usual) == ""


def test_one_chosen_column_brings_along_those_of_the_other_drives_and_their_unit() -> None:
    data = with_column({}, "torque", 1, GERMAN[5], GERMAN, 3, alike=True)
    assert data["torque"] == [{"column": name, "unit": "A"} for name in GERMAN[4:]]
    alone = with_column({}, "torque", 1, GERMAN[5], GERMAN, 3, alike=False)
    assert alone["torque"] == [{}, {"column": GERMAN[5], "unit": "A"}, {}]


def test_drives_are_alike_also_where_a_column_is_chosen_later() -> None:
    names = ["a", "b", "c"]
    data = with_column({}, "position", 0, "a", names, 3, alike=True)
    for key, value in (("unit", "rev"), ("gear", 20.0)):
        data = with_value(data, "position", 0, key, value, 3, alike=True)
    data = with_column(data, "position", 2, "c", names, 3, alike=True)
    shared = {"unit": "rev", "gear": 20.0}
    assert data["position"] == [{"column": "a"} | shared, {}, {"column": "c"} | shared]
    data = with_column(data, "position", 1, "b", names, 3, alike=False)
    assert data["position"][1] == {"column": "b"}


def test_signals_are_drawn_before_any_column_is_mapped(tmp_path: Path) -> None:
    log = recorded(500)
    path = str(german(tmp_path / "log.csv", log))
    seen = signals(path, GERMAN[0], GERMAN[1:])
    stems = [curve.quantity for curve in seen.curves]
    assert stems == 3 * ["Istposition Achse … [°]"] + 3 * ["Motorstrom Achse … [A]"]
    np.testing.assert_allclose(seen.curves[0].time, 1e3 * log["t"], atol=1e-6)
    np.testing.assert_allclose(seen.curves[2].values, np.rad2deg(20 * log["q3"]), atol=1e-5)
    np.testing.assert_array_equal(signals(path, None, GERMAN[1:2]).curves[0].time, np.arange(500))


def test_time_is_a_column_with_a_unit_or_a_rate() -> None:
    assert with_time({}, "t", "ms", None) == {"time": {"column": "t", "unit": "ms"}}
    assert with_time({}, "count", "ms", 1000.0) == {"time": {"column": "count", "rate": 1000.0}}
    assert with_time({"time": {"column": "t"}}, None, "s", 500.0) == {"time": {"rate": 500.0}}
    assert with_time({"time": {"column": "t"}}, None, "s", None) == {}
    assert entries({}, "torque", 2) == [{}, {}]


def test_a_mapping_that_may_not_be_is_refused_with_its_place() -> None:
    with pytest.raises(DeltaidError, match="gear"):
        written({"position": [{"column": "a", "unit": "deg", "gear": -1.0}]}, "mapping.yaml")
