"""The studio when something goes wrong around it: each time one message, and nothing is lost."""

import asyncio
import os
import shutil
import signal
import socket
from pathlib import Path

import pytest

from command import refused
from deltaid.errors import DeltaidError
from deltaid.recording.contents import count_columns
from deltaid.robot.load import catalogue_text
from deltaid.studio import jobs
from deltaid.studio.folder import Folder
from deltaid.studio.jobs import Job
from deltaid.studio.plan import Plan, Used
from deltaid.studio.runs import new_run, runs
from deltaid.studio.session import FileEdit, Session, draft_key, stage_states, unmapped
from deltaid.studio.stand import robot_at, stage
from deltaid.studio.steps import check_step, excite_step


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(Folder.open(tmp_path / "work"))


def _dies_once(mark: Path) -> str:
    if not mark.exists():
        mark.touch()
        os._exit(9)
    return "alive"


@pytest.mark.slow
def test_a_reading_process_that_is_killed_is_one_message_and_comes_back(session: Session) -> None:
    mark = session.folder.root / "mark"

    async def scenario() -> None:
        try:
            with pytest.raises(DeltaidError, match="process that reads files was ended"):
                await session.read_cached(_dies_once, mark)
            assert await session.read_cached(_dies_once, mark) == "alive"
            missing = str(session.folder.root / "none.csv")
            for ask in (session.read_cached, session.read):
                with pytest.raises(DeltaidError, match=r"^none\.csv: no such file"):
                    await ask(count_columns, missing)
        finally:
            await session.close()

    asyncio.run(scenario())


@pytest.mark.slow
def test_a_step_that_is_killed_is_one_message_and_another_may_begin(session: Session) -> None:
    async def scenario() -> None:
        job = session.begin(
            "excite", lambda at: excite_step("irb360-6-1600", f"{at}/m.csv", at, starts=100)
        )
        with pytest.raises(DeltaidError, match="still running"):
            session.begin("check", lambda at: check_step(Plan(robot="h4"), at))
        while not job.stages:
            await asyncio.sleep(0.05)
        os.killpg(job._process.pid, signal.SIGKILL)
        while session.busy:
            await asyncio.sleep(0.05)
        assert job.state == "failed"
        assert job.error == "it was ended from outside"
        assert not session.busy
        await session.close()

    asyncio.run(scenario())
    (run,) = runs(session.folder)
    assert not run.succeeded
    assert not (session.folder.root / run.folder / "m.csv").exists()


# Before the command: its search, and a process that it starts, wait for a question and answer it.
_WAITING = """
import os
from deltaid.motion.excitation.excite import Exciter
held = os.open({alive!r}, os.O_WRONLY)
def wait(*_, **__):
    os.read(os.open({asked!r}, os.O_RDONLY), 1)
    os.write(held, b"alive ")
if os.fork() == 0:
    wait()
    os._exit(0)
Exciter.optimise = wait
"""


def test_a_job_that_is_cancelled_ends_with_all_it_started(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two named pipes tell it, without the clock or a list of processes.

    Who is alive holds one of them open, so its end is the end of all. Both processes read the other
    one: asked after the cancelling, they answer unless a signal waits for them.
    """
    alive, asked = tmp_path / "alive", tmp_path / "asked"
    for pipe in (alive, asked):
        os.mkfifo(pipe)
    before = _WAITING.format(alive=str(alive), asked=str(asked))
    monkeypatch.setattr(jobs, "_ENTRY", before + jobs._ENTRY)
    place = new_run(session.folder, "excite")
    step = excite_step("clavel-delta3", f"{place}/motion.csv", place)
    job = Job(step, session.folder, place)

    async def scenario() -> bytes:
        ended = os.open(alive, os.O_RDONLY | os.O_NONBLOCK)
        question = os.open(asked, os.O_RDWR)  # so that it waits for no reader
        task = asyncio.create_task(job.go())
        while not (job.stages or task.done()):
            await asyncio.sleep(0.05)
        os.set_blocking(ended, True)
        await job.cancel()
        os.write(question, b"??")
        with open(ended, "rb") as pipe:
            answers = await asyncio.to_thread(pipe.read)
        await task
        os.close(question)
        return answers

    assert asyncio.run(scenario()) == b""
    assert job.state == "cancelled"
    assert job._process.returncode is not None
    assert not (session.folder.root / place / "motion.csv").exists()


@pytest.mark.slow
def test_a_folder_that_is_removed_while_a_step_runs(session: Session) -> None:
    async def scenario() -> Job:
        job = session.begin("check", lambda at: check_step(Plan(robot="clavel-delta3"), at))
        while not job.stages:
            await asyncio.sleep(0.05)
        shutil.rmtree(session.folder.root)
        while session.busy:
            await asyncio.sleep(0.05)
        await session.close()
        return job

    job = asyncio.run(scenario())
    assert job.state == "failed"
    assert job.error
    assert "Traceback" not in job.error


def test_a_folder_that_is_gone_is_said(session: Session) -> None:
    shutil.rmtree(session.folder.root)
    session.store.look()
    assert session.store.changes == [""]
    with pytest.raises(DeltaidError, match="is no longer there"):
        session.folder.require()
    assert session.folder.files() == []
    with pytest.raises(DeltaidError, match="runs: cannot be used: No such file"):
        new_run(session.folder, "fit")


def test_a_recording_that_vanishes_is_missing(session: Session) -> None:
    used = Used(file="log.csv", mapping="mapping.yaml")
    (session.folder.root / "log.csv").write_text("t,q1\n0,1\n")
    (session.folder.root / "mapping.yaml").write_text("time: {column: t}\n")
    session.store.change(lambda plan: plan.changed(robot="h4").with_recording(used))
    assert unmapped(session) == []
    assert stage_states(session)["recording"] == "done"
    (session.folder.root / "log.csv").unlink()
    session.store.look()
    assert session.store.changes == ["", ""]
    assert unmapped(session) == ["log.csv"]
    assert stage_states(session)["recording"] == "open"


def test_the_recording_that_is_tested_on_needs_a_mapping_too(session: Session) -> None:
    for name in ("log.csv", "test.csv"):
        (session.folder.root / name).write_text("t,q1\n0,1\n")
    (session.folder.root / "mapping.yaml").write_text("time: {column: t}\n")
    fit = Used(file="log.csv", mapping="mapping.yaml")
    verify = Used(file="test.csv", use="verify")
    session.store.change(lambda p: p.changed(robot="h4").with_recording(fit).with_recording(verify))
    assert unmapped(session) == ["test.csv"]
    session.store.change(lambda plan: plan.with_recording(verify.changed(use="aside")))
    assert unmapped(session) == []


def test_no_tick_before_a_mapping_is_complete(session: Session) -> None:
    (session.folder.root / "log.csv").write_text("t,a,b,c\n0,1,2,3\n")
    used = Used(file="log.csv", mapping="mapping.yaml")
    session.store.change(lambda plan: plan.changed(robot="clavel-delta3").with_recording(used))
    assert stage_states(session)["recording"] == "open"  # there is no such file
    mapping, whole = session.folder.root / "mapping.yaml", "torque: {columns: [a, b, c], unit: A"
    for text, state in (
        (f"{whole}}}\n", "open"),
        (f"{whole}, torque_constant: 0.1}}\n", "done"),
        (f"{whole}, torque_constant: 0.1\n", "open"),
    ):
        mapping.write_text(text)
        assert stage_states(session)["recording"] == state
    mapping.write_text(f"{whole}, torque_constant: 0.1}}\n")
    session.drafts[draft_key(used)] = FileEdit("", {})  # half edited in some tab
    assert stage_states(session)["recording"] == "open"


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("picture.csv", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "no column of numbers"),
        ("empty.csv", b"", "is empty"),
        ("header.csv", b"t,q1,q2\n", "no column of numbers"),
        ("words.csv", b"t,q1\nmorning,high\nnoon,low\n", "no column of numbers"),
        ("noise.mat", b"\0" * 400, "damaged MATLAB file"),
        ("noise.parquet", b"PAR0" * 40, "no Parquet file"),
    ],
)
def test_what_is_no_recording_is_reported_at_once(
    tmp_path: Path, name: str, data: bytes, said: str
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(DeltaidError, match=said) as refused, Folder(tmp_path).called_by_name():
        count_columns(str(tmp_path / name))
    assert refused.value.cure
    assert refused.value.where.startswith(name)


def test_a_recording_of_any_names_may_be_one(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("when,a,b\nmorning,1,2\nnoon,3,4\n")
    assert count_columns(str(tmp_path / "log.csv")) == 3


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        said = refused("studio", tmp_path, "--port", port, folder=tmp_path)
    assert f"--port {port}: cannot be used" in said


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody writes to")
def test_a_folder_that_may_not_be_written_to_is_said(tmp_path: Path) -> None:
    said = refused("studio", "/proc/self", "--no-browser", folder=tmp_path)
    assert "/proc/self: cannot be used" in said


def test_a_robot_that_does_not_reach_stays_and_says_why() -> None:
    found = stage("clavel-delta3", "")
    assert [axis.name for axis in found.axes] == ["x", "y", "z"]
    view, home = robot_at("clavel-delta3", "", found.home, found.home)
    assert view.message == ""
    assert home.positions.shape == (len(found.bars), 3)
    struts = [k for k, bar in enumerate(found.bars) if bar.label == "struts"]
    assert home.scales[struts, 2] == pytest.approx(1.055)
    view, far = robot_at("clavel-delta3", "", (5.0, 0.0, -1.0), found.home)
    assert "stays where it was" in view.message
    assert far.positions == pytest.approx(home.positions)
    view, _ = robot_at("clavel-delta3", "", (0.0, 0.0, found.axes[2].low), found.home)
    assert "workspace height" in view.message


def test_a_robot_file_that_changes_is_shown_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(catalogue_text("clavel-delta3"))
    before = stage(str(path), "1")
    path.write_text(catalogue_text("clavel-delta3").replace("strut: 1.055", "strut: 1.155"))
    after = stage(str(path), "2")
    assert after.size > before.size + 0.01
    path.write_text("name: none\n")
    with pytest.raises(DeltaidError):
        stage(str(path), "3")


def test_turns_are_asked_for_in_degrees() -> None:
    found = stage("irb360-6-1600", "")
    assert found.axes[3].unit == "deg"
    turned, _ = robot_at("irb360-6-1600", "", (*found.home[:3], 30.0), found.home)
    assert turned.z[3] == pytest.approx(0.5236, abs=1e-4)
