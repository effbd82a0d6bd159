"""A studio in a process of its own, its visitors, and recordings that need a mapping."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import polars as pl

SOURCE = Path(__file__).parents[1] / "src"
ENTRY = "from deltaid.cli import main; main()"


class Studio:
    """`deltaid studio FOLDER`, until it is closed."""

    def __init__(self, folder: Path) -> None:
        # NiceGUI behaves in another way where it sees a test.
        plain = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
        environment = plain | {"PYTHONPATH": str(SOURCE), "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", ENTRY, "studio", str(folder), "--port", "0", "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            text=True,
        )
        assert self._process.stdout is not None
        said = self._process.stdout.readline()
        found = re.search(r"(http://127\.0\.0\.1:(\d+))/\?token=(\S+)", said)
        assert found, said + self.errors()
        self.base, self.port, self.token = found[1], int(found[2]), found[3]
        self.address = found[0]
        self._said: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        self._said += self._process.stderr

    def errors(self) -> str:
        """What it has said on standard error; read when it has ended."""
        return "".join(getattr(self, "_said", []))

    def close(self) -> None:
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._reader.join(5)

    def __enter__(self) -> "Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def foreign(path: Path, log: pl.DataFrame, *, late: int = 0, turned: int | None = None) -> Path:
    """A log as another program writes it: its own names, degrees, ms, and set points beside.

    Args:
        late: torques come so many rows late.
        turned: number of a drive whose torque has the other sign.
    """
    rows = len(log) - late
    columns = {"Timestamp [ms]": np.round(1e3 * log["t"].to_numpy()[late:], 6)}
    for i in (1, 2, 3):
        angle = np.rad2deg(log[f"q{i}"].to_numpy()[late:])
        torque = log[f"tau{i}"].to_numpy()[:rows]
        columns[f"Axis{i}.SetPos"] = angle
        columns[f"Axis{i}.ActPos"] = angle
        columns[f"Axis{i}.ActTorque"] = -torque if i == turned else torque
    pl.DataFrame(columns).write_csv(path)
    return path
