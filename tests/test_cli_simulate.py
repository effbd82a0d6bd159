"""Motions to follow, from files; `deltaid simulate` and `deltaid compare-controllers`."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from command import accepted, json_of, refused, run
from deltaid.control.comparison import _why_not, base_vector, candidates
from deltaid.control.controllers import CONTROLLERS
from deltaid.control.trajectory import open_trajectory
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.record import IdentifiedModel
from deltaid.robot.load import catalogue_text, load_robot
from logs import tabled, write
from support import along

ROBOT = "clavel-delta3"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demonstration with truth, and a planned motion of it; no test changes these."""
    place = tmp_path_factory.mktemp("simulate")
    accepted("demo", ROBOT, "--keep", place, "--noise", 0.0)
    excite = ("excite", ROBOT, "--starts", 1, "--duration", 4, "--harmonics", 2)
    accepted(*excite, "-o", place / "motion.csv")
    pl.read_csv(place / "motion.csv")[:500].write_csv(place / "short.csv")
    pl.read_csv(place / "motion.csv")[:60].write_csv(place / "shorter.csv")
    return place


def test_a_file_is_the_motion_that_was_planned(folder: Path) -> None:
    robot = load_robot(ROBOT)
    kinematics = compiled(robot).kinematics
    path = folder / "motion.csv"
    file = pl.read_csv(path)
    trajectory, _ = open_trajectory(path, kinematics)
    found = trajectory.desired(file["t"].to_numpy())
    for name, values, near in (
        ("q", found.q, 1e-9),
        ("qd", found.qd, 1e-6),
        ("qdd", found.qdd, 1e-3),
    ):
        expected = file.select(f"{name}{i}" for i in (1, 2, 3)).to_numpy()
        np.testing.assert_allclose(values, expected, atol=near * np.abs(expected).max())
    np.testing.assert_allclose(found.z, file.select("x", "y", "z").to_numpy(), atol=1e-9)
    middle = trajectory.desired(np.array([0.5, 0.5005]))
    passed = middle.qd.mean(axis=0) * 5e-4
    np.testing.assert_allclose(np.diff(middle.q, axis=0)[0], passed, atol=1e-7)


def test_a_recording_is_filtered_before_it_is_followed(folder: Path) -> None:
    """Encoder steps would be accelerations of 6 rad/s² otherwise."""
    path = folder / "verify.csv"
    trajectory, log = open_trajectory(path, compiled(load_robot(ROBOT)).kinematics)
    assert log.samples / log.rate - 2 < trajectory.duration < log.samples / log.rate
    qdd = trajectory.desired(np.linspace(0, trajectory.duration, 40_000)).qdd
    assert np.abs(np.diff(qdd, axis=0)).max() < 0.5


def test_base_parameters_have_the_torques_of_the_truth(folder: Path) -> None:
    model = IdentifiedModel.load(folder / "model.yaml")
    truth = prior_parameters(load_robot(folder / "truth.yaml"))
    dynamics = compiled(model.robot)
    z, _, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), np.linspace(0, 2, 100))
    expected = dynamics.torque(z, qd, qdd, truth)
    found = dynamics.torque(z, qd, qdd, base_vector(model))
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
    assert [*candidates(model)] == ["prior", "base parameters", "identified"]


def test_comparison_tells_what_identification_buys(folder: Path) -> None:
    files = (folder / "model.yaml", folder / "short.csv", "--plant", folder / "truth.yaml")
    report = folder / "comparison.html"
    runs = json_of("compare-controllers", *files, "--report", report)["runs"]
    assert len(runs) == 1 + 4 * 3
    error = {(r["controller"], r["model"]): r["platform_rms"] for r in runs}
    for controller in CONTROLLERS[1:]:
        prior, identified = (error[controller, m] for m in ("prior", "identified"))
        assert identified < 0.3 * prior
        assert prior < 0.5 * error["pd", None]
        assert error[controller, "base parameters"] < 0.5 * prior
    assert "What identification buys" in report.read_text(encoding="utf-8")
    report.unlink()


def test_a_model_without_a_positive_mass_matrix_runs_feed_forward_only(folder: Path) -> None:
    model = IdentifiedModel.load(folder / "model.yaml")
    text = (folder / "model.yaml").read_text(encoding="utf-8")
    inertia = next(b for b in model.base_parameters if b.formula.startswith("m_P"))
    assert text.count(f"value: {inertia.value!r}") >= 1
    path = folder / "wrong.yaml"
    path.write_text(text.replace(f"value: {inertia.value!r}", "value: -30.0"), encoding="utf-8")
    files = (path, folder / "shorter.csv", "--plant", folder / "truth.yaml", "--bandwidth", 20)
    outcome = run("compare-controllers", *files, width=120)
    path.unlink()
    assert outcome.code == 0, outcome.err
    rows = [row for row in outcome.out.splitlines() if "base parameters" in row]
    refused_rows = [row for row in rows if "M is not positive definite" in row]
    assert len(refused_rows) == 3
    assert "pd-feedforward" in next(row for row in rows if row not in refused_rows)


@pytest.mark.parametrize(("eigenvalue", "runs"), [(0.02, True), (0.005, False), (-0.02, False)])
def test_a_mass_matrix_is_judged_by_a_share_of_its_diagonal(eigenvalue: float, runs: bool) -> None:
    assert (_why_not(eigenvalue) == "") == runs


def test_simulate_writes_a_log_that_can_be_identified(folder: Path) -> None:
    output, report = folder / "out.csv", folder / "out.html"
    files = (folder / "model.yaml", folder / "motion.csv", "--plant", folder / "truth.yaml")
    outcome = accepted("simulate", *files, "-o", output, "--report", report)
    assert "Platform error 0.0" in outcome.out
    assert "Torques" in report.read_text(encoding="utf-8")
    log = pl.read_csv(output)
    assert log.columns[:7] == ["t", "q1", "q2", "q3", "tau1", "tau2", "tau3"]
    assert max(json_of("validate", folder / "model.yaml", output)["nrmse"]) < 0.05
    for path in (output, report):
        path.unlink()


def test_page_of_simulate_shows_the_limits_of_the_plant(folder: Path, tmp_path: Path) -> None:
    weaker, report = tmp_path / "weaker.yaml", tmp_path / "run.html"
    text = (folder / "robot.yaml").read_text(encoding="utf-8")
    assert text.count("torque: 150.0") == 3
    weaker.write_text(text.replace("torque: 150.0", "torque: 41.5"), encoding="utf-8")
    files = (folder / "model.yaml", folder / "short.csv", "--plant", weaker)
    accepted("simulate", *files, "--report", report)
    assert '"y0":41.5' in report.read_text(encoding="utf-8")


def test_file_of_a_lost_robot_ends_where_it_was_lost(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "lost.csv"
    files = (folder / "model.yaml", folder / "motion.csv", "--delay", 100)
    answer = json_of("simulate", *files, "-o", output)
    table = pl.read_csv(output)
    assert np.isfinite(table.to_numpy()).all()
    assert table["t"][-1] == pytest.approx(answer["ended"] - 1e-3)


def test_settings_are_given_whole_or_one_by_one(folder: Path) -> None:
    asked = {"rate": 500.0, "delay": 1, "encoder": 0.0}
    whole, single, usual = (
        deltaid.simulate(ROBOT, folder / "short.csv", progress=False, **given)
        for given in ({"settings": deltaid.ControlSettings(**asked)}, asked, {})
    )
    assert whole.conditions.drives == single.conditions.drives
    assert (whole.conditions.drives.rate, whole.conditions.drives.delay) == (500.0, 1)
    np.testing.assert_array_equal(whole.tracking.q, single.tracking.q)
    assert whole.error.platform_rms != usual.error.platform_rms
    message = r"has no setting 'rates'\n.*did you mean rate\?"
    with pytest.raises(deltaid.DeltaidError, match=message):
        deltaid.simulate(ROBOT, folder / "short.csv", rates=500.0)


BAD = [
    ("simulate {m} far.csv", "far.csv, row "),
    ("simulate {m} missing.csv", "missing.csv: no such file"),
    ("simulate irb360-6-1600 motion.csv", "has no column q4"),
    ("simulate {m} motion.csv --plant irb360-6-1600", "has 4 rotary and 0 linear drives"),
    ("simulate {m} motion.csv --plant linear-delta", "0 rotary and 3 linear drives"),
    ("simulate nobody motion.csv", "no robot file and no catalogue robot called 'nobody'"),
    ("simulate {m} motion.csv --rate 0", "--rate: must be a positive number"),
    ("simulate {m} motion.csv --bandwidth 500", "--bandwidth: must lie between 0.01 and 100"),
    (
        "simulate {m} motion.csv --rate 10",
        "--rate: must be ten times the bandwidth of the feedback, 100 Hz",
    ),
    ("simulate {m} motion.csv --payload two", "--payload: 'two' is no mass"),
    ("simulate {m} motion.csv --payload -1", "--payload: '-1' is no mass"),
    ("simulate {m} motion.csv --payload 1±3", "is no load of a robot"),
    ("simulate {m} motion.csv --payload-known", "there is no load to know"),
    ("simulate {m} motion.csv --current-loop 0", "--current-loop: must be a positive number"),
    ("simulate {m} motion.csv --elastic-gears", "how stiff the gear of drive1 is"),
    ("simulate {m} motion.csv -o motion.csv", "would overwrite an input"),
    ("simulate {m} motion.csv --report motion.txt", "must end in .html"),
    ("simulate {m} motion.csv -o a.html", "must end in .csv"),
    ("compare-controllers {m} motion.csv --plant irb360-6-1600", "has 4 rotary"),
    ("compare-controllers {m} motion.csv --plant truth.yaml --report no/", "no/: is a folder"),
]


@pytest.mark.parametrize(("line", "message"), BAD)
def test_bad_input(line: str, message: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    far = pl.read_csv("motion.csv").with_columns(q1=pl.col("q1") + 1.7)
    far.write_csv("far.csv")
    assert message in " ".join(refused(*line.format(m="model.yaml").split(), folder=folder).split())


def test_a_plant_of_another_geometry_is_followed_too(folder: Path, tmp_path: Path) -> None:
    """Its platform is then where its own lengths put it."""
    longer = tmp_path / "longer.yaml"
    longer.write_text(catalogue_text(ROBOT).replace("strut: 1.055", "strut: 1.056"), "utf-8")
    answer = json_of("simulate", ROBOT, folder / "short.csv", "--plant", longer)
    assert 5e-4 < answer["platform_rms"] < 3e-3


def test_a_payload_and_its_uncertainty(folder: Path, tmp_path: Path) -> None:
    """A load that is known costs next to nothing, and what is not known of it shows at its ends."""
    command = ("simulate", ROBOT, folder / "short.csv", "--controller", "pd-feedforward")
    load = ("--payload", "1.5±0.2", "--current-loop", 300)
    free = json_of(*command, "--current-loop", 300)
    blind = json_of(*command, *load)
    page = tmp_path / "a.html"
    known = json_of(*command, *load, "--payload-known", "--report", page)
    assert free["payload"] is None
    assert (free["current_loop_hz"], blind["payload"]["mass"]) == (300, 1.5)
    assert [end["mass"] for end in known["payload"]["ends"]] == pytest.approx([1.1, 1.9])
    assert known["platform_rms"] < 0.2 * blind["platform_rms"]
    ends = [end["platform_rms"] for end in known["payload"]["ends"]]
    assert min(ends) > 1.5 * known["platform_rms"]
    sentence = "current loops of 300 Hz. With a load of 1.5 kg, of which the controller knows"
    assert sentence in page.read_text(encoding="utf-8")
    brief = ("simulate", ROBOT, folder / "shorter.csv", *command[3:])
    text = run(*brief, *load, "--payload-known").out
    assert "with a load of 1.5 kg, of which the controller knows 1.5 kg" in text
    assert "with 1.9 kg (two standard deviations off)" in text


def test_a_comparison_with_a_load(folder: Path) -> None:
    arguments = ("compare-controllers", folder / "model.yaml", folder / "shorter.csv", "--plant")
    comparison = json_of(*arguments, folder / "truth.yaml", "--payload", "1+-0.1")
    runs = {(run["controller"], run["model"]): run for run in comparison["runs"]}
    blind = runs["pd-feedforward", "identified"]
    known = runs["pd-feedforward", "identified, load known"]
    assert known["platform_rms"] < 0.2 * blind["platform_rms"]
    assert [end["mass"] for end in known["ends"]] == pytest.approx([0.8, 1.2])


def test_a_motion_out_of_reach_of_rails_says_nothing_of_arms(tmp_path: Path) -> None:
    rows = "".join(f"{k / 100},-2,{k / 1000},0.5\n" for k in range(400))
    (tmp_path / "motion.csv").write_text(f"t,q1,q2,q3\n{rows}", encoding="utf-8")
    said = refused("simulate", "linear-delta", tmp_path / "motion.csv", folder=tmp_path)
    assert "check sign, zero, unit and order of the drives and the robot's lengths" in said


def test_a_plan_with_a_gap_is_refused_with_its_row(tmp_path: Path) -> None:
    time = np.arange(0.0, 1.0, 0.002)
    time[300:] += 3.0
    q = 0.1 * np.sin(2 * time[:, None] + np.arange(3))
    plan = write(tmp_path / "plan.csv", tabled(t=time, q=q))
    error = refused("simulate", ROBOT, plan, folder=tmp_path)
    assert "plan.csv: 1500 rows are missing before row 302" in error
