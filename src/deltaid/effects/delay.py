"""Torques that are recorded later than positions, or earlier: τ_meas(t) = τ(t − δ)."""

from collections.abc import Iterable

from deltaid.effects.effect import Effect
from deltaid.effects.scene import Candidate, Scene


class Delay(Effect):
    """A lag of all drives, or one a drive; verdicts of its own say how large it is."""

    kind = "torque-lag"
    is_described = False

    def candidates(self, scene: Scene) -> Iterable[Candidate]:
        slopes = scene.trace.slopes(scene.p)
        yield Candidate(self.kind, "", scene.rows.stack(slopes)[:, None])
        yield Candidate(self.kind, "", scene.rows.own(slopes))
