"""Numbers that cannot be, in a recording or on the command line: one message, never a result."""

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import deltaid
from command import accepted, refused, run
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError, RecordingError
from deltaid.joint_forces.forces import with_struts
from deltaid.model.model import load
from deltaid.recording.opening import open_log
from deltaid.robot.load import load_robot
from identified import identified
from logs import recorded, refusal, write
from sweeps import slow

ROW, ROWS = 120, 400


@pytest.fixture(scope="module")
def model_file():
    return identified("clavel-delta3").model_file


def spoilt(column: str, value: float, row: int = ROW) -> pl.DataFrame:
    """A recording with derivatives, one number of which is another."""
    frame = recorded(ROWS, derivatives=True)
    return frame.with_columns(
        pl.when(pl.int_range(pl.len()) == row).then(value).otherwise(column).alias(column)
    )


@pytest.mark.parametrize(
    ("column", "value", "fragment"),
    [
        ("q1", 1e155, "column q1 is 1e+155 rad, but no recording of this robot goes beyond 1e+05 "),
        ("qd2", 1e155, "qd2 is 1e+155 rad/s, but no recording of this robot goes beyond 1000 "),
        ("qd2", -1.1e3, "column qd2 is -1100 rad/s"),
        ("qdd3", -1e308, "column qdd3 is -1e+308 rad/s²"),
        ("tau1", 1e155, "is 1e+155 N m, but no recording of this robot goes beyond 1.5e+04"),
        ("tau1", -1.6e4, "column tau1 is -1.6e+04 N m"),
        ("t", 1e155, "column t is 1e+155 s"),
    ],
)  # fmt: skip
def test_absurd_numbers_are_named(tmp_path, clavel: Dynamics, column, value, fragment) -> None:
    path = write(tmp_path / "log.csv", spoilt(column, value))
    message = refusal(open_log, path, clavel.kinematics)
    assert message.startswith(f"{path}, row {ROW + 2}: ")
    assert fragment in message
    assert "--columns" in message


def test_numbers_beyond_a_limit_that_a_robot_may_reach_are_taken(tmp_path, clavel) -> None:
    """The description allows 150 N m; a recording of ten times that is none of our business."""
    path = write(tmp_path / "log.csv", spoilt("tau1", 1500.0))
    assert open_log(path, clavel.kinematics).torque_max[0] == 1500.0


@pytest.mark.parametrize("name", ["linear-delta", "irb360-6-1600"])
def test_every_drive_has_a_bound(tmp_path, name: str) -> None:
    dynamics = Dynamics(load_robot(name))
    drives = range(1, dynamics.dof + 1)
    rest = dynamics.kinematics.inverse(dynamics.kinematics.home[None])[0]
    good = {"t": 1e-3 * np.arange(300)} | {f"q{i}": np.full(300, rest[i - 1]) for i in drives}
    good |= {f"{kind}{i}": np.zeros(300) for kind in ("qd", "qdd", "tau") for i in drives}
    for column in list(good)[1:]:
        spoilt = np.where(np.arange(300) == 150, 2e7, good[column])
        path = write(tmp_path / "log.csv", pl.DataFrame(good | {column: spoilt}))
        message = refusal(open_log, path, dynamics.kinematics)
        assert f"row 152: column {column} is 2e+07" in message


@pytest.mark.parametrize("step", [1e-320, 1e-300, 1e-15])
def test_time_that_hardly_moves(tmp_path, clavel: Dynamics, step: float) -> None:
    frame = recorded(ROWS).with_columns(t=pl.int_range(pl.len()) * step)
    path = write(tmp_path / "log.csv", frame)
    for act in (open_log, lambda log, _: deltaid.identify(clavel.kinematics.robot, log)):
        message = refusal(act, path, clavel.kinematics)
        assert "column t makes a sampling rate of" in message
        assert "declare the unit of time" in message
    *_, verdict = deltaid.check(clavel.kinematics.robot, path)
    assert "column t makes a sampling rate of" in verdict.seen
    few = recorded(60, derivatives=True).with_columns(t=pl.int_range(pl.len()) * step)
    message = refusal(open_log, write(path, few), clavel.kinematics)
    assert "column t makes a sampling rate of" in message


@pytest.mark.parametrize("command", ["torque", "forces", "validate", "simulate", "identify"])
@pytest.mark.parametrize(
    ("column", "value"),
    [("qd2", 1e155), slow("qdd1", -1e308), slow("q1", 1e200)],
)
def test_no_command_goes_on(tmp_path, model_file, command, column, value) -> None:
    log = write(tmp_path / "log.csv", spoilt(column, value))
    robot = "clavel-delta3" if command == "identify" else model_file
    name = "out.yaml" if command == "identify" else "out.csv"
    output = [] if command == "validate" else ["-o", tmp_path / name]
    message = refused(command, robot, log, *output, folder=tmp_path)
    assert re.search(rf"row {ROW + 2}: column {column} is", message)


def test_numbers_that_overflow_beside_a_row_that_is_missing(tmp_path) -> None:
    frame = spoilt("q1", 1e308)[np.delete(np.arange(ROWS), ROW + 1)]
    log = write(tmp_path / "log.csv", frame)
    message = refused("identify", "clavel-delta3", log, folder=tmp_path)
    assert re.search(rf"row {ROW + 2}: column q1 is", message)
    checked = run("check", "clavel-delta3", log)
    assert checked.code == 4
    assert f"row {ROW + 2}: column q1 is" in checked.out


def test_a_time_that_cannot_be_is_refused_as_one(tmp_path) -> None:
    times = [f"{number}" for number in np.linspace(1e150, 1e152, ROWS)]
    log = write(tmp_path / "log.csv", recorded(ROWS).with_columns(t=pl.Series(times)))
    checked = run("check", "clavel-delta3", log)
    assert f"{log}" in "".join((checked.out + checked.err).split())
    assert "nan Hz" not in checked.out + checked.err


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(recorded(10, derivatives=True).columns), st.integers(0, ROWS - 1), NUMBERS)
@example("t", 0, -1e308)
@example("qd1", 5, 5e-324)
def test_any_number_anywhere(tmp_path_factory, clavel, model_file, column, row, value) -> None:
    """Either it is refused with its file, or every torque that comes out is one of a robot."""
    folder = tmp_path_factory.getbasetemp()
    log = write(folder / "any.csv", spoilt(column, value, row))
    try:
        open_log(log, clavel.kinematics)
    except RecordingError as error:
        assert str(error).startswith(str(log))  # noqa: PT017 - both ends are right
        return
    accepted("torque", model_file, log, "-o", folder / "torque.csv")
    torque = pl.read_csv(folder / "torque.csv").drop("t").to_numpy()
    assert np.abs(torque).max() < 1e7


OPTIONS = {
    "base clavel-delta3 log.csv": ["--cutoff", "--seed"],
    "identify clavel-delta3 log.csv -o m.yaml": ["--gamma", "--prior-spread", "--cutoff"],
    "excite clavel-delta3 -o m.csv": [
        "--duration", "--harmonics", "--repeats", "--velocity-weight", "--torque-noise", "--rate",
        "--starts", "--seed",
    ],
    "forces clavel-delta3 log.csv -o f.csv": ["--strut-spacing", "--socket-force"],
    "simulate clavel-delta3 log.csv -o s.csv": [
        "--rate", "--bandwidth", "--encoder", "--delay", "--payload", "--current-loop",
    ],
    "export clavel-delta3 --to c -o r.c --with online": [
        "--rate", "--payload-max", "--false-alarms", "--payload",
    ],
    "compare-controllers clavel-delta3 log.csv --plant clavel-delta3": [
        "--rate", "--bandwidth", "--encoder", "--delay",
    ],
    "demo clavel-delta3 --keep kept": ["--noise", "--seed"],
    "reproduce surrogate -o folder": ["--starts", "--seed"],
    "show clavel-delta3 --live": ["--port"],
}  # fmt: skip
# No number, below every range, above every range. One option is tried with all of them: what is
# refused is decided where a setting is declared, for all kinds of settings alike.
SOME, ALL = ("nan", "-1", "1e300"), ("nan", "inf", "-inf", "-1", "1e300", "x", "")


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("numbers")
    write(folder / "log.csv", recorded(300))
    return folder


@pytest.mark.parametrize("command", OPTIONS)
def test_numbers_that_cannot_be(place: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(place)
    for k, option in enumerate(OPTIONS[command]):
        for value in SOME if k else ALL:
            outcome = run(*command.split(), f"{option}={value}")
            assert outcome.code == 2, (option, value)
            assert outcome.out == ""
            assert option in outcome.err or "cut-off of 1e+300 Hz" in outcome.err
            assert [path.name for path in place.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("force", ["1e20", "1e-300", "0", "99999999999999999999999"])
def test_a_socket_force_that_cannot_be(place: Path, monkeypatch, force: str) -> None:
    monkeypatch.chdir(place)
    outcome = run("forces", "clavel-delta3", "log.csv", f"--socket-force={force}")
    assert (outcome.code, outcome.err.count("error: --socket-force: must ")) == (2, 1)
    with pytest.raises(DescriptionError, match="Limbs: socket_force: "):
        with_struts(load("clavel-delta3"), None, float(force) or -1.0)


def test_a_run_of_more_rows_than_a_disk_holds(place: Path, monkeypatch) -> None:
    monkeypatch.chdir(place)
    outcome = run("excite", "clavel-delta3", "--duration=30", "--repeats=1000", "--rate=1e5")
    assert (outcome.code, outcome.out) == (2, "")
    assert "rows (duration, repeats, rate): must lie between 0 and 3e+07, not 3e+09" in outcome.err
