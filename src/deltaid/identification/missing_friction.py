"""Friction of drives whose description has none, as a pattern of what a residual may look like."""

import numpy as np

from deltaid.identification.patterns import Pattern, Scene
from deltaid.recording.windows import Samples


def missing(scene: Scene) -> Pattern | None:
    """Viscous and Coulomb friction of drives whose description has none."""
    robot = scene.trace.dynamics.robot
    without = [i for i, drive in enumerate(scene.drives) if drive not in robot.friction]
    if not without:
        return None
    drives = np.arange(len(scene.drives))
    filtered = [scene.trace.filtered(of, drives) for of in (_signs, _speeds)]
    columns = np.hstack([scene.rows.own(x)[:, without] for x in filtered])
    return Pattern("friction-missing", "", columns)


def _signs(w: Samples) -> np.ndarray:
    return np.sign(w.qd).T


def _speeds(w: Samples) -> np.ndarray:
    return w.qd.T
