"""From a log to windows of samples (z, q̇, q̈, τ) in constant memory, filtered where needed."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.columns import ColumnMapping
from deltaid.recording.filter import (
    LowPass,
    SpectrumEstimate,
    apply,
    design_low_pass,
    samples_needed,
)
from deltaid.recording.log import Log, open_log
from deltaid.recording.table import recut

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
    # Before the design, because a tiny cut-off asks for an endless filter.
    needed = (
        samples_needed(cutoff, log.rate, str(log.path)) if cutoff else SpectrumEstimate.SHORTEST
    )
    if not cutoff or log.samples < needed:
        at = f" at {cutoff:.4g} Hz" if cutoff else ""
        raise RecordingError(
            f"has {log.samples} samples, too few to filter and differentiate{at} (at least "
            f"{needed:g})",
            where=str(log.path),
            cure="record longer, or record velocities and accelerations as well",
        )
    return design_low_pass(cutoff, log.rate)


def windows(log: Log, kinematics: Kinematics, low_pass: LowPass | None) -> Iterator[Window]:
    """All samples of a log, window by window.

    Velocities and accelerations that the log does not have come from differentiating the highest
    derivative it has, through the filter. Without a filter both must be recorded.
    """
    rows = (batch.values for batch in log.batches())
    if low_pass is None:
        for block in recut(rows, WINDOW):
            yield _as_recorded(block, log, kinematics)
        return
    size = -(-WINDOW // low_pass.decimation) * low_pass.decimation
    overlap = 2 * (low_pass.margin + len(low_pass.smooth) // 2)
    for block in recut(rows, size, overlap):
        yield _differentiated(block, log, kinematics, low_pass)


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
