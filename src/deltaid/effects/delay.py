"""Torques that are recorded later than positions, or earlier: τ_meas(t) = τ(t − δ)."""

from collections.abc import Iterable

from deltaid.effects.effect import Effect
from deltaid.effects.lag_columns import slopes
from deltaid.effects.point import EffectCandidate, RigidFit


class Delay(Effect):
    """A lag of all drives, or one a drive; separate verdicts report its size."""

    kind = "torque-lag"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        columns = slopes(fit.trace, fit.p)
        yield EffectCandidate(self.kind, "", fit.rows.stack(columns)[:, None])
        yield EffectCandidate(self.kind, "", fit.rows.per_drive(columns))
