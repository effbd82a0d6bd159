"""Torque columns that are copies of each other: a drive's own torque is not recorded."""

import numpy as np

from deltaid.check.evidence import Evidence
from deltaid.errors import RecordingError

# Columns of numbers with so little of their own are one signal; positions that differ by so much
# are of drives that move unlike each other, whose torques must differ.
_COPIED, _UNLIKE = 1e-9, 1e-5


def refuse_copies(evidence: Evidence) -> None:
    """Refuse a torque column that is another one's, times a factor.

    Raises:
        RecordingError: it is, and the two drives move in different ways.
    """
    rows, names = evidence.rows, evidence.robot.drives
    if rows.tau.shape[1] != len(names) or rows.q.shape[1] != len(names):
        return
    finite = np.isfinite(np.hstack([rows.q, rows.tau])).all(axis=1)
    q, tau = (_normalised(values[finite]) for values in (rows.q, rows.tau))
    alike, moves = tau.T @ tau, q.T @ q
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        if alike[i, j] ** 2 > 1 - _COPIED and moves[i, j] ** 2 < 1 - _UNLIKE:
            columns = [evidence.columns.torque[k].column for k in (i, j)]
            raise RecordingError(
                f"the torques of {names[i]} and {names[j]} are one signal: column "
                f"'{columns[0]}' and column '{columns[1]}' repeat each other in every row, and "
                "the drives move unlike each other",
                where=str(evidence.table.path),
                cure="map each drive's own torque; if only one of them was recorded, record again",
            )


def _normalised(values: np.ndarray) -> np.ndarray:
    """Columns about their means, of length 1; 0 where nothing changes."""
    centred = values - values.mean(axis=0) if len(values) else values
    length = np.linalg.norm(centred, axis=0)
    return centred / np.where(length > 0, length, 1.0)
