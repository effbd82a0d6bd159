"""Doubts about planned motions: rows without results at the ends, and accelerations that the
filter removes."""

import numpy as np
from scipy.special import ndtri

from deltaid.errors import Doubt
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.planned import UNSURE
from deltaid.recording.recording import PreparedRecording

# Weights of a second difference, and number of windows in which differences are compared.
_SECOND, _WINDOWS = (1.0, -2.0, 1.0), 4


def unknown_ends(recording: PreparedRecording, quantity: str, cure: str) -> list[str]:
    """Warning about rows at the ends for which nothing is computed; empty without such rows."""
    first, last = recording.without
    spans = [f"the first {first}"] * bool(first) + [f"the last {last}"] * bool(last)
    if not spans:
        return []
    seen = (
        f"{recording.path}: {' and '.join(spans)} of {recording.log.samples} rows have no "
        f"{quantity}: the filter needs rows beyond"
    )
    return [Doubt(seen, cause="the motion does not rest at that end", cure=cure)]


def smoothed_away(recording: PreparedRecording, kinematics: Kinematics) -> list[str]:
    """Warning if the filter removes a part of a plan's accelerations, by second differences in some
    windows; empty if not, or if noise of positions hides it.

    The noise is estimated by that of positions or by the median difference, whichever is smaller.
    """
    low_pass, log = recording.low_pass, recording.log
    if low_pass is None:
        return []
    off, filtered = zip(
        *(
            (np.diff(window.off, 2, axis=0) * log.rate**2, window.wide.qdd[1:-1])
            for window in recording.spread(kinematics, _WINDOWS)
        ),
        strict=True,
    )
    taken = np.vstack(off)
    noise = np.minimum(
        np.linalg.norm(_SECOND) * log.position_noise * log.rate**2,
        np.median(np.abs(taken), axis=0) / ndtri(0.75),
    )
    left, every = (
        np.maximum(np.mean(x**2, axis=0) - noise**2, np.finfo(float).tiny)
        for x in (taken, taken + np.vstack(filtered))
    )
    shares = np.where(noise < UNSURE * np.sqrt(every), np.sqrt(left / every), 0.0)
    worst = int(np.argmax(shares))
    if shares[worst] <= UNSURE:
        return []
    seen = (
        f"{recording.path}: the filter, {low_pass.motion_cutoff:.3g} Hz for rows at {log.rate:.4g} "
        f"Hz, removes {100 * shares[worst]:.0f} % of {kinematics.robot.drives[worst]}'s "
        "acceleration"
    )
    cause = "rows are too far apart for the motion, or it jumps"
    return [Doubt(seen, cause=cause, cure="give velocities and accelerations, or more rows")]
