"""Torques that are recorded later than positions, or earlier: τ_meas(t) = τ(t − δ)."""

from collections.abc import Iterable

from deltaid.effects.effect import Effect
from deltaid.effects.lag_columns import late, slopes
from deltaid.effects.point import EffectCandidate, RigidFit, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives


class Delay(StagedEffect, Effect):
    """A lag of all drives, or one a drive [s]; separate verdicts report its size. In the contest
    what remains of each drive's."""

    kind = "torque-lag"
    name = "lag"
    is_own = True
    deviation = 3e-4

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return late(point.trace, point.p)

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        columns = slopes(fit.trace, fit.p)
        yield EffectCandidate(self.kind, "", fit.rows.stack(columns)[:, None])
        yield EffectCandidate(self.kind, "", fit.rows.per_drive(columns))
