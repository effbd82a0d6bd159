"""Commands on small data: exit codes, JSON, files, tables."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import polars as pl
import pytest

from command import accepted, json_of, refused, run
from deltaid.dynamics.dynamics import Dynamics
from deltaid.identification.prediction import misfit
from deltaid.identification.sources import model_filtered
from deltaid.identification.torque_error import TorqueError, predict
from deltaid.model.record import IdentifiedModel
from deltaid.recording.opening import open_log
from deltaid.robot.load import catalogue, catalogue_text
from identified import identified
from logs import names, recorded, write

ROBOT = "clavel-delta3"
KEYS = {"objective", "duality_gap", "optimization_variables", "base_parameters", "rms", "nrmse"}
KEYS |= {"friction", "consistent", "verify"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log, and the model that `deltaid identify` makes of it, with what it prints as JSON."""
    place = tmp_path_factory.mktemp("cli")
    write(place / "log.csv", recorded(1500))

    write(place / "motion.csv", recorded(1500, derivatives=True).drop(names("tau")))
    outcome = accepted("identify", ROBOT, place / "log.csv", "-o", place / "model.yaml", "--json")
    write(place / "identified.json", outcome.out)
    return place


def test_robots() -> None:
    listed = accepted("robots")
    assert all(name in listed.out for name in catalogue())
    assert run("robots", ROBOT).out == catalogue_text(ROBOT) + "\n"


@pytest.mark.parametrize("kind", ["robot", "columns", "model", "sensors"])
def test_schema(folder: Path, kind: str) -> None:
    schema = json.loads(run("schema", kind).out)
    assert schema["properties"]
    if kind == "model":
        model = IdentifiedModel.load(folder / "model.yaml").model_dump(mode="json")
        jsonschema.validate(model, schema)


def test_identify_tables(folder: Path, tmp_path: Path) -> None:
    outcome = accepted("identify", ROBOT, folder / "log.csv", "-o", tmp_path / "model.yaml")
    assert "viscous.drive1" not in outcome.out
    assert f"saved {tmp_path / 'model.yaml'}" in outcome.out
    assert IdentifiedModel.load(tmp_path / "model.yaml").consistent
    full = run("identify", ROBOT, folder / "log.csv", "--full").out
    assert "viscous.drive1" in full
    fits_80_columns(full)
    assert [path.name for path in tmp_path.iterdir()] == ["model.yaml"]
    fits_80_columns(outcome.out)


def test_identify_json() -> None:
    log = identified("irb360-6-1600").log
    value = json_of("identify", "irb360-6-1600", log, "--verify", log)
    assert value.keys() >= KEYS
    assert value["optimization_variables"] == 36
    assert value["base_parameters"] == 37
    assert value["consistent"] is True
    assert value["duality_gap"] >= 0
    assert value["friction"]["joints"] == ["drive1", "drive2", "drive3", "drive4", "slide"]
    assert len(value["rms"]) == len(value["nrmse"]) == 4
    assert value["verify"]["rms"] == pytest.approx(value["rms"])


@pytest.mark.parametrize(
    ("method", "regularizer"), [("conic", "euclidean"), ("log-cholesky", "entropic")]
)
def test_identify_options(folder: Path, method: str, regularizer: str) -> None:
    options = ["--method", method, "--regularizer", regularizer, "--gamma", "1e-6"]
    value = json_of("identify", ROBOT, folder / "log.csv", *options, "--cutoff", "30")
    assert (value["method"], value["regularizer"], value["gamma"]) == (method, regularizer, 1e-6)
    assert value["cutoff_hz"] == [30.0]


def test_validate(folder: Path) -> None:
    assert "drive3" in run("validate", folder / "model.yaml", folder / "log.csv").out
    value = json_of("validate", folder / "model.yaml", folder / "log.csv")
    model = IdentifiedModel.load(folder / "model.yaml")
    assert value["rms"] == pytest.approx(model.fit.rms)
    assert value["log"] == "log.csv"
    assert value["sha256"] == model.sources[0].sha256


@pytest.mark.parametrize("mistake", ["order", "sign", None])
def test_torques_that_are_not_the_models_are_reported(
    mistake: str | None, folder: Path, tmp_path: Path
) -> None:
    table = pl.read_csv(folder / "log.csv")
    wrong = {
        "order": [pl.col("tau1").alias("tau2"), pl.col("tau2").alias("tau1")],
        "sign": [-pl.col("tau2")],
        None: [],
    }[mistake]
    table.with_columns(wrong).write_csv(tmp_path / "other.csv")
    outcomes = [run("validate", folder / "model.yaml", tmp_path / "other.csv")]
    if mistake == "sign":
        both = (folder / "log.csv", "--verify", tmp_path / "other.csv")
        outcomes.append(run("identify", ROBOT, *both))
    for outcome in outcomes:
        message = " ".join(outcome.err.split())
        drives = {"order": "drive1, drive2", "sign": "drive2"}.get(mistake or "")
        assert (f"does not predict {drives}: the error of drive" in message) == (drives is not None)
        assert ("does not predict" in message) == (drives is not None)


def test_the_same_recording_twice_is_refused(folder: Path, tmp_path: Path) -> None:
    copy = write(tmp_path / "copy.csv", (folder / "log.csv").read_text())
    for command in (("identify", ROBOT), ("base", ROBOT)):
        message = refused(*command, folder / "log.csv", copy, folder=tmp_path)
        assert f"{copy}: is the same recording as {folder / 'log.csv'}" in message
        assert "give each recording once" in message


def test_verifying_on_what_a_model_was_identified_from_is_reported(
    folder: Path, tmp_path: Path
) -> None:
    copy = write(tmp_path / "copy.csv", (folder / "log.csv").read_text())
    page = tmp_path / "page.html"
    verified = run("identify", ROBOT, folder / "log.csv", "--verify", copy)
    validated = run("validate", folder / "model.yaml", copy, "--report", page)
    for outcome in (verified, validated):
        assert outcome.code == 0
        message = " ".join(outcome.err.split())
        assert f"{copy}: the model was identified from this recording (log.csv)" in message
    assert "so it verifies nothing" in page.read_text()
    table = pl.read_csv(folder / "log.csv").head(1400)
    table.write_csv(tmp_path / "part.csv")
    part = " ".join(run("validate", folder / "model.yaml", tmp_path / "part.csv").err.split())
    assert "from rows of this recording (log.csv), so it verifies nothing" in part
    table.with_columns(tau1=pl.col("tau1") * 1.001).write_csv(tmp_path / "other.csv")
    assert (
        "verifies nothing" not in run("validate", folder / "model.yaml", tmp_path / "other.csv").err
    )


@pytest.mark.parametrize(
    ("times", "share", "is_reported"), [(2.0, 0.3, False), (50.0, 0.05, False), (50.0, 0.3, True)]
)
def test_a_drive_is_badly_predicted_by_both_measures(
    times: float, share: float, is_reported: bool
) -> None:
    """Neither an error like the identification's nor a small one says that the recording is wrong:
    friction changes with temperature, and some drives are hardly known."""
    model = IdentifiedModel.load(Path(__file__).parent / "data" / "model-format-1.yaml")
    rms = np.array(model.fit.rms) * [1.0, times, 1.0]
    nrmse, still = np.array([0.01, share, 0.01]), np.zeros(3)
    error = TorqueError(rms, nrmse, rms, np.eye(3), still, cutoff=None, fastest=np.ones(3))
    assert [("drive2" in text) for text in misfit(model, error)] == ([True] if is_reported else [])


@pytest.mark.parametrize(("rms", "speed", "cause"), [(1.0, 0.0, "stands"), (0.0, 1.0, "did not")])
def test_a_prediction_that_rest_spoils_accuses_no_wiring(
    rms: float, speed: float, cause: str
) -> None:
    """Rest of the recording, or of a drive in those of the identification."""
    model = IdentifiedModel.load(Path(__file__).parent / "data" / "model-format-1.yaml")
    fit = model.fit.changed(rms=(rms,) * 3)
    error = TorqueError(
        np.full(3, 99.0), np.full(3, 2.0), np.full(3, 99.0), np.eye(3), np.zeros(3),
        cutoff=None, fastest=np.full(3, speed),
    )  # fmt: skip
    (text,) = misfit(model.changed(fit=fit), error)
    assert cause in text
    assert "sign, unit or order" not in text


def test_torque_of_a_planned_motion(folder: Path, tmp_path: Path, clavel: Dynamics) -> None:
    out = tmp_path / "torque.csv"
    outcome = accepted("torque", folder / "model.yaml", folder / "motion.csv", "-o", out)
    assert "wrote 1500 of 1500 samples" in outcome.out
    motion, written = pl.read_csv(folder / "motion.csv"), pl.read_csv(out)
    assert written.columns == names("t", "tau")
    model = IdentifiedModel.load(folder / "model.yaml")
    states = [motion.select(names(kind)).to_numpy() for kind in ("q", "qd", "qdd")]
    np.testing.assert_array_equal(written["t"], motion["t"])
    expected = clavel.inverse_dynamics(*states, model.p)
    np.testing.assert_allclose(written.select(names("tau")), expected, rtol=0, atol=1e-9)


def test_torque_of_positions(folder: Path, tmp_path: Path, clavel: Dynamics) -> None:
    out = tmp_path / "torque.csv"
    outcome = run("torque", folder / "model.yaml", folder / "log.csv", "-o", out)
    assert "positions low-passed" in outcome.out
    model = IdentifiedModel.load(folder / "model.yaml")
    log = open_log(folder / "log.csv", clavel.kinematics)
    parts = list(predict(clavel, model.p, model_filtered(model, log)))
    time, expected = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("time", "predicted")
    )
    written = pl.read_csv(out)
    assert len(written) == 1500
    same = written.filter(pl.col("t").is_between(time[0], time[-1]))
    np.testing.assert_array_equal(same["t"], time)
    np.testing.assert_allclose(same.select(names("tau")), expected, rtol=0, atol=1e-9)


def test_base(folder: Path) -> None:
    value = json_of("base", "irb360-6-1600")
    assert (value["base_parameters"], value["optimization_variables"]) == (37, 36)
    value = json_of("base", ROBOT, folder / "log.csv")
    assert len(value["groups"]) == len(value["values"]) == value["base_parameters"]
    every = json_of("base", ROBOT, folder / "log.csv", "--keep-all")
    np.testing.assert_allclose(every["values"], value["values"], rtol=0.2)
    assert every["values"] != value["values"]  # reversals count
    assert "base parameter" in run("base", ROBOT).out


def test_columns_option(folder: Path, tmp_path: Path) -> None:
    frame = recorded(1500)
    renamed = frame.select(
        (1000 * pl.col("t")).alias("Zeit"),
        *(pl.col(f"q{i}").degrees().alias(f"Winkel {i}") for i in (1, 2, 3)),
        *(pl.col(f"tau{i}") for i in (1, 2, 3)),
    )
    log = write(tmp_path / "log.csv", renamed)
    lines = ["time: {column: Zeit, unit: ms}", "position:"]
    lines += [f"  - {{column: Winkel {i}, unit: deg}}" for i in (1, 2, 3)]
    mapping = write(tmp_path / "columns.yaml", "\n".join(lines))
    value = json_of("identify", ROBOT, log, "--columns", mapping)
    straight = json.loads((folder / "identified.json").read_text())
    assert value["rms"] == pytest.approx(straight["rms"], rel=1e-6)


def test_warnings_leave_json_clean(folder: Path, tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", (folder / "log.csv").read_text().rstrip("\n"))
    outcome = run("validate", folder / "model.yaml", log, "--json")
    json.loads(outcome.out)
    assert "warning:" in outcome.err
    assert "no line break" in outcome.err


def fits_80_columns(text: str) -> None:
    assert "…" not in text.replace(" … ", " to ")  # but in ranges: nothing is cut off
    assert max(len(line) for line in text.splitlines() if "  " in line) <= 80


def test_tables_lose_nothing_on_narrow_terminals(folder: Path) -> None:
    for arguments in (["robots"], ["validate", folder / "model.yaml", folder / "log.csv"]):
        narrow, wide = (run(*arguments, width=width).out for width in (50, 200))
        assert "…" not in narrow
        assert sorted(narrow.split()) == sorted(wide.split())
