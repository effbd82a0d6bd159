"""Under `ulimit -v` a command works, or says that memory is lacking; it never hangs or aborts."""

import subprocess
import sys
from pathlib import Path

import pytest

from logs import recorded, write

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux keeps this limit")


def limited(size: float, *words: object) -> subprocess.CompletedProcess[str]:
    """A command with so much address space [B]."""
    return subprocess.run(
        [sys.executable, "-m", "deltaid", *map(str, words)],
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


def test_what_needs_little_works() -> None:
    assert limited(1e9, "robots").stdout.count("\n") > 5
    assert limited(1e9, "identify", "--help").returncode == 0
