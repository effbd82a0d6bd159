"""Recordings as other programs write them, which need a mapping."""

from pathlib import Path

import numpy as np
import polars as pl


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


# Of the motors of a recording in German: motor revolutions per joint revolution, N m per A.
GEAR, TORQUE_CONSTANT = 20.0, 0.11


def german(path: Path, log: pl.DataFrame, *, turned: int | None = None) -> Path:
    """A log of motors in German: decimal commas, ms, degrees and amperes before the gear.

    Args:
        turned: number of a drive that counts the other way, in angle and current.
    """
    columns = {"Zeitstempel [ms]": 1e3 * log["t"].to_numpy()}
    signs = {i: -1 if i == turned else 1 for i in (1, 2, 3)}
    for i, sign in signs.items():
        angle = np.rad2deg(log[f"q{i}"].to_numpy())
        columns[f"Istposition Achse {i} [°]"] = sign * GEAR * angle
    for i, sign in signs.items():
        current = log[f"tau{i}"].to_numpy() / GEAR / TORQUE_CONSTANT
        columns[f"Motorstrom Achse {i} [A]"] = sign * current
    pl.DataFrame(columns).write_csv(
        path, separator=";", decimal_comma=True, float_precision=6, quote_style="never"
    )
    return path
