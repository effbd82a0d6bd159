"""Torques that are recorded later than positions, or earlier: τ_meas(t) = τ(t − δ)."""

from collections.abc import Iterable

from deltaid.effects.effect import Effect
from deltaid.effects.lag_columns import slopes
from deltaid.effects.scene import Candidate, Scene


class Delay(Effect):
    """A lag of all drives, or one a drive; verdicts of its own say how large it is."""

    kind = "torque-lag"
    is_described = False

    def candidates(self, scene: Scene) -> Iterable[Candidate]:
        columns = slopes(scene.trace, scene.p)
        yield Candidate(self.kind, "", scene.rows.stack(columns)[:, None])
        yield Candidate(self.kind, "", scene.rows.own(columns))
