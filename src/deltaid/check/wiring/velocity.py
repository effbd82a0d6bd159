"""Whether recorded velocities are the derivatives of recorded positions: scale, drive, lag.

Both pass the same low-pass, d = q̇ of the positions and v the column, and v = k (d − δ ḋ) is fitted
by least squares: k is its scale, δ its lag. The scatter between blocks of time says how certain.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map
from deltaid.recording.convolution import apply

_BLOCKS = 16
# A drive that moves less than this share of the liveliest one tells nothing.
_RESTS = 1e-6


@dataclass(frozen=True)
class Rate:
    """One velocity column beside the derivatives of all positions.

    Attributes:
        drive: whose column it should be.
        nearest: drive whose derivative it goes with best.
        correlation: with that one's, and `own` with its own's.
        scale: k, of the nearest.
        lag: δ behind it [s], with its standard deviation.
    """

    drive: int
    nearest: int
    correlation: float
    own: float
    scale: float
    lag: float
    lag_std: float


def rates(motion: Motion, map: Map) -> tuple[Rate, ...]:
    """Every recorded velocity column of a drive that moves."""
    raw = motion.raw_qd
    if not raw.shape[1]:
        return ()
    full, inner = motion.full, motion.full.margin - motion.full.half
    v = apply(full.smooth, raw[inner : len(raw) - inner].T, motion.every).T
    d, dd = map.rates(motion.qd), map.rates(motion.qdd)
    size = np.sqrt(np.mean(d**2, axis=0))
    moving = size > _RESTS * size.max()
    norm = np.linalg.norm(d, axis=0)[:, None] * np.linalg.norm(v, axis=0)[None]
    together = np.abs(d.T @ v) / np.where(norm > 0, norm, np.inf)
    together[~moving] = 0.0
    return tuple(
        _rate(i, int(np.argmax(together[:, i])), together[:, i], d, dd, v[:, i])
        for i in range(v.shape[1])
        if moving[i] and np.ptp(v[:, i]) > 0
    )


def _rate(
    drive: int,
    nearest: int,
    together: Float[np.ndarray, " drives"],
    d: Float[np.ndarray, "samples drives"],
    dd: Float[np.ndarray, "samples drives"],
    v: Float[np.ndarray, " samples"],
) -> Rate:
    A = np.column_stack([d[:, nearest], dd[:, nearest]])
    (k, b), *_ = np.linalg.lstsq(A, v, rcond=None)
    # What each residual moves b by; those of a block of time may hang together.
    moved = np.linalg.pinv(A)[1] * (v - A @ (k, b))
    blocks = np.array([part.sum() for part in np.array_split(moved, _BLOCKS)])
    std = np.sqrt(blocks @ blocks * _BLOCKS / (_BLOCKS - 2))
    return Rate(
        drive,
        nearest,
        float(together[nearest]),
        float(together[drive]),
        float(k),
        float(-b / k),
        float(std / abs(k)),
    )
