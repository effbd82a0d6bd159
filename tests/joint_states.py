"""Messages of three joints' states, and how tables of bags are read or refused."""

from pathlib import Path

import numpy as np
import pytest

from bags import states
from deltaid.errors import RecordingError
from deltaid.recording.source import Table
from deltaid.recording.table import open_table

JOINTS = ["joint_1", "joint_2", "joint_3"]
ROWS = 500
TIME = np.arange(ROWS) / 1000
RNG = np.random.default_rng(5)
COLUMNS = {key: RNG.normal(size=(ROWS, 3)) for key in ("position", "velocity", "effort")}
MESSAGES = states(TIME, COLUMNS, JOINTS)
NAMES = [f"{short}{i + 1}" for short in ("q", "qd", "tau") for i in range(3)]
ALL = np.hstack([TIME[:, None], *COLUMNS.values()])


def read(table: Table, columns: list[str]) -> np.ndarray:
    return np.vstack([np.column_stack(rows.numbers) for rows in table.rows(columns)])


def address(quantity: str, joint: str, topic: str = "/joint_states") -> str:
    return f"{topic}.{quantity}[{joint}]"


def told(path: Path) -> str:
    """What is said of a bag that cannot be read; nothing if it can."""
    try:
        read(open_table(path), ["t", *NAMES])
    except RecordingError as error:
        return str(error)
    return ""


def refused(path: Path, columns: list[str]) -> str:
    with pytest.raises(RecordingError) as caught:
        read(open_table(path), columns)
    return str(caught.value)
