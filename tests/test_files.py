"""Files appear whole or not at all, several together or none, and leave nothing behind."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from command import run
from deltaid.errors import DeltaidError
from deltaid.files import new_folder, require_writable, together, write_bytes, written_whole
from logs import recorded, write


def listing(folder: Path) -> list[str]:
    """All files and folders below."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def full_disk() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def write_two(first: Path, second: Path, error: Exception | None = None) -> None:
    with together():
        write_bytes(first, b"new")
        with written_whole(second) as file:
            file.write("new")
            if error is not None:
                raise error


def test_several_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    first, second = write(tmp_path / "a", "old"), tmp_path / "deep" / "er" / "b"
    with pytest.raises(DeltaidError, match="b: cannot be written: No space left"):
        write_two(first, second, full_disk())
    with pytest.raises(KeyError):
        write_two(first, second, KeyError())
    assert (first.read_text(), listing(tmp_path)) == ("old", ["a"])
    write_two(first, second)
    assert listing(tmp_path) == ["a", "deep", "deep/er", "deep/er/b"]
    assert (first.read_text(), second.read_text()) == ("new", "new")
    write_two(tmp_path / "c", tmp_path / "d")  # the one before is over
    assert {"c", "d"} < set(listing(tmp_path))


def test_blocks_inside_one_another_are_one(tmp_path: Path) -> None:
    def inner_is_done_outer_fails() -> None:
        with together():
            write_two(tmp_path / "a", tmp_path / "b")
            assert not (tmp_path / "a").exists()
            raise KeyError

    with pytest.raises(KeyError):
        inner_is_done_outer_fails()
    assert listing(tmp_path) == []


def test_a_folder_that_cannot_be_made_leaves_none(tmp_path: Path) -> None:
    def taken_meanwhile() -> None:
        with together():
            write_bytes(tmp_path / "x" / "a", b"")
            write_bytes(tmp_path / "y" / "b", b"")
            write(tmp_path / "y", "a file now")

    with pytest.raises(DeltaidError, match="b: cannot be written"):
        taken_meanwhile()
    assert listing(tmp_path) == ["y"]


def test_a_folder_that_another_process_makes_meanwhile_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Path.mkdir

    def made_by_the_other_as_well(folder: Path, **settings: bool) -> None:
        make(folder)
        make(folder, **settings)

    monkeypatch.setattr(Path, "mkdir", made_by_the_other_as_well)
    write_bytes(tmp_path / "x" / "y" / "a", b"new")
    assert (tmp_path / "x" / "y" / "a").read_bytes() == b"new"


def test_others_may_read_a_file_as_the_mask_of_the_process_says(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_asking_whether_a_file_can_be_written_makes_nothing(tmp_path: Path) -> None:
    require_writable(tmp_path / "no" / "folder" / "yet.csv")
    assert listing(tmp_path) == []
    with pytest.raises(DeltaidError, match="a is a file, not a folder"):
        require_writable(write(tmp_path / "a", "") / "b" / "c.csv")


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("log") / "log.csv", recorded(1500))


def test_commands_that_fail_make_no_folders(tmp_path: Path, log: Path) -> None:
    broken = write(tmp_path / "broken.csv", log.read_text().replace("tau1", "x"))
    outcome = run("identify", "clavel-delta3", broken, "-o", tmp_path / "new" / "model.yaml")
    assert outcome.code == 2
    assert listing(tmp_path) == ["broken.csv"]


@pytest.mark.skipif(sys.platform != "linux", reason="file sizes are limited as Linux does it")
def test_a_full_disk_leaves_the_old_model_beside_the_old_report(tmp_path: Path, log: Path) -> None:
    """The report needs megabytes, of which there are none; the model would fit."""
    model, report = write(tmp_path / "m.yaml", "old"), write(tmp_path / "r.html", "old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))
    try:
        done = run("identify", "clavel-delta3", log, "-o", model, "--report", report)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (done.code, done.out) == (2, "")
    assert "r.html: cannot be written: File too large" in done.err
    assert (model.read_text(), report.read_text()) == ("old", "old")
    assert listing(tmp_path) == ["m.yaml", "r.html"]


WAITING = """
import sys, time
from pathlib import Path
from deltaid.cli import app, main
import deltaid.cli.app as app
from deltaid.files import together, write_bytes, written_whole

@app.app.command()
def wait(path: Path):
    with together():
        write_bytes(path.with_suffix(".yaml"), b"finished")
        with written_whole(path) as file:
            file.write("begun")
            print("waiting", flush=True)
            time.sleep(60)

main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, marks=pytest.mark.slow),
    ],
)
def test_a_command_that_is_ended_leaves_nothing(tmp_path: Path, number: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WAITING, "wait", str(tmp_path / "new" / "a.csv")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "waiting\n"
    assert len(listing(tmp_path)) == 2
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert "Traceback" not in stderr
    assert listing(tmp_path) == []


KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
from deltaid.files import together, write_bytes

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # as nohup does not leave it
renamed, left = Path.replace, int(sys.argv[3])
def replace(self, target):
    global left
    renamed(self, target)
    left -= 1
    if left <= 0:
        os.kill(os.getpid(), int(sys.argv[2]))
Path.replace = replace
folder = Path(sys.argv[1])
with together():
    for name in "abc":
        write_bytes(folder / name, b"new")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_all_names_change_before_a_process_ends(tmp_path: Path, number: int) -> None:
    for name in "abc":
        write(tmp_path / name, "old")
    assert killed_while_writing(tmp_path, number, 1) == ["new"] * 3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("renamed", [1, 2])
def test_a_kill_between_two_names_leaves_whole_files(tmp_path: Path, renamed: int) -> None:
    """Each is new or old, and the next command removes what has no name yet."""
    for name in "abc":
        write(tmp_path / name, "old")
    held = killed_while_writing(tmp_path, signal.SIGKILL, renamed)
    assert held == ["new"] * renamed + ["old"] * (3 - renamed)
    assert len(listing(tmp_path)) == 6 - renamed
    require_writable(tmp_path / "d")
    assert listing(tmp_path) == ["a", "b", "c"]


def killed_while_writing(folder: Path, number: int, after: int) -> list[str]:
    """What three files hold behind a process that is killed when so many have their names."""
    words = [str(folder), str(int(number)), str(after)]
    script = [sys.executable, "-c", KILLED_WHILE_WRITING, *words]
    ended = subprocess.run(script, capture_output=True, check=False)
    assert ended.returncode == -number
    return [(folder / name).read_text() for name in "abc"]


@pytest.mark.skipif(sys.platform == "win32", reason="nobody can ask there whether a process lives")
def test_what_a_killed_process_was_writing_goes(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path; from deltaid import files\n"
        "with files.new_folder(Path('folder')) as folder, files.written_whole(Path('a')) as file:\n"
        "    os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=False)
    assert len(listing(tmp_path)) == 2
    with written_whole(tmp_path / "b") as file:
        file.write("whole")
        assert len(listing(tmp_path)) == 1  # that of this process stays
    assert listing(tmp_path) == ["b"]


@pytest.mark.parametrize("name", ["n" * 300, "nul\0", "loop", "loop/within"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for attempt in (require_writable, lambda path: write_bytes(path, b"")):
        with pytest.raises(DeltaidError, match="cannot be written"):
            attempt(tmp_path / name)
    with pytest.raises(DeltaidError), new_folder(tmp_path / name):
        pass
    assert listing(tmp_path) == ["loop"]


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "clavel-delta3", "NAME"),
        ("gather", "clavel-delta3", "LOG", "-o", "NAME"),
        ("export", "clavel-delta3", "--to", "mjcf", "-o", "NAME"),
        ("drift", "clavel-delta3", "NAME"),
        ("fleet", "NAME", "-o", "fleet"),
        ("fleet", "fleet.yaml", "-o", "NAME"),
        ("new", "NAME", "--kind", "delta", "--yes"),
        ("sample", "clavel-delta3", "-o", "NAME"),
    ],
)
def test_commands_refuse_names_that_no_file_can_have(
    tmp_path: Path, log: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for name in ("n" * 300 + ".yaml", "n" * 5000, "nul\0", "loop/a.yaml"):
        given = {"NAME": tmp_path / name, "LOG": log}
        done = run(*(given.get(word, word) for word in words))
        assert done.code == 2, done.err


@pytest.mark.parametrize("name", ["", " "])
@pytest.mark.parametrize(
    ("words", "before"),
    [
        (("gather", "clavel-delta3", "LOG", "-o", "NAME"), "-o ''"),
        (("gather", "clavel-delta3", "LOG", "--output=NAME"), "--output ''"),
        (("demo", "clavel-delta3", "--keep", "NAME"), "--keep ''"),
        (("identify", "clavel-delta3", "NAME"), "clavel-delta3 ''"),
        (("NAME",), "deltaid ''"),
    ],
)
def test_an_empty_name_is_not_the_current_folder(
    log: Path, words: tuple[str, ...], before: str, name: str
) -> None:
    done = run(*(word.replace("NAME", name).replace("LOG", str(log)) for word in words))
    assert done.code == 2
    assert done.err.startswith(f"error: {before}: nothing is given")
    assert "variable of the shell" in done.err
