"""Whether a recording's columns are what they are taken for, as far as that shows before it runs.

Where the model's torques go along with those recorded, drive by drive, columns are what they are
taken for. Else signs, order and units are judged as an identification judges them, and what is
wrong is refused as there.
"""

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.errors import Doubt, RecordingError
from deltaid.model.model import Model
from deltaid.model.verdict import Grade
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import with_filter

# What is judged elsewhere: the size of torques by the run, as the model knows it better than the
# prior does, and velocities with what comes of it (`speeds`).
_ELSEWHERE = {"torque-unit", "velocity"}
# Torques that correlate so much with the model's are those of the same drives. Loads that nobody
# told take from that, so it is no more.
_ALONG, _WINDOWS = 0.85, 4


def judged_wiring(
    model: Model, opened: Log, log: RecordingLike, mapping: ColumnMapping
) -> tuple[Doubt, ...]:
    """What looks wrong of units, signs and order of columns.

    Args:
        opened: the log, surveyed.

    Raises:
        RecordingError: what surely is.
    """
    if np.all(_along(model, opened) > _ALONG):
        return ()
    found = checked_wiring(evidence(model.robot, log, mapping))
    told = [one for one in found if one.key not in _ELSEWHERE]
    for one in told:
        if one.grade is Grade.WRONG:
            raise RecordingError(
                one.finding,
                where=str(opened.path),
                cure=f"{one.cure}; `deltaid check` tells more",
            )
    return tuple(
        Doubt(one.seen, cause=one.cause, cure=one.cure, key=one.key)
        for one in told
        if one.grade is Grade.DOUBTFUL
    )


def _along(model: Model, opened: Log) -> Float[np.ndarray, " drives"]:
    """Correlation of recorded torques with the model's, drive by drive; 0 where there is none."""
    dynamics, pairs = model.dynamics, list[np.ndarray]()
    try:
        for window in with_filter(opened).spread(dynamics.kinematics, _WINDOWS):
            wide = window.wide
            torque = dynamics.torque(wide.z, wide.qd, wide.qdd, model.p)
            pairs.append(np.stack([window.smoothed(x.T) for x in (wide.tau, torque)]))
    except RecordingError:  # whose cause is told by what follows
        return np.zeros(dynamics.dof)
    both = np.concatenate([np.zeros((2, dynamics.dof, 0)), *pairs], axis=2)
    both = both - both.mean(axis=2, keepdims=True) if both.size else both
    scale = np.sqrt(np.sum(both[0] ** 2, axis=1) * np.sum(both[1] ** 2, axis=1))
    return np.sum(both[0] * both[1], axis=1) / np.maximum(scale, np.finfo(float).tiny)
