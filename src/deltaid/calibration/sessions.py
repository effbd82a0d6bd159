"""What a fit says of the readings of each file: residuals, noise, and what was excluded and why."""

from dataclasses import dataclass

import numpy as np

from deltaid.calibration.fit import is_quiet
from deltaid.calibration.gauss_newton import GeometryFit
from deltaid.calibration.instruments import ProbeReadings
from deltaid.sensors.planning.offers import PoseKind


@dataclass(frozen=True)
class MeasuringSession:
    """Readings of one file.

    Attributes:
        kind, source: of the instrument, and its file.
        readings: how many there are.
        excluded: what was excluded, in words.
        residual: of those used, root mean square [m].
        noise: standard deviation that the fit took [m].
        grown: how many times that is what was stated.
        quiet: whether residuals are far below that, as where noise is stated ten times too large.
    """

    kind: PoseKind
    source: str
    readings: int
    excluded: tuple[str, ...]
    residual: float
    noise: float
    grown: float
    quiet: bool


def session(found: GeometryFit, i: int) -> MeasuringSession:
    """What a fit says of its i-th instrument."""
    instrument, used, rows = found.instruments[i], found.used[i], found.rows[i]
    excluded = []
    for k in np.flatnonzero(~used):
        first = instrument.repeats[k]
        why = f"off by {1e3 * np.abs(found.errors[i][k]).max():.3g} mm"
        if first != k:
            why = f"the same as row {instrument.rows[first]}"
        elif (other := _mistaken(found, i, int(k))) is not None:
            why += f", it fits the pose of row {instrument.rows[other]}"
        excluded.append(f"row {instrument.rows[k]}: {why}")
    return MeasuringSession(
        instrument.kind, instrument.source, len(used), tuple(excluded),
        float(np.sqrt(np.mean(rows.error**2))) * instrument.noise, instrument.noise, found.grown[i],
        is_quiet(found, i),
    )  # fmt: skip


def _mistaken(found: GeometryFit, i: int, k: int) -> int | None:
    """The other excluded row whose prediction a reading fits, to a hundredth of its error."""
    values = found.instruments[i].values
    far = np.linalg.norm(values[k] - (values - found.errors[i]), axis=1)
    others = np.flatnonzero(~found.used[i] & (far < 0.01 * far[k]))
    probed = isinstance(found.instruments[i], ProbeReadings)
    return int(others[0]) if others.size and not probed else None
