"""First-order filters that torques passed: inverted in the recording, what remains in the fit.

Where a torque is late by L and its filter has the time constant T, the recording is read as
τ = y + T ẏ, L − T later. If T is longer by ε and L as it is, the torque that is read changes by
ε T τ̈ below the filter's corner, the column of ε.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.effects.lag_columns import TimingColumns, slope
from deltaid.effects.lags import common_lag
from deltaid.effects.sampling import Timing
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
# Half a 95 % interval in standard deviations.
_HALF = 1.96
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

    def changes(self, w: Samples, own: Own, recording: Recording) -> Values:
        """T τ̈."""
        bend = -recording.log.rate * slope(self.slopes(w, own, recording), self.reversals(own))
        return self.timing.constants[:, None] * bend

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        corrections = list[Correction]()
        for group in self.groups:
            drives = [i for i in group.drives if self.timing.constants[i] > 0]
            if self.timing.pure and drives:
                own = np.ix_(drives, drives)
                value, deviation = common_lag(self.timing.lags[drives], self.timing.of_lags[own])
                ends = value - _HALF * deviation, value + _HALF * deviation
                subjects = group.subjects(self.dynamics) if len(drives) == len(group.drives) else [
                    self.dynamics.robot.drives[i] for i in drives
                ]  # fmt: skip
                corrections += (
                    self._correction(name, value, ends, _TEXT + _PURE) for name in subjects
                )
        for i, rest in zip(self._free.tolist(), judged, strict=True):
            value, name = float(self.timing.constants[i]), self.dynamics.robot.drives[i]
            ends = tuple(None if end is None else value + end for end in (rest.low, rest.high))
            corrections.append(self._correction(name, value + rest.value, ends, _TEXT))
        return tuple(corrections)

    def _correction(
        self, subject: str, value: float, ends: tuple[float | None, ...], text: str
    ) -> Correction:
        low, high = ends
        return Correction(kind="filter", subject=subject, log=self.recording.path.name,
                          value=value, low=low, high=high, unit="s", text=text)  # fmt: skip

    @property
    def _free(self) -> np.ndarray:
        """Drives whose filters are estimated beside their lags."""
        own = np.flatnonzero(self.timing.constants)
        return own[:0] if self.timing.pure else own
