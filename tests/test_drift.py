"""Drift of a robot from factor files: friction with bodies held, findings, tables, command."""

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import accepted, json_of, refused
from deltaid.cli.gather import drift_settings
from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.drift_tables import DRIFT, FRICTION, drift_table, friction_table, save
from deltaid.fleets.factor_file import ENDING, FactorFile, write
from deltaid.fleets.gather import gathered
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.robot_drift import DriftRecording, RobotDrift, recorded, robot_drift
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapped_columns import TemperatureColumn
from deltaid.recording.mapping import ColumnMapping
from drifting import ROBOT, SETTINGS, START, days, one_recording, recording

COUNT, ONSET, TOOL = 90, 40, 55
RNG = np.random.default_rng(8)
WARM = 25.0 + 4.0 * np.sin(np.arange(COUNT) / 30) + 2.0 * RNG.standard_normal(COUNT)
SCATTER = 0.005 * RNG.standard_normal((COUNT, 3))
SLOPE = -0.01


def _share(day: int) -> np.ndarray:
    """The second drive's friction rises by 3 % a month."""
    rise = np.array([0.0, 0.03 / 30.4375 * max(day - ONSET, 0), 0.0])
    return np.expm1(rise + SLOPE * (WARM[day] - 25.0) + SCATTER[day])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> FactorFile:
    return one_recording(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def months(file: FactorFile) -> list[DriftRecording]:
    def held(day: int) -> float:
        return 0.12 if day >= TOOL else 0.0

    return days(file, COUNT, _share, held=held, temperature=lambda day: float(WARM[day]))


@pytest.fixture(scope="module")
def model(months: list[DriftRecording]) -> IdentifiedModel:
    return identify_gathered(ROBOT, [month.file for month in months[:10]], SETTINGS).model


@pytest.fixture(scope="module")
def drift(months: list[DriftRecording], model: IdentifiedModel) -> RobotDrift:
    return robot_drift(months, model, DriftSettings(limit=1.5))


def test_the_drive_that_drifts_is_found_and_no_other(drift: RobotDrift) -> None:
    assert [finding.state for finding in drift.findings] == ["steady", "rising", "steady"]
    rising = drift.findings[1]
    low, high = drift.date(rising.change.low), drift.date(rising.change.high)
    assert low <= START + timedelta(days=ONSET) <= high
    assert rising.rate.low < 0.03 < rising.rate.high
    truth = START + timedelta(days=ONSET + 30.4375 * np.log(1.5) / 0.03)
    assert drift.date(rising.horizon.low) < truth < drift.date(rising.horizon.high)
    assert "0.1 a robot-year over 3 drives" in drift.bound
    for finding in drift.findings:
        assert finding.temperature.low < SLOPE < finding.temperature.high
        assert 0.003 < finding.scatter < 0.012


def test_friction_is_that_of_the_day(drift: RobotDrift, model: IdentifiedModel) -> None:
    """Within a recording's own noise, however far the model's bodies are off."""
    expected = np.array([1.0 + _share(day) for day in range(COUNT)]).T
    ratio = drift.friction.mean / expected
    assert np.all(np.abs(ratio / ratio.mean(axis=1, keepdims=True) - 1.0) < 2e-3)
    assert np.all(drift.friction.std / drift.friction.mean < 0.01)
    curves = {friction_curve.joint: friction_curve for friction_curve in model.friction_curves}
    for drive, level in zip(drift.drives, drift.friction.mean[:, 0], strict=True):
        assert min(map(abs, curves[drive].friction)) < level < max(map(abs, curves[drive].friction))


def test_a_tool_that_nobody_declared_is_no_friction(drift: RobotDrift) -> None:
    assert [tool.day for tool in drift.tools] == [float(TOOL)]
    assert drift.tools[0].mass == pytest.approx(0.12, rel=0.1)
    table = drift_table(drift)
    assert table["tool_change"].to_list() == [START + timedelta(days=TOOL)] * 3


def test_order_does_not_matter(drift: RobotDrift, months, model: IdentifiedModel) -> None:
    again = robot_drift(months[::-1], model, DriftSettings(limit=1.5))
    assert drift_table(again).equals(drift_table(drift))


def test_deviations_are_those_of_seeds(file: FactorFile, tmp_path: Path, model) -> None:
    """Recordings of one robot on other motions with other noise scatter as they say."""
    own = [DriftRecording(one_recording(tmp_path, seed), START + timedelta(days=seed)) for seed in
           range(1, 4)]  # fmt: skip
    found = robot_drift(own, model).friction
    z = (found.mean - found.mean.mean(axis=1, keepdims=True)) / found.std
    assert 0.4 < np.sqrt(np.sum(z**2) / (3 * 2)) < 1.9


def test_since_leaves_out_and_too_few_say_nothing(months, model: IdentifiedModel) -> None:
    late = START + timedelta(days=COUNT - 8)
    found = robot_drift(months, model, DriftSettings(since=late))
    assert {finding.state for finding in found.findings} == {"unknown"}
    assert found.findings[0].recordings == 8
    with pytest.raises(RecordingError, match="none since"):
        robot_drift(months, model, DriftSettings(since=START + timedelta(days=400)))


def test_a_step_in_eight_files_is_reported(file: FactorFile, model: IdentifiedModel) -> None:
    """By 30 %, four recordings before it and four after."""
    rng = np.random.default_rng(2)
    scatter = 0.007 * rng.standard_normal((8, 3))
    files = days(file, 8, lambda k: [0.3 * (k >= 4), 0, 0] + scatter[k])
    first, *others = robot_drift(files, model).findings
    assert first.state == "stepped"
    assert 0.25 < first.step.low < 0.3 < first.step.high < 0.35
    assert {other.state for other in others} == {"unknown"}


def test_tables_are_tidy(drift: RobotDrift, tmp_path: Path) -> None:
    friction, table = friction_table(drift), drift_table(drift)
    assert dict(friction.schema) == FRICTION
    assert dict(table.schema) == DRIFT
    assert len(friction) == COUNT * 3 * 3
    assert set(friction["quantity"]) == {"friction", "viscous", "coulomb"}
    for name in ("a.parquet", "a.csv"):
        save(table, tmp_path / name)
    assert pl.read_parquet(tmp_path / "a.parquet").equals(table)
    with pytest.raises(DeltaidError, match="must end in"):
        save(drift, tmp_path / "a.xlsx")


def test_times_come_from_names_or_stamps(file: FactorFile, months) -> None:
    found = recorded([month.file for month in months[5:2:-1]])
    assert [recording.time for recording in found] == [
        START + timedelta(days=day) for day in (3, 4, 5)
    ]
    stamped = replace(file, record=file.record.changed(first=1.8e9))
    assert recorded([stamped])[0].time == datetime(2027, 1, 15, 8)
    with pytest.raises(RecordingError, match="nothing says when"):
        recorded([file])


def test_of_several_dates_in_a_name_the_last_that_exists_counts_as_in_a_fleet(
    file: FactorFile,
) -> None:
    def named(name: str) -> FactorFile:
        model = file.record.model
        model = model.changed(sources=(model.sources[0].changed(log=name),))
        return replace(file, record=file.record.changed(model=model))

    found = recorded([named("2025-02-01 copy 2025-03-01 of 2026-02-30")])
    assert found[0].time == datetime(2025, 3, 1)
    with pytest.raises(RecordingError, match="the date in 2026-02-30 is none"):
        recorded([named("2026-02-30")])


@pytest.fixture(scope="module")
def folder(months: list[DriftRecording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("factors")
    for month in months[:30]:
        write(month.file, path / f"{month.time:%m%d}{ENDING}")
    return path


def test_the_command(folder: Path, model: IdentifiedModel, tmp_path: Path) -> None:
    model.save(tmp_path / "model.yaml")
    out = tmp_path / "drift.parquet"
    done = accepted(
        "drift", tmp_path / "model.yaml", folder, "--limit", "1.5", "-o", out, width=160
    )
    assert "30 recordings, 2026-01-01 to 2026-01-30" in done.out
    assert "at most 0.1 a robot-year" in done.out
    assert "no temperature" in done.out
    assert len(pl.read_parquet(out)) == 3
    report = json_of("drift", ROBOT, folder)
    assert report["recordings"] == 30
    assert [drive["drive"] for drive in report["drives"]]
    assert report["drives"][0]["state"] in ("steady", "unknown")


def test_what_the_command_refuses(folder: Path, tmp_path: Path) -> None:
    words = "must end in .parquet or .csv"
    assert words in refused("drift", ROBOT, folder, "-o", "drift.xlsx", folder=tmp_path)
    assert "holds no factor files" in refused("drift", ROBOT, tmp_path, folder=tmp_path)


def test_a_recorded_temperature_is_kept(tmp_path: Path) -> None:
    """In °C, whatever the unit of its column."""
    log = tmp_path / "log.parquet"
    table = recording(0)
    kelvin = np.linspace(300.15, 304.15, len(table))
    table.with_columns(oil=kelvin).write_parquet(log)
    columns = ColumnMapping(temperature=TemperatureColumn(column="oil", unit="K"))
    known = gathered(ROBOT, log, columns=columns, settings=SETTINGS)
    found = known.record.temperature
    assert found.mean == pytest.approx(29.0, abs=0.2)
    assert found.low == pytest.approx(27.0, abs=0.5)
    assert found.high == pytest.approx(31.0, abs=0.5)
    assert DriftRecording(known, START).degrees == found.mean
    assert DriftRecording(known, START, temperature=20.0).degrees == 20.0
    unknown = replace(known, record=known.record.changed(temperature=None))
    assert np.isnan(DriftRecording(unknown, START).degrees)


@pytest.mark.parametrize(
    ("limit", "number", "kind"),
    [
        (None, None, "share"),
        ("1.5", 1.5, "share"),
        ("12Nm", 12.0, "torque"),
        ("0.8 N·m", 0.8, "torque"),
        (" 40 N ", 40.0, "torque"),
    ],
)
def test_a_limit_is_a_share_a_torque_or_a_force(limit: str, number: float, kind: str) -> None:
    found = drift_settings(limit, 0.2, "2026-05-04")
    assert found == DriftSettings(number, kind, 0.2, datetime(2026, 5, 4))


@pytest.mark.parametrize(
    ("limit", "false_alarms", "since", "where", "words"),
    [
        ("a lot", 0.1, None, "--limit", "12Nm or 40N, not 'a lot'"),
        ("1.0", 0.1, None, "--limit", "above 1, not 1"),
        ("0Nm", 0.1, None, "--limit", "above 0, not 0"),
        (None, 0.0, None, "--false-alarms", "above 0 and at most 10, not 0"),
        (None, float("nan"), None, "--false-alarms", "at most 10, not nan"),
        (None, 0.1, "4 May", "--since", "must be a date, not 4 May"),
        (None, 0.1, "2026-05-04T00:00:00+02:00", "--since", "must be a date"),
    ],
)
def test_what_cannot_be_is_refused(
    limit: str, false_alarms: float, since: str, where: str, words: str
) -> None:
    with pytest.raises(DeltaidError, match=words) as caught:
        drift_settings(limit, false_alarms, since)
    assert caught.value.where == where


def test_a_limit_that_is_no_number_is_refused() -> None:
    with pytest.raises(DeltaidError, match="above 1, not nan"):
        DriftSettings(limit=float("nan"))
