"""A run as a file that a controller replays and `deltaid torque` reads."""

from pathlib import Path

import numpy as np
import polars as pl

from deltaid.excitation.run import Run
from deltaid.files import written_whole
from deltaid.mechanism.kinematics import Kinematics

_TASK_NAMES = ("x", "y", "z", "psi")


def sample_run(kinematics: Kinematics, run: Run, rate: float) -> pl.DataFrame:
    """A run at a fixed rate: columns t, q1…, qd1…, qdd1…, x, y, z (and psi), SI units.

    The first and the last row are at rest.
    """
    steps = int(np.ceil(run.duration * rate - 1e-9))
    time = np.arange(steps + 1) / rate
    z, zd, zdd = run.evaluate(np.minimum(time, run.duration))
    drives = kinematics.drive_motion(z, zd, zdd)
    columns = {"t": time}
    for name, values in zip(("q", "qd", "qdd"), drives, strict=True):
        columns |= {f"{name}{i + 1}": values[:, i] for i in range(values.shape[1])}
    columns |= {name: z[:, i] for i, name in enumerate(_TASK_NAMES[: z.shape[1]])}
    return pl.DataFrame(columns)


def write_run(kinematics: Kinematics, run: Run, rate: float, path: Path) -> None:
    """Write a run as CSV, whole or not at all.

    Raises:
        DeltaidError: the file cannot be written.
    """
    with written_whole(path) as file:
        file.write(sample_run(kinematics, run, rate).write_csv())
