"""From a log to windows of samples (z, q̇, q̈, τ) in constant memory, filtered where needed."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.columns import ColumnMapping
from deltaid.recording.filter import LowPass, apply, design_low_pass
from deltaid.recording.log import Log, open_log

# Samples a window yields: long against the filter's length, short against memory, and no power of
# two, because rows of an array that lie a power of two apart fight for the same lines of the cache.
WINDOW = 8000


FilteredLog = tuple[Log, LowPass | None]


@dataclass(frozen=True)
class Window:
    """Consecutive samples in rows, evenly spaced.

    With a filter, half its length stands as more samples at either end, because the filter is
    applied once more to what is computed from the window.

    Attributes:
        time [s], z, qd, qdd: the motion; filtered if there is a filter.
        tau: drive torques as recorded, never filtered here; no columns if the log has none.
    """

    time: Float[np.ndarray, " samples"]
    z: Float[np.ndarray, "samples dof"]
    qd: Float[np.ndarray, "samples dof"]
    qdd: Float[np.ndarray, "samples dof"]
    tau: Float[np.ndarray, "samples torques"]


def open_logs(
    paths: Sequence[str | Path],
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    cutoff: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[FilteredLog]:
    """Survey several recordings and choose a filter for each.

    Raises:
        RecordingError: there is none, or one cannot be used.
    """
    if not paths:
        raise RecordingError("no log was given")
    filtered = []
    for path in paths:
        progress(f"checking {path}")
        log = open_log(Path(path), kinematics, mapping)
        filtered.append((log, choose_filter(log, cutoff)))
    return filtered


def choose_filter(log: Log, cutoff: float | None = None) -> LowPass | None:
    """The filter for a log: none if velocities and accelerations are recorded, unless asked for.

    Raises:
        RecordingError: the log is too short, or the cut-off does not go with its rate.
    """
    if cutoff is None and log.has_derivatives:
        return None
    cutoff = cutoff or log.suggested_cutoff
    low_pass = design_low_pass(cutoff, log.rate) if cutoff else None
    needed = 8 * low_pass.margin if low_pass else 256
    if low_pass is None or log.samples < needed:
        raise RecordingError(
            f"has {log.samples} samples, too few to differentiate (at least {needed})",
            where=str(log.path),
            cure="record longer, or record velocities and accelerations as well",
        )
    return low_pass


def windows(log: Log, kinematics: Kinematics, low_pass: LowPass | None) -> Iterator[Window]:
    """All samples of a log, window by window.

    Velocities and accelerations that the log does not have come from differentiating the highest
    derivative it has, through the filter. Without a filter both must be recorded.
    """
    if low_pass is None:
        for block in _overlapping(log, WINDOW, 0):
            yield _as_recorded(block, log, kinematics)
        return
    size = -(-WINDOW // low_pass.decimation) * low_pass.decimation
    overlap = 2 * (low_pass.margin + len(low_pass.smooth) // 2)
    for block in _overlapping(log, size, overlap):
        yield _differentiated(block, log, kinematics, low_pass)


def _overlapping(log: Log, size: int, overlap: int) -> Iterator[Float[np.ndarray, "rows channels"]]:
    """Re-cut a log's batches into blocks that advance by `size` and share `overlap` rows."""
    parts: list[np.ndarray] = []
    held = 0
    for batch in log.batches():
        parts.append(batch.values)
        held += len(batch.values)
        if held < size + overlap:
            continue
        rows, start = np.concatenate(parts), 0
        while start + size + overlap <= len(rows):
            yield rows[start : start + size + overlap]
            start += size
        parts, held = [rows[start:]], len(rows) - start
    rest = np.concatenate(parts)
    if len(rest) > overlap:
        yield rest


def _split(block: np.ndarray, log: Log) -> tuple[np.ndarray, ...]:
    """Columns of a block as q, q̇, q̈, τ; empty where not recorded."""
    c = log.columns
    counts = [len(c.position), len(c.velocity), len(c.acceleration)]
    return tuple(np.split(block[:, 1:], np.cumsum(counts), axis=1))


def _as_recorded(block: np.ndarray, log: Log, kinematics: Kinematics) -> Window:
    q, qd, qdd, tau = _split(block, log)
    z, _ = kinematics.forward_unchecked(q)
    return Window(block[:, 0], z, qd, qdd, tau)


def _differentiated(
    block: np.ndarray, log: Log, kinematics: Kinematics, low_pass: LowPass
) -> Window:
    q, qd, qdd, tau = _split(block, log)
    reach = len(low_pass.first) - len(low_pass.smooth)
    inner = slice(reach // 2, len(block) - reach // 2)

    def smoothed(x: np.ndarray) -> np.ndarray:
        return apply(low_pass.smooth, x[inner].T).T

    def derivative(taps: np.ndarray, x: np.ndarray) -> np.ndarray:
        return apply(taps, x.T).T

    velocity = smoothed(qd) if qd.size else derivative(low_pass.first, q)
    if qdd.size:
        acceleration = smoothed(qdd)
    elif qd.size:
        acceleration = derivative(low_pass.first, qd)
    else:
        acceleration = derivative(low_pass.second, q)
    z, _ = kinematics.forward_unchecked(smoothed(q))
    trim = slice(low_pass.margin, len(block) - low_pass.margin)
    return Window(block[trim, 0], z, velocity, acceleration, tau[trim])
