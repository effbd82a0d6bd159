"""Work on this machine's processes: all of it is done, no port is open, none outlives its call."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from deltaid.fleets.workers import open_workers
from deltaid.mechanism.user_code import named_path, use_mechanism
from deltaid.robot import own


def _work(item: int) -> int:
    assert named_path() is not None
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 4:
        raise ValueError("four")
    return item**2


@pytest.mark.parametrize("workers", [1, 2])
def test_what_kills_a_process_stops_nothing_else(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All workers, also those that take the place of others, know the user's own mechanism."""
    monkeypatch.setattr(own, "_named", [])
    (tmp_path / "mine.py").write_text("def mechanism(z): pass\n", encoding="utf-8")
    use_mechanism(tmp_path / "mine.py")
    failed: dict[int, str] = {}

    def note(item: int, why: str) -> int:
        failed[item] = why
        return -item

    with open_workers(count=workers) as pool:
        for _ in range(2):
            results = sorted(pool.done(_work, range(8), note))
            assert results == [-4, -3, 0, 1, 4, 25, 36, 49]
    assert failed[3].startswith("workers die of it")
    assert failed[4].endswith("ValueError: four")


WAITING = """
import time
from deltaid.fleets.workers import open_workers
from test_fleet_pool import wait

with open_workers(count=2) as pool:
    for pid in pool.done(wait, [0.0, 0.0, 60.0, 60.0], lambda item, why: why):
        print(pid, flush=True)
"""


def wait(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_open_no_port_and_end_with_their_call(tmp_path: Path, number: int) -> None:
    """The script has no guard: workers do not import it."""
    script = tmp_path / "call.py"
    script.write_text(WAITING)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as call:
        assert call.stdout is not None
        assert call.stdout.readline()
        assert call.stdout.readline()
        parent = psutil.Process(call.pid)
        workers = parent.children(recursive=True)
        assert len(workers) >= 2
        assert all(not process.net_connections(kind="all") for process in (parent, *workers))
        began = time.monotonic()
        call.send_signal(number)
        _, said = call.communicate(timeout=60)
        assert b"bootstrapping" not in said
        assert call.returncode != 0
        assert not psutil.wait_procs(workers, timeout=60)[1]
        assert time.monotonic() - began < 30
