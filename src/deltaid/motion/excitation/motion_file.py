"""A run as a file that a controller replays and `deltaid torque` reads."""

from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.files import written_whole
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.excitation.run import Run

# The longest run [s], ten hours, and the most rows of a file, some ten gigabytes.
LONGEST, MOST_ROWS = 36_000.0, 3e7
# Rows that are computed and written at once.
_BLOCK = 1 << 16


def sample_run(kinematics: Kinematics, run: Run, rate: float) -> pl.DataFrame:
    """A run at a fixed rate: columns t, q1…, qd1…, qdd1…, x, y, z (and psi), SI units.

    The first and the last row are at rest.
    """
    return _sampled(kinematics, run, np.arange(run_rows(run, rate)) / rate)


def run_rows(run: Run, rate: float) -> int:
    """Number of rows of a run at a fixed rate."""
    return int(np.ceil(run.duration * rate - 1e-9)) + 1


def _sampled(kinematics: Kinematics, run: Run, time: Float[np.ndarray, " rows"]) -> pl.DataFrame:
    z, zd, zdd = run.evaluate(np.minimum(time, run.duration))
    drives = kinematics.drive_motion(z, zd, zdd)
    columns = {"t": time}
    for name, values in zip(("q", "qd", "qdd"), drives, strict=True):
        columns |= {f"{name}{i + 1}": values[:, i] for i in range(values.shape[1])}
    columns |= {name: z[:, i] for i, name in enumerate(kinematics.robot.task.names)}
    return pl.DataFrame(columns)


def write_run(kinematics: Kinematics, run: Run, rate: float, path: Path) -> None:
    """Write a run as CSV, whole or not at all, in constant memory.

    Raises:
        DeltaidError: the file cannot be written.
    """
    rows = run_rows(run, rate)
    with written_whole(path) as file:
        for start in range(0, rows, _BLOCK):
            part = _sampled(kinematics, run, np.arange(start, min(start + _BLOCK, rows)) / rate)
            file.write(part.write_csv(include_header=start == 0))
