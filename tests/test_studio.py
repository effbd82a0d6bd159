"""The studio without a browser: its folder, its plan, its steps, and who may talk to it."""

import asyncio
import sys
from pathlib import Path

import numpy as np
import pytest

from command import refused, run
from deltaid.checks.verdicts import robot_text
from deltaid.errors import DeltaidError
from deltaid.model.record import Settings
from deltaid.robot.load import catalogue_text, described_in, load_robot
from deltaid.studio.edits import difference, editable_copy
from deltaid.studio.folder import ConflictError, Folder
from deltaid.studio.jobs import Job, error_in
from deltaid.studio.look import MinMax
from deltaid.studio.plan import FILE, Plan, Store, Used, digest
from deltaid.studio.runs import FinishedRun, new_run, next_run, runs, write_record
from deltaid.studio.session import Session
from deltaid.studio.steps import check_step, fit_step


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder.open(tmp_path / "work")


@pytest.mark.parametrize(
    "name",
    ["../secret.csv", "/etc/passwd", "runs/../../x", ".ssh/id", "a/.hidden", "..", "", "a\\..\\b",
     "C:x.csv", "a\0b", "link.csv"],
)  # fmt: skip
def test_names_do_not_lead_out_of_the_folder(folder: Folder, tmp_path: Path, name: str) -> None:
    (tmp_path / "secret.csv").write_text("1")
    (folder.root / "link.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(DeltaidError, match="no file of this folder"):
        folder.path(name)
    assert not folder.has(name)


def test_names_that_no_file_can_have_are_no_files(folder: Folder) -> None:
    (folder.root / "loop").symlink_to("loop")
    for name in ("n" * 300, "n" * 5000, "loop", "loop/a.csv"):
        assert not folder.has(name)
        with pytest.raises(DeltaidError):
            folder.write(name, "")


@pytest.mark.parametrize(
    ("given", "kept"),
    [("log.csv", "log.csv"), ("../../x.csv", "x.csv"), ("C:\\a\\b c.csv", "b-c.csv"),
     (".hidden", "hidden"), ("Füße (2).csv", "Füße-(2).csv"), ("con.csv", "file-con.csv"),
     ("", "file"), ("taken.csv", "taken-2.csv")],
)  # fmt: skip
def test_names_of_what_is_dropped_are_safe(folder: Folder, given: str, kept: str) -> None:
    (folder.root / "taken.csv").write_text("")
    assert folder.free_name(given) == kept
    assert folder.path(kept).parent == folder.root


def test_a_file_that_has_changed_meanwhile_is_not_overwritten(folder: Folder) -> None:
    folder.write("a.yaml", "one: 1\n")
    folder.write("a.yaml", "one: 2\n", instead_of="one: 1\n")
    for before in ("one: 1\n", None):
        with pytest.raises(ConflictError):
            folder.write("a.yaml", "one: 3\n", instead_of=before)
    assert folder.text("a.yaml") == "one: 2\n"


def test_kinds_of_files_are_distinguished(folder: Folder) -> None:
    folder.write("robot.yaml", catalogue_text("clavel-delta3"))
    folder.write("mapping.yaml", "position: {column: q, unit: deg}\n")
    folder.write("studio.yaml", "robot: h4\n")
    for name in ("log.csv", "log.parquet", "log.csv.gz", "notes.docx", ".part.csv"):
        (folder.root / name).write_text("")
    assert folder.robots() == ["robot.yaml"]
    assert folder.mappings() == ["mapping.yaml"]
    assert folder.recordings() == ["log.csv", "log.csv.gz", "log.parquet"]


def test_no_write_of_two_servers_is_lost(folder: Folder) -> None:
    first, second = Store(folder), Store(folder)
    first.change(lambda plan: plan.changed(robot="h4"))
    second.change(lambda plan: plan.with_recording(Used(file="log.csv")))
    assert first.changes == [""]
    first.look()
    assert first.changes == ["", ""]
    first.look()
    assert first.changes == ["", ""]
    for store in (first, second, Store(folder)):
        assert store.plan.robot == "h4"
        assert [recording.file for recording in store.plan.recordings] == ["log.csv"]


def test_a_plan_that_is_broken_is_said_with_its_place(folder: Folder) -> None:
    (folder.root / FILE).write_text("robot: h4\nrecordings: 3\n")
    with pytest.raises(DeltaidError, match=f"{FILE}: line 2"):
        Store(folder)


def test_at_most_one_recording_verifies() -> None:
    plan = Plan().with_recording(Used(file="a.csv", use="verify"))
    plan = plan.with_recording(Used(file="b.csv", use="verify"))
    assert plan.verified.file == "b.csv"
    assert [recording.file for recording in plan.fitted] == ["a.csv"]


def test_a_check_holds_for_exactly_what_it_saw(folder: Folder) -> None:
    folder.write("robot.yaml", catalogue_text("clavel-delta3"))
    folder.write("mapping.yaml", "position: {column: q, unit: deg}\n")
    (folder.root / "log.csv").write_text("t\n")
    (folder.root / "test.csv").write_text("t\n")
    session = Session(folder)
    store, used = session.store, Used(file="log.csv", mapping="mapping.yaml")
    store.change(lambda p: p.changed(robot="robot.yaml", recordings=(used,)))
    assert not session.grade()
    of, place = digest(folder, store.plan), new_run(folder, "check")
    empty = dict.fromkeys(("command", "python", "version", "began"), "")
    run = FinishedRun(folder=place, kind="check", **empty, seconds=1, exit=0, of=of)
    write_record(folder, run, '{"grade": "good"}', "")
    assert session.grade() == "good"
    # What a check does not see: names of runs, what is left aside, settings of the fit alone.
    store.change(lambda p: p.with_recording(Used(file="test.csv", use="aside")))
    store.change(lambda p: p.changed(settings=Settings(prior_spread=0.3), names={"a": "b"}))
    assert session.grade()
    plan = store.plan
    for other in (
        plan.changed(settings=Settings(cutoff=30.0)),
        plan.changed(settings=Settings(keep_all=True)),
        plan.changed(robot="h4"),
        plan.with_recording(Used(file="test.csv", use="verify")),
    ):
        assert digest(folder, other) != of
    text = folder.text("mapping.yaml")
    folder.write("mapping.yaml", text + "# 1\n", instead_of=text)
    assert not session.grade()
    (folder.root / "mapping.yaml").write_text(text)
    assert session.grade()
    (folder.root / "log.csv").write_text("t\n1\n")
    assert not session.grade()


def test_commands_say_what_is_not_default_and_nothing_else() -> None:
    used = (Used(file="a b.csv", mapping="m.yaml"), Used(file="c.csv", mapping="m.yaml"))
    plan = Plan(robot="h4", recordings=used)
    assert check_step(plan, "r").command == (
        "deltaid check h4 'a b.csv' c.csv --columns m.yaml --report r/check.html"
    )
    settings = Settings(cutoff=30.0, lag=(0.002, -0.0015), events=False, keep_all=True)
    verify = Used(file="v.csv", mapping="n.yaml", use="verify")
    plan = plan.with_recording(verify).changed(settings=settings, force=True)
    assert fit_step(plan, "r").arguments == (
        "identify", "h4", "a b.csv", "c.csv",
        "--columns", "m.yaml", "--columns", "m.yaml", "--columns", "n.yaml",
        "--verify", "v.csv", "--cutoff", "30", "--keep-all", "--lag=2,-1.5", "--no-events",
        "--force", "--output", "r/model.yaml", "--report", "r/report.html",
    )  # fmt: skip


def test_every_choice_of_the_fit_is_an_option_of_the_command(folder: Folder) -> None:
    plan = Plan(robot="clavel-delta3", recordings=(Used(file="log.csv"),))
    others = {
        "method": "log-cholesky", "regularizer": "entropic", "gamma": 0.1, "prior_spread": 0.2,
        "cutoff": 20.0, "friction": "described", "keep_all": True, "lag": "none",
        "compliance": "none", "effects": "none", "events": False, "intervals": "posterior",
    }  # fmt: skip
    assert set(others) == set(Settings.model_fields)
    step = fit_step(plan.changed(settings=Settings(**others)), "runs/x")
    # Everything is understood; only then is the file missed.
    assert "log.csv" in refused(*step.arguments, folder=folder.root)


def test_runs_are_numbered_and_what_did_not_end_is_no_run(folder: Folder) -> None:
    assert next_run(folder, "fit") == "runs/0001-fit"
    assert new_run(folder, "check") == "runs/0001-check"
    assert new_run(folder, "fit") == "runs/0002-fit"
    assert runs(folder) == []
    (folder.root / "runs/0002-fit/run.yaml").write_text("kind: of another version\n")
    assert runs(folder) == []


def test_a_job_is_its_command_and_leaves_its_provenance(folder: Folder) -> None:
    folder.write("robot.yaml", catalogue_text("clavel-delta3"))
    (folder.root / "numpy.py").write_text("raise SystemExit(9)\n")  # no module of the program
    place = new_run(folder, "check")
    step = check_step(Plan(robot="robot.yaml"), place)
    job = Job(step, folder, place, of="digest", robot="robot.yaml")
    asyncio.run(job.go())
    assert job.state == "done"
    assert job.stages[0] == "checking the description"
    (found,) = runs(folder)
    assert found.command == step.command
    assert found.inputs[0].file == "robot.yaml"
    assert found.of == "digest"
    assert (folder.root / place / "inputs" / "robot.yaml").is_file()
    assert (folder.root / place / "check.html").is_file()


@pytest.mark.slow
def test_a_job_that_fails_says_what_to_mend(folder: Folder) -> None:
    place = new_run(folder, "check")
    plan = Plan(robot="clavel-delta3", recordings=(Used(file="none.csv"),))
    job = Job(check_step(plan, place), folder, place)
    asyncio.run(job.go())
    assert job.state == "failed"
    assert "none.csv: no such file" in job.error
    assert "Traceback" not in job.error
    assert not runs(folder)[0].succeeded


def test_a_defect_is_one_sentence() -> None:
    said = "warning: x\nTraceback (most recent call last):\n  File\nValueError: 3\n"
    assert error_in(said).startswith("a defect of deltaid (ValueError: 3)")


def test_cures_of_a_robot_leave_its_comments(folder: Folder) -> None:
    name = editable_copy(folder, "clavel-delta3")
    assert name == "clavel-delta3.yaml"
    before = folder.text(name)
    path = folder.path(name)
    after = robot_text(path, {"limbs.strut": 1.05, "gravity": [0.0, 0.1, -9.8]})
    assert after.count("#") == before.count("#")
    folder.write(name, after, instead_of=before)
    assert load_robot(path).limbs.strut == 1.05
    changed = difference(name, before, after).splitlines()
    assert "-  strut: 1.055" in changed
    assert "+  strut: 1.05" in changed
    with pytest.raises(DeltaidError, match="strut"):
        described_in(robot_text(path, {"limbs.strut": 0.1}), name)


def test_thinning_keeps_every_peak() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(300_000, 2))
    values[123_456, 0], values[7, 1], values[299_999, 1] = 50.0, -60.0, 70.0
    time = np.arange(len(values)) / 1000
    seen = MinMax(2, 1000)
    for start in range(0, len(values), 4096):
        seen.add(time[start : start + 4096], values[start : start + 4096])
    assert seen.rows == len(values)
    assert seen.seconds == pytest.approx(299.999)
    for k in range(2):
        when, what = seen.curve(k)
        assert len(when) <= 1010
        assert np.all(np.diff(when) >= 0)
        assert (what.min(), what.max()) == (values[:, k].min(), values[:, k].max())
        assert when[what.argmax()] == time[values[:, k].argmax()]


def test_a_part_of_a_long_recording_is_shown_in_full() -> None:
    time = np.arange(100_000) / 1000
    values = np.sin(1000 * time)[:, None]
    seen = MinMax(1, 1600, (90.0, 91.0))
    for start in range(0, len(time), 4096):
        seen.add(time[start : start + 4096], values[start : start + 4096])
    when, what = seen.curve(0)
    assert seen.seconds == pytest.approx(99.999)
    np.testing.assert_allclose(when, time[90_000:91_001])
    np.testing.assert_allclose(what, values[90_000:91_001, 0])


def test_without_the_library_the_command_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert "pip install '.[studio]'" in refused("studio", tmp_path / "new", folder=tmp_path)


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "file: cannot be used" in refused("studio", tmp_path / "file", folder=tmp_path)
    assert "--port" in run("studio", tmp_path, "--port", 70000).err
