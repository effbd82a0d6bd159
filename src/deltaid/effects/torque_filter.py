"""First-order filters that torques passed: inverted in the recording, what remains in the fit.

Where a torque is late by L and its filter has the time constant T, the recording is read as
τ = y + T ẏ, L − T later. If T is longer by ε and L as it is, the torque that is read changes by
ε T τ̈ below the filter's corner, the column of ε.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.effects.lag_columns import TimingColumns, slope
from deltaid.effects.timing import Timing
from deltaid.estimation.additions import Own, Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import PRIOR_SPREAD, Parameter

_TEXT = (
    "torques passed a first-order filter of this time constant, which is inverted: steps of "
    "friction at reversals have its tails"
)
_PURE = "; it is all that makes them late"


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterColumns(TimingColumns):
    """Time constants of one recording's filters, one a drive.

    Attributes:
        timing: what has been corrected.
    """

    timing: Timing

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names, deviations = self.dynamics.robot.drives, self.timing.deviation
        return tuple(
            Parameter("lag", self.name(f"filter.{names[i]}"), "lag", "s", -np.inf, np.inf, 0.0,
                      float(deviations[i]) / PRIOR_SPREAD)
            for i in self._free
        )  # fmt: skip

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return self._free, np.arange(len(self._free))

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """T τ̈ of each drive with a filter."""
        if not self.is_of(recording):
            return np.zeros((len(self._free), own.shape[1]))
        bend = -recording.log.rate * slope(self.slopes(w, own, recording), self.reversals(own))
        return (self.timing.constants[:, None] * bend)[self._free]

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        rest = dict(zip(self._free.tolist(), judged, strict=True))
        found = list[Correction]()
        for i in np.flatnonzero(self.timing.constants).tolist():
            value, half = float(self.timing.constants[i]), 2.0 * float(self.timing.deviation[i])
            low, high = value - half, value + half
            if i in rest and rest[i].low is not None and rest[i].high is not None:
                low, high = value + rest[i].low, value + rest[i].high
                value += rest[i].value
            found.append(
                Correction(kind="filter", subject=self.dynamics.robot.drives[i],
                           log=self.recording.path.name, value=value, low=low, high=high, unit="s",
                           text=_TEXT + _PURE * self.timing.pure)
            )  # fmt: skip
        return tuple(found)

    @property
    def _free(self) -> np.ndarray:
        """Drives whose filters are estimated beside their lags."""
        own = np.flatnonzero(self.timing.constants)
        return own[:0] if self.timing.pure else own
