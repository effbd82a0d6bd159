"""Friction or torque offsets that change during a recording."""

from collections.abc import Iterable

import numpy as np
from numpy.polynomial import Legendre

from deltaid.effects.effect import Cause, DescribedEffect, torque_of
from deltaid.effects.point import Deviations, EffectCandidate, RigidFit, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.model.verdict import percent

# Time constants of warming up, as shares of the recording.
_WARM = (0.1, 0.25, 0.6)
# Prior standard deviations of friction's linear and quadratic change over a recording, as shares.
_BENT = (0.1, 0.03)


class Drift(StagedEffect, DescribedEffect):
    """Friction or an offset that changes steadily or as in warming up. In the contest each joint's
    friction changes along a recording by a polynomial of second degree."""

    kind = "drift"
    name = "friction-time"
    is_own = True
    likeliest = (
        "friction that falls while gears and grease warm up, or a torque channel that drifts"
    )
    fix = "move the robot until it is warm before recording, and record shorter"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        time, joints = fit.motion.time, [joint.name for joint in fit.joints]
        share = (time - time[0]) / (time[-1] - time[0])
        courses = [("steadily", share - 0.5)]
        courses += [("as in warming up", np.exp(-share / constant)) for constant in _WARM]
        names = [(f"viscous.{joint}", f"coulomb.{joint}") for joint in joints]
        friction = [sum(fit.column(name) * fit.size(name) for name in pair) for pair in names]
        for words, course in courses:
            if friction:
                columns = np.stack([fit.rows.stack(column * course) for column in friction], axis=1)
                yield EffectCandidate(self.kind, "", columns.sum(axis=1)[:, None], words)
                yield from self.of_each(joints, columns, words)
            offset = fit.rows.per_drive(fit.motion.weights.T * course)
            for i, drive in enumerate(fit.drives):
                yield EffectCandidate(self.kind, drive, offset[:, [i]], words)

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        changes = f"{percent(share)} of {torque_of(subject)} changes with time"
        return 100 * share, "%", f"{changes}, {cause.first.words}, and is not explained"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        names, time = point.dynamics.layout.names, point.motion.time
        active, Y = active_columns(point.dynamics), point.regressor
        span, parts = [time[0], max(time[-1], time[0] + 1e-9)], list[np.ndarray]()
        for joint in point.joints:
            k = [names.index(f"{term}.{joint.name}") for term in ("viscous", "coulomb")]
            torque = Y[:, :, np.searchsorted(active, k)] @ np.abs(point.p[k])
            parts += [torque * Legendre.basis(n + 1, span)(time) for n in range(len(_BENT))]
        return np.stack(parts, axis=2) if parts else np.zeros((*point.model.shape, 0))

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return np.tile(_BENT, len(point.joints))
