"""Under `ulimit -v` a command works, or says that memory is lacking; it never hangs or aborts."""

import subprocess
import sys
from pathlib import Path

import pytest

from logs import recorded, write

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux keeps this limit")


def limited(size: float, *words: object, code: str = "") -> subprocess.CompletedProcess[str]:
    """A command with so much address space [B]; or, in place of commands, some code."""
    arguments = ["-m", "deltaid", *map(str, words)] if words else ["-c", code]
    return subprocess.run(
        [sys.executable, *arguments],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (int(size),) * 2),
        capture_output=True,
        text=True,
        timeout=60,
    )


# Too little for Python's own libraries, for BLAS, for threads of scipy and polars, for both.
@pytest.mark.parametrize("size", [8e7, 1.5e8, 2.1e8, 5e8, 1e9])
def test_too_little_memory_is_said_in_one_message(tmp_path: Path, size: float) -> None:
    log, model = write(tmp_path / "log.csv", recorded(300)), tmp_path / "model.yaml"
    ended = limited(size, "identify", "clavel-delta3", log, "-o", model)
    assert (ended.returncode, ended.stdout) == (2, ""), ended.stderr
    assert ended.stderr.count("error: ") == 1
    assert ended.stderr.startswith(f"error: address space limited to {size / 1e9:.2g} GB: ")
    assert "ulimit -v unlimited" in ended.stderr
    assert list(tmp_path.iterdir()) == [log]


ENDING = """
import os, sys
from deltaid.cli import app

@app.app.command()
def end():
    print("warned", file=sys.stderr)
    os.write(2, b"a library's words\\n")
    HOW

sys.argv = ["deltaid", "end"]
app.main()
"""


@pytest.mark.parametrize(
    ("how", "code", "message"),
    [
        ("os.abort()", 2, "ended for lack of memory; its last words: a library's words\n  →"),
        ("os._exit(1)", 2, "ended for lack of memory"),
        ("raise MemoryError('no room')", 2, "MemoryError: no room"),
        ("sys.exit(4)", 4, "warned\na library's words\n"),
        ("os.kill(os.getppid(), 15); import time; time.sleep(60)", 143, "ended by SIGTERM"),
    ],
)
def test_a_limited_command_ends_as_it_would(how: str, code: int, message: str) -> None:
    ended = limited(4e9, code=ENDING.replace("HOW", how))
    assert ended.returncode == code
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr


def test_what_needs_little_works(tmp_path: Path) -> None:
    assert limited(1e9, "robots").stdout.count("\n") > 5
    assert limited(1e9, "identify", "--help").returncode == 0
