"""Friction of drives whose description has none."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Effect
from deltaid.effects.scene import Candidate, Scene
from deltaid.recording.windows import Samples


class MissingFriction(Effect):
    """Viscous and Coulomb friction; a verdict on the description says so."""

    kind = "friction-missing"
    is_described = False

    def candidates(self, scene: Scene) -> Iterable[Candidate]:
        robot = scene.trace.dynamics.robot
        without = [i for i, drive in enumerate(scene.drives) if drive not in robot.friction]
        if not without:
            return
        drives = np.arange(len(scene.drives))
        filtered = [scene.trace.filtered(of, drives) for of in (_signs, _speeds)]
        columns = np.hstack([scene.rows.own(x)[:, without] for x in filtered])
        yield Candidate(self.kind, "", columns, is_preferred=True)


def _signs(w: Samples) -> np.ndarray:
    return np.sign(w.qd).T


def _speeds(w: Samples) -> np.ndarray:
    return w.qd.T
