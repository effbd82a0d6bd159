"""Mappings proposed for headers from public sources, and what numbers settle."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from ruamel.yaml import YAML

import deltaid
from command import run
from deltaid.errors import RecordingError
from deltaid.recording.mapping import MappingProposal, load_mapping
from deltaid.recording.proposed_mapping import Column, proposed_mapping
from deltaid.recording.table import open_table
from foreign_logs import GEAR, TORQUE_CONSTANT, german
from logs import recorded

HEADERS = Path(__file__).parent / "data" / "column_headers.yaml"
SETS: list[dict[str, Any]] = YAML(typ="safe").load(HEADERS.read_text(encoding="utf-8"))
QUANTITIES = ("time", "position", "velocity", "acceleration", "torque")
# The share of headers that must be read without a mistake; a wrong unit is allowed in none.
LEAST = 0.9


def proposed(header: dict[str, Any]) -> MappingProposal:
    """What is proposed for a header alone, without numbers."""
    axes = header["axes"].split()
    names = [name for axis in axes for name in named(header["columns"], axis)]
    return proposed_mapping([Column(name) for name in dict.fromkeys(names)], [False] * len(axes))


def named(names: list[str], axis: str) -> list[str]:
    return [name.replace("@", axis) for name in names]


def mistakes(header: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Wrong columns, and units that are wrong and not said to be assumed."""
    found = {part.quantity: part for part in proposed(header).found}
    columns, units = list[str](), list[str]()
    axes = header["axes"].split()
    for quantity in QUANTITIES:
        part = found.get(quantity)
        if quantity not in header:
            columns += [f"{quantity} is {part.columns[0]}"] if part else []
            continue
        name, unit = header[quantity]
        right = tuple(name.replace("@", axis) for axis in (axes if "@" in name else axes[:1]))
        others = named(header.get("or", []), axes[0])
        if part is None:
            columns.append(f"{quantity} is not found")
        elif part.columns == right or (part.columns[0] in others and part.doubts):
            units += wrong_units(quantity, unit, part) if part.columns == right else []
        else:
            columns.append(f"{quantity} is {part.columns[0]}")
    return columns, units


def wrong_units(quantity: str, unit: str, part: Any) -> list[str]:
    is_right = (
        bool(part.assumed)
        if unit.endswith("?")
        else not any(part.units)
        if unit == "-"
        else {*part.units} == {unit} and not part.assumed
    )
    return [] if is_right else [f"{quantity}: {part.units} for {unit}, assumed: {part.assumed}"]


# Headers of issues and of programs, which name positions and torques of three drives; their units.
TOLD = [
    (("Zeitstempel [ms]", "Istposition Achse # [°]", "Motorstrom Achse # [A]"), "ms deg A"),
    (("t", "Lageistwert #", "Momentenistwert #"), "s? rad? N m?"),
    (("Temps", "Position axe #", "Couple axe #"), "s? rad? N m?"),
    (("時刻", "位置#", "トルク#"), "s? rad? N m?"),
    (("时间", "关节#角度", "关节#力矩"), "s? rad? N m?"),
    (("t", "actualPosition_A#", "actualTorque_A#"), "s? rad? N m?"),
    (("time", "Winkel# [Grad]", "Drehmoment# [Nm]"), "s? deg N m"),
    (("time", "winkel# [rad]", "drehmoment# [mN*m]"), "s? rad mN*m"),
    (("time", "Axis#.ActPos", "Axis#.ActTorque"), "s? rad? N m?"),
    (("time", "q_meas_#", "tau_meas_#"), "s? rad? N m?"),
    (("time", "J#_angle_rad", "J#_current_A"), "s? rad A"),
    (("time", "/drives/motor#/position", "/drives/motor#/effort"), "s? rad? N m?"),
    (("time", "actualPosition#", "actualTorque#"), "s? rad? N m?"),
]


@pytest.mark.parametrize(("names", "units"), TOLD)
def test_headers_in_five_languages_are_read(names: tuple[str, str, str], units: str) -> None:
    time, position, torque = names
    listed = [name.replace("#", str(axis)) for name in (position, torque) for axis in (1, 2, 3)]
    found = proposed_mapping([Column(name) for name in (time, *listed)], [False] * 3).found
    assert [part.quantity for part in found] == ["time", "position", "torque"]
    assert [list(part.columns) for part in found] == [[time], listed[:3], listed[3:]]
    said = " ".join(part.unit + "?" * bool(part.assumed) for part in found)
    assert said == units


def test_headers_from_public_sources_are_read() -> None:
    assert len(SETS) >= 40
    read = {header["source"]: mistakes(header) for header in SETS}
    assert {source: units for source, (_, units) in read.items() if units} == {}
    wrong = {source: columns for source, (columns, _) in read.items() if columns}
    assert len(wrong) <= (1 - LEAST) * len(SETS), wrong


def moving(position: str, velocity: str, scale: float, rate: float, step: float) -> pl.DataFrame:
    """Three drives whose positions are rad times a scale, their velocities rad/s times another."""
    t = np.arange(4000) * 1e-3
    phases = [t * (5 + k) + k for k in range(3)]
    columns = {"time": t / step}
    columns |= {f"{position}{k + 1}": scale * np.sin(phases[k]) for k in range(3)}
    columns |= {f"{velocity}{k + 1}": rate * (5 + k) * np.cos(phases[k]) for k in range(3)}
    columns |= {f"torque{k + 1} [Nm]": np.cos(phases[k]) for k in range(3)}
    return pl.DataFrame(columns)


def test_a_velocity_in_a_stated_unit_settles_the_unit_of_positions() -> None:
    table = moving("pos", "speed [rpm] ", np.rad2deg(1), 30 / np.pi, 1.0)
    found = deltaid.columns(table, "clavel-delta3")
    assert found.data["position"][0] == {"column": "pos1", "unit": "deg"}
    assert found.certain, found.doubts
    assert any("deg follows" in reason for reason in found.reasons)


def test_positions_settle_the_unit_of_velocities_and_of_time() -> None:
    found = deltaid.columns(moving("pos [deg] ", "speed", np.rad2deg(1), 1.0, 1.0))
    assert found.data["velocity"][0]["unit"] == "rad/s"
    assert found.certain, found.doubts
    # Steps of 1 may be ms or cycles, unless velocities say it.
    found = deltaid.columns(moving("q [rad] ", "qd [rad/s] ", 1.0, 1.0, 1e-3))
    assert found.data["time"] == {"column": "time", "unit": "ms"}
    assert found.certain, found.doubts
    alone = moving("q [rad] ", "qd [rad/s] ", 1.0, 1.0, 1e-3).select(pl.exclude("^qd.*$"))
    assert deltaid.columns(alone).doubts == ("time: seconds are assumed, for no unit is stated",)


def test_a_velocity_behind_a_gear_is_in_doubt() -> None:
    found = deltaid.columns(moving("q [rad] ", "qd [rad/s] ", 1.0, 50.0, 1.0))
    assert not found.certain
    assert "0.02 times" in found.doubts[0]
    assert "gear" in found.doubts[0]


def test_what_two_units_explain_is_in_doubt() -> None:
    found = deltaid.columns(moving("pos", "speed", np.rad2deg(1), np.rad2deg(1), 1.0))
    assert [doubt.partition(":")[0] for doubt in found.doubts] == ["position", "velocity"]


def test_a_column_that_runs_backwards_is_no_time_and_a_constant_hardly_a_torque() -> None:
    table = moving("q [rad] ", "qd [rad/s] ", 1.0, 1.0, 1.0)
    wrong = table.with_columns(time=table["time"].reverse())
    assert "time" in deltaid.columns(wrong).missing
    still = table.with_columns(pl.lit(0.0).alias(f"torque{k} [Nm]") for k in (1, 2, 3))
    assert "do not change" in deltaid.columns(still).doubts[0]
    moved = still.with_columns(table[f"torque{k} [Nm]"].alias(f"Trq {k} [Nm] x") for k in (1, 2, 3))
    assert deltaid.columns(moved).data["torque"][0]["column"] == "Trq 1 [Nm] x"


def test_arrays_under_default_names_have_default_units(tmp_path: Path) -> None:
    log, path = recorded(1500), tmp_path / "log.npz"
    arrays = {name: log.select(f"{name}{i}" for i in (1, 2, 3)) for name in ("q", "tau")}
    np.savez(path, t=log["t"], **{name: table.to_numpy() for name, table in arrays.items()})
    found = deltaid.columns(str(path), "clavel-delta3")
    assert found.certain, found.doubts
    assert found.data["torque"][2] == {"column": "tau[2]", "unit": "N m"}


def test_text_of_dates_is_a_time(tmp_path: Path) -> None:
    path, clock = foreign(tmp_path / "log.csv"), "2026-03-01T10:00:{:09.6f}"
    head, *rows = path.read_text().splitlines()
    seconds = [float(row.rpartition(",")[2]) for row in rows]
    rows = [
        f"{row.rpartition(',')[0]},{clock.format(s)}" for row, s in zip(rows, seconds, strict=True)
    ]
    path.write_text("\n".join([head.replace("time [s]", "Timestamp"), *rows]) + "\n")
    found = deltaid.columns(str(path), "clavel-delta3")
    assert found.certain, found.doubts
    assert found.data["time"] == {"column": "Timestamp"}


def test_a_row_without_numbers_hides_no_time(tmp_path: Path) -> None:
    head, *rows = foreign(tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([head, *rows[:900], head, *rows[900:]]) + "\n")
    assert deltaid.columns(str(tmp_path / "log.csv"), "clavel-delta3").missing == ()


@pytest.mark.parametrize(
    ("name", "words"), [("commas", "row 2: has 8 fields"), ("cut", "row 3001: has 1 fields")]
)
def test_a_file_that_cannot_be_read_has_no_proposal(tmp_path: Path, name: str, words: str) -> None:
    path = foreign(tmp_path / "log.csv")
    head, *rows = path.read_text().splitlines()
    if name == "commas":
        rows = [f"{row}," for row in rows]
    else:
        rows[-1] = rows[-1][:5]
    path.write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(RecordingError, match=words):
        deltaid.columns(str(path), "clavel-delta3")


def foreign(path: Path, angle: str = " [deg]", units: str = "") -> Path:
    """A recording of a Delta robot under other names, and a row of units if there is one."""
    log, degrees = recorded(3000), np.rad2deg(1)
    names = {f"q{k}": f"Axis {k}.ActPos{angle}" for k in (1, 2, 3)}
    names |= {f"tau{k}": f"Axis {k}.ActTorque [Nm]" for k in (1, 2, 3)} | {"t": "time [s]"}
    turned = log.with_columns(pl.col("q1", "q2", "q3") * degrees).select([*names])
    text = turned.rename(names).write_csv()
    head, _, rows = text.partition("\n")
    path.write_text("\n".join([head, *([units] if units else []), rows]))
    return path


def test_columns_that_are_certain_are_used_and_it_is_said(tmp_path: Path) -> None:
    path = foreign(tmp_path / "axes.csv")
    seen = deltaid.check("clavel-delta3", path)
    assert [str(mapping and mapping.source) for mapping in seen.mappings] == ["columns found"]
    assert "refused" not in {verdict.key for verdict in seen}
    found = run("torque", "clavel-delta3", path, "-o", tmp_path / "torques.csv")
    assert "columns are found: time time [s]" in " ".join(found.err.split())
    found = " ".join(run("check", "clavel-delta3", path).err.split())
    assert found.count("columns are found: time time [s]") == 1
    assert f"`deltaid columns {path} clavel-delta3` says why" in found


def test_columns_in_doubt_are_not_used_but_proposed(tmp_path: Path) -> None:
    path = foreign(tmp_path / "axes.csv", angle="")
    with pytest.raises(RecordingError, match=r"deltaid columns .*axes\.csv ROBOT` proposes"):
        deltaid.check("clavel-delta3", path)


def test_a_row_of_units_below_foreign_names_is_read(tmp_path: Path) -> None:
    path = foreign(tmp_path / "axes.csv", angle="", units="°,°,°,N*m,N*m,N*m,s")
    found = deltaid.columns(path, "clavel-delta3")
    assert found.certain, found.doubts
    assert found.data["position"][2] == {"column": "Axis 3.ActPos", "unit": "deg"}


@pytest.mark.parametrize("units", ["", "°,°,°,N*m,N*m,N*m,s"])
def test_foreign_names_below_a_preamble_are_read(tmp_path: Path, units: str) -> None:
    path = foreign(tmp_path / "axes.csv", units=units)
    path.write_text("Project,cell 3\nDate,2026-11-01,10:00:00\n\n" + path.read_text())
    found = deltaid.columns(path, "clavel-delta3")
    assert found.certain, found
    assert found.data["position"][1] == {"column": "Axis 2.ActPos [deg]", "unit": "deg"}
    assert len(deltaid.check("clavel-delta3", path)) > 10


def test_the_command_writes_what_a_check_takes(tmp_path: Path) -> None:
    path, mapping = foreign(tmp_path / "axes.csv", angle=""), tmp_path / "columns.yaml"
    asked = ("columns", path, "clavel-delta3", "-o", mapping)
    found = run(*asked, terminal=True)
    assert found.code == 3
    assert "in doubt: numbers go up to" in found.out
    assert "\n→ write it (-o columns.yaml), check it" in found.out
    assert "degrees are assumed" in " ".join(found.out.split())
    lines = [line for line in found.out.splitlines() if str(tmp_path) not in line]
    assert max(map(len, lines)) <= 80
    assert run(*asked, "--unit", "position=deg").code == 0
    assert [entry.unit for entry in load_mapping(mapping).position] == ["deg"] * 3


def test_a_mapping_that_lacks_something_is_not_written(tmp_path: Path) -> None:
    path, mapping = tmp_path / "axes.csv", tmp_path / "columns.yaml"
    names = ("t [s]", *(f"q{k} [rad]" for k in (1, 2, 3)), *(f"torque{k} [%]" for k in (1, 2, 3)))
    path.write_text(",".join(names) + "\n0,0,1,2,3,4,5\n0.1,1,2,3,4,5,6\n")
    refused = run("columns", path, "clavel-delta3", "-o", mapping)
    assert refused.code == 2
    assert "unit of torque not found" in refused.err
    assert not mapping.exists()
    wrong = run("columns", path, "--unit", "torque=deg")
    assert wrong.code == 2
    assert "'deg' is no unit of torque" in wrong.err
    asked = ("columns", path, "clavel-delta3", "-o", mapping)
    assert run(*asked, "--unit", "torque=0.0235 N*m").code == 0
    assert load_mapping(mapping).torque[0].unit == "0.0235 N*m"


def test_columns_tell_the_number_of_drives_where_no_robot_does(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    names = "Time [ms],Axis1.ActPos,Axis2.ActPos,Axis1.Trq,Axis2.Trq"
    path.write_text(f"{names}\n0,90,1,2,3\n1,1,1,2,3\n")
    found = deltaid.columns(path)
    assert found.complete
    assert [column.unit for column in found.mapping.position] == ["deg", "deg"]
    assert "torque" in deltaid.columns(path, "clavel-delta3").missing  # it has three drives


def test_motor_columns_take_gear_and_torque_constant(tmp_path: Path) -> None:
    names = ["Zeit [s]", *(f"{name} {k} [{unit}]" for name, unit in
             (("Istwinkel", "rad"), ("Motorstrom", "A")) for k in (1, 2, 3))]  # fmt: skip
    columns = [Column(name) for name in names]
    assert proposed_mapping(columns, [False] * 3).missing == ("torque_constant",)
    path = tmp_path / "log.csv"
    path.write_text(",".join(names) + "\n0,0,1,2,3,4,5\n0.1,1,2,3,4,5,6\n")
    found = deltaid.columns(path, gear=50, torque_constant=0.1)
    assert found.data["torque"][0] | {"column": ""} == {
        "column": "", "unit": "A", "gear": 50, "torque_constant": 0.1
    }  # fmt: skip
    assert found.data["position"][2]["gear"] == 50


def test_from_a_foreign_log_to_feed_forward_without_a_line_of_yaml(tmp_path: Path) -> None:
    """Drive 2 is counted the other way, and the file is in the code page of Windows."""
    first = german(tmp_path / "Messung1.csv", recorded(9000)[:6000], turned=2)
    first.write_text(first.read_text("utf-8"), "cp1252")
    second = german(tmp_path / "Messung2.csv", recorded(9000)[6000:], turned=2)
    found, fixed = tmp_path / "found.yaml", tmp_path / "fixed.yaml"
    model, torques = tmp_path / "model.yaml", tmp_path / "feed-forward.csv"
    robot, motor = "clavel-delta3", ("--gear", GEAR, "--torque-constant", TORQUE_CONSTANT)
    assert run("columns", first, robot, *motor, "-o", found).code == 0
    seen = run("check", robot, first, "--columns", found, "--write", fixed)
    assert "turn the sign of its position and torque column" in " ".join(seen.out.split())
    both = ("--columns", fixed, "--verify", second)
    assert run("identify", robot, first, *both, "-o", model).code == 0
    assert run("torque", model, second, "--columns", fixed, "-o", torques).code == 0
    wanted = recorded(9000)[6000:]["tau2"].to_numpy()
    given = pl.read_csv(torques).drop_nulls()
    rows = (given["t"] * 1000 - 6000).round().cast(int).to_numpy()
    error = given["tau2"].to_numpy() - wanted[rows]
    assert np.std(error) < 0.02 * np.std(wanted)


def test_a_name_that_stands_twice_is_named_with_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(recorded(300).write_csv().replace("q2", "q1", 1))
    result = run("columns", path, "clavel-delta3")
    assert "missing: position" in result.out
    assert "log.csv: has 2 columns called q1 (columns 2 and 3)" in result.err
    path.write_text(recorded(300).with_columns(x="t").write_csv().replace("x", "tau1", 1))
    proposal = deltaid.columns(path, "clavel-delta3")
    assert proposal.doubts == ("torque: has 2 columns called tau1 (columns 5 and 8)",)
    assert not proposal.certain


@pytest.mark.parametrize("hint", ["sep=,\n", "SEP=,\r\n", '"sep=,"\n', "\ufeffsep=,\n"])
def test_a_hint_at_the_separator_is_no_preamble(tmp_path: Path, hint: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes((hint + recorded(300).write_csv()).encode())
    table = open_table(path)
    assert (table.warnings, table.first_row) == ((), 3)


def test_counts_and_per_mille_are_not_certain_under_any_name() -> None:
    counts = [(pl.col(f"q{i}") * 1e5).round() for i in (1, 2, 3)]
    mille = [(pl.col(f"tau{i}") * 50).round() for i in (1, 2, 3)]
    table, counted = recorded(), recorded().with_columns(*counts, *mille)
    stated = {"position": "360/65536 deg", "torque": "0.02 N*m"}
    assert deltaid.columns(counted, "clavel-delta3", units=stated).certain
    found = deltaid.columns(counted, "clavel-delta3")
    assert "unit of position" in found.missing
    assert any("counts of an encoder" in doubt for doubt in found.doubts)
    assert any("per mille" in doubt for doubt in found.doubts)
    degrees = [pl.col(f"q{i}").degrees() for i in (1, 2, 3)]
    found = deltaid.columns(table.with_columns(*degrees), "clavel-delta3")
    assert found.data["position"][0] == {"column": "q1", "unit": "deg"}
    assert not found.certain
    assert deltaid.columns(table, "clavel-delta3").certain
    turning = pl.lit(np.linspace(0.0, 20.0, table.height)).alias("q3")  # of a shaft
    assert deltaid.columns(table.with_columns(turning), "clavel-delta3").certain
