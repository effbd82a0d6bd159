"""Clocks of torques and of positions that differ: lags grow with time, read exactly so.

What remains of the rate ρ by which they grow has the column −(t − t_0) τ̇.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.effects.lag_columns import TimingColumns
from deltaid.effects.sampling import Timing
from deltaid.estimation.additions import Own, Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import PRIOR_SPREAD, Parameter

_PPM = 1e6


@dataclass(frozen=True, eq=False, kw_only=True)
class ClockColumn(TimingColumns):
    """The rate by which all lags of one recording grow.

    Attributes:
        timing: what has been corrected.
    """

    timing: Timing

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        deviation = float(self.timing.covariance[-1, -1]) ** 0.5
        return (
            Parameter("lag", self.name("clock"), "lag", "1", -np.inf, np.inf, 0.0,
                      deviation / PRIOR_SPREAD),
        )  # fmt: skip

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.dynamics.dof), np.zeros(self.dynamics.dof, dtype=int)

    def changes(self, w: Samples, own: Own, recording: Recording) -> Values:
        """−(t − t_0) τ̇."""
        return (w.time - self.timing.about) * self.slopes(w, own, recording)

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        (rest,) = judged
        rate = self.timing.rate
        low, high = (None if end is None else _PPM * (rate + end) for end in (rest.low, rest.high))
        word = "slow" if rate > 0 else "fast"
        return (
            Correction(
                kind="clock", log=self.recording.path.name, value=_PPM * (rate + rest.value),
                low=low, high=high, unit="ppm",
                text=f"the clock of torques runs {word} against that of positions, so their lag "
                "grows: torques are read so much later or earlier as time goes on",
            ),
        )  # fmt: skip
