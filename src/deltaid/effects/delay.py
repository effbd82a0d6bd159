"""Torques that are recorded later or earlier than positions: τ_meas(t) = τ(t − δ)."""

from collections.abc import Iterable

from deltaid.effects.effect import Effect
from deltaid.effects.lag_columns import APART, late, slopes
from deltaid.effects.point import EffectCandidate, RigidFit, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives


class Delay(StagedEffect, Effect):
    """A lag of all drives, or of each [s]; the contest has each drive's remaining lag. A verdict of
    its own reports it (`checks.lag`)."""

    kind = "torque-lag"
    name = "lag"
    is_own = True
    deviation = APART

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return late(point.trace, point.p)

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        columns = slopes(fit.trace, fit.p)
        yield EffectCandidate(self.kind, "", fit.rows.stack(columns)[:, None])
        yield EffectCandidate(self.kind, "", fit.rows.per_drive(columns))
