"""The whole way through `import deltaid`, whatever stands for the robot and the recording."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest

import deltaid
from deltaid.recording.recording import open_recordings
from identified import identified
from logs import arrays, noisy, recorded

NAME = "clavel-delta3"
QUICK = {"friction": "described", "lag": "none", "compliance": "none", "events": False}


def csv(frame: pl.DataFrame, folder: Path) -> Path:
    path = folder / f"{len(frame)}.csv"
    frame.write_csv(path)
    return path


def parquet(frame: pl.DataFrame, folder: Path) -> str:
    path = folder / f"{len(frame)}.parquet"
    frame.write_parquet(path)
    return str(path)


LOGS: dict[str, Callable[[pl.DataFrame, Path], object]] = {
    "a path": csv,
    "text of a path": parquet,
    "polars": lambda frame, _: frame,
    "lazy polars": lambda frame, _: frame.lazy(),
    "pandas": lambda frame, _: pd.DataFrame(frame.to_dict(as_series=False)),
    "a dictionary": lambda frame, _: arrays(frame),
    "columns in a dictionary": lambda frame, _: frame.to_dict(),
    "a structured array": lambda frame, _: frame.to_numpy(structured=True),
    "arrays": lambda frame, _: deltaid.Recording.from_arrays(**arrays(frame)),
}


def robots(folder: Path) -> list[object]:
    """The same robot by name, by two kinds of path, by value and as a dictionary."""
    robot = deltaid.load_robot(NAME)
    path = folder / "robot.yaml"
    path.write_text(robot.model_dump_json(exclude_none=True), encoding="utf-8")
    data = robot.model_dump(exclude_none=True, mode="json")
    return [NAME, path, str(path), robot, data, deltaid.load(NAME), deltaid.Dynamics(NAME)]


def test_a_robot_in_any_form_is_loaded(tmp_path: Path) -> None:
    wanted = deltaid.load_robot(NAME)
    assert all(deltaid.load_robot(robot) == wanted for robot in robots(tmp_path))


def whole_way(robot: object, log: object, unseen: object, folder: Path) -> dict[str, object]:
    """Checks, model, proof, file, torques, forces, drawn models, export: all that comes out."""
    checks = deltaid.check(robot, log, settings=QUICK)
    result = deltaid.identify(robot, log, settings=QUICK)
    proof = deltaid.validate(result, unseen)
    result.save(folder / "model.yaml")
    model = deltaid.load(folder / "model.yaml")
    q, rates = np.array([0.3, 0.2, 0.1]), np.array([0.5, -0.4, 0.3])
    z = deltaid.Kinematics(robot).forward(q)
    written = deltaid.export(folder / "model.yaml", "c", folder / "model.c")
    return {
        "verdicts": [(check.key, check.grade) for check in checks],
        "p": result.to_frame()["value"].to_numpy(),
        "error": proof.error.rms,
        "torque": model.dynamics.inverse_dynamics(q, rates, rates),
        "acceleration": model.forward.drive_acceleration(q, rates, rates),
        "forces": deltaid.ConstraintForces(folder / "model.yaml").evaluate(z, rates, rates),
        "code": [path.suffix for path in written.paths],
    }


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """With a name and a table of polars."""
    return whole_way(NAME, recorded(1500), recorded(1200), tmp_path_factory.mktemp("expected"))


@pytest.mark.parametrize(
    ("robot", "log", "unseen"),
    [
        pytest.param(1, "a path", "text of a path", marks=pytest.mark.slow),
        (3, "pandas", "lazy polars"),
        pytest.param(4, "a dictionary", "arrays", marks=pytest.mark.slow),
    ],
)
def test_the_whole_way_is_the_same_whatever_is_given(
    robot: int, log: str, unseen: str, expected: dict[str, object], tmp_path: Path
) -> None:
    robot = robots(tmp_path)[robot]
    log = LOGS[log](recorded(1500), tmp_path)
    unseen = LOGS[unseen](recorded(1200), tmp_path)
    found = whole_way(robot, log, unseen, tmp_path)
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value, err_msg=key)


def test_every_recording_is_read_alike(tmp_path: Path) -> None:
    model = deltaid.load(NAME)
    frame = recorded(1200)
    errors = {
        what: deltaid.validate(model, make(frame, tmp_path)).error.rms
        for what, make in LOGS.items()
    }
    assert len(errors) == 9
    for what, rms in errors.items():
        np.testing.assert_array_equal(rms, errors["polars"], err_msg=what)


def test_recordings_are_mixed_in_a_list(tmp_path: Path) -> None:
    frames = [
        recorded(samples).with_columns(tau1=pl.col("tau1") + 1e-9 * samples)
        for samples in (1200, 1300, 1400)
    ]
    kinds = (csv, LOGS["pandas"], LOGS["a dictionary"])
    mixed = [make(frame, tmp_path) for make, frame in zip(kinds, frames, strict=True)]
    opened = open_recordings(mixed, deltaid.Kinematics(NAME))
    assert [recording.log.samples for recording in opened] == [1200, 1300, 1400]
    assert [str(recording.log.path.name) for recording in opened] == [
        "1200.csv",
        "table 2",
        "table 3",
    ]


def test_every_robot_is_taken_everywhere(tmp_path: Path) -> None:
    expected = deltaid.prior_parameters(NAME)
    for robot in robots(tmp_path):
        np.testing.assert_array_equal(deltaid.prior_parameters(robot), expected)
        assert deltaid.Kinematics(robot).robot == deltaid.load_robot(NAME)
        assert not deltaid.check(robot, progress=False).poor
    for robot in robots(tmp_path)[:-1]:  # dynamics are no model
        assert deltaid.load(robot).robot.name == NAME


def test_a_model_stands_for_its_robot_and_brings_its_parameters(tmp_path: Path) -> None:
    q = np.array([0.3, 0.2, 0.1])
    result = identified(NAME).result
    result.save(tmp_path / "model.yaml")
    data = result.model.model_dump(mode="json", exclude_none=True)
    expected = result.model.p
    assert not np.allclose(expected, deltaid.prior_parameters(NAME))
    for model in (
        result,
        result.model,
        tmp_path / "model.yaml",
        str(tmp_path / "model.yaml"),
        data,
    ):
        np.testing.assert_array_equal(deltaid.load(model).p, expected)
    at = deltaid.load(result).dynamics.inverse_dynamics(q, q, q, expected)
    for model in (result, result.model, tmp_path / "model.yaml", deltaid.load(result)):
        np.testing.assert_array_equal(deltaid.Dynamics(model).inverse_dynamics(q, q, q), at)
    forward = deltaid.load(result).forward
    found = forward.drive_acceleration(q, q, q)
    np.testing.assert_array_equal(found, forward.drive_acceleration(q, q, q, expected))
    assert not np.allclose(found, deltaid.load(NAME).forward.drive_acceleration(q, q, q))
    prior = deltaid.Dynamics(NAME).inverse_dynamics(q, q, q)
    assert not np.allclose(prior, at)
    np.testing.assert_array_equal(result["P.m"], deltaid.load(result)["P.m"])


def test_mappings_are_taken_as_values_dictionaries_and_files(tmp_path: Path) -> None:
    frame = recorded(1200).with_columns(pl.col("q1", "q2", "q3").degrees())
    data = {"position": {"columns": ["q1", "q2", "q3"], "unit": "deg"}}
    file = tmp_path / "columns.yaml"
    file.write_text("position: {columns: [q1, q2, q3], unit: deg}\n", encoding="utf-8")
    expected = deltaid.validate(NAME, recorded(1200)).error.rms
    for columns in (data, deltaid.ColumnMapping(**data), file, str(file)):
        found = deltaid.validate(NAME, frame, columns=columns).error.rms
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_cured_columns_are_the_cure() -> None:
    right = noisy(recorded(3000))
    wrong = right.with_columns(pl.col("q1", "q2", "q3").degrees(), tau2=-pl.col("tau2"))
    checks = deltaid.check(NAME, wrong)
    assert checks.grade == "wrong"
    assert "{column: tau2, unit: N m, sign: -1}" in checks.cures
    cured = checks.cured_columns()
    assert deltaid.check(NAME, wrong, columns=cured).grade == "good"
    found = deltaid.validate(NAME, wrong, columns=cured).error.rms
    np.testing.assert_allclose(found, deltaid.validate(NAME, right).error.rms, rtol=1e-9)
