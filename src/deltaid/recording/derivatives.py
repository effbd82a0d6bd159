"""Whether recorded velocities are the derivatives of recorded positions: units, signs, order.

Both are compared over stretches of a few hundredths of a second, where encoder steps and noise
count little: with Δq the change of position and ∫v dt the integral of velocity, the share
k = Σ ∫v dt Δq / Σ Δq² is 1 when both columns are declared rightly.
"""

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError

_STRETCH = 0.02  # s
# Columns that go together this well (squared correlation) must agree in scale; below the other
# value they hardly belong to the same drive.
_TOGETHER, _APART = 0.9, 0.3
_SCALE = (0.8, 1.25)
_SLIGHT = 1e-3  # rms of Δq [rad, rad/s] below which a drive counts as resting
_LIKELY = {"degrees": 180 / np.pi, "rpm": 30 / np.pi}


class DerivativeCheck:
    """Compares pairs of columns batch by batch: the second should be the rate of the first."""

    def __init__(self, names: list[tuple[str, str]]) -> None:
        self._names = names
        self._sums = np.zeros((3, len(names)))  # Δq², (∫v dt)², their product
        self._stretches = 0

    def add(
        self,
        time: Float[np.ndarray, " rows"],
        x: Float[np.ndarray, "rows pairs"],
        rate: Float[np.ndarray, "rows pairs"],
    ) -> None:
        """Take in consecutive rows."""
        if not self._names or len(time) < 2:
            return
        step = np.diff(time)
        every = max(1, round(_STRETCH * len(step) / float(time[-1] - time[0])))
        area = 0.5 * (rate[1:] + rate[:-1]) * step[:, None]
        integral = np.vstack([np.zeros(area.shape[1]), np.cumsum(area, axis=0)])
        change, expected = (np.diff(v[::every], axis=0) for v in (x, integral))
        products = (change**2, expected**2, change * expected)
        self._sums += [product.sum(axis=0) for product in products]
        self._stretches += len(change)

    def warnings(self, where: str) -> list[Doubt]:
        """What is doubtful.

        Raises:
            RecordingError: a rate goes with its column, but has another scale or sign.
        """
        doubts: list[Doubt] = []
        for (name, rate_name), (xx, vv, xv) in zip(self._names, self._sums.T, strict=True):
            if xx <= _SLIGHT**2 * self._stretches or vv == 0:
                continue
            together, scale = xv**2 / (xx * vv), xv / xx
            if together < _APART:
                doubts.append(
                    Doubt(
                        f"column {rate_name} hardly goes with the changes of {name} (correlation "
                        f"{np.sqrt(together):.2g})",
                        cause="it is of another drive, or another signal",
                        cure="map the column of this drive with --columns, or leave it out: the "
                        "rates then follow from the positions",
                        key="velocity",
                    )
                )
            elif together > _TOGETHER and not _SCALE[0] < scale < _SCALE[1]:
                raise RecordingError(
                    f"column {rate_name} is {scale:.4g} times the rate at which {name} changes"
                    + _guess(scale),
                    where=where,
                    cure="declare unit, sign and gear of both columns, and the unit of time, with "
                    "--columns MAPPING.yaml",
                )
        return doubts


def _guess(scale: float) -> str:
    for unit, factor in _LIKELY.items():
        if _SCALE[0] < abs(scale) / factor < _SCALE[1]:
            return f", as if it were in {unit}"
    return ""
