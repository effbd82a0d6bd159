"""Torque constants that drift along recordings, as magnets lose some of their field in the heat.

A drive records τ_m = (1 + a s + b s² + c) τ with s from 0 at the beginning of a recording to 1 at
its end, and c = 0 in the first recording: torques are referred to the torque constant at its
beginning.
"""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect, torque_of
from deltaid.effects.point import EffectCandidate, RigidFit, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.model.verdict import percent


class GainOverTime(UnknownEffect, DescribedEffect):
    """a, b, c of each drive, with the columns τ s, τ s² and, after the first recording, τ."""

    name = "torque-drift"
    corrects = "readings"
    deviation = 0.03  # magnets lose 0.1 to 0.2 % a kelvin, and motors warm up by some 30 K
    is_own = True
    is_of_parts = False  # no tolerance of manufacture bounds how warm motors get
    kind = corrected_as = "torque-drift"
    is_contested = True
    unit = "%"
    text = (
        "its torque constant changes by this from the beginning of the first recording to the end "
        "of this one, and torques are corrected for it; magnets that warm up do this or, equally "
        "in all drives, a mass at the tool that changes"
    )
    likeliest = (
        "magnets lose some of their field while motors warm up; in all drives equally, the mass at "
        "the tool may change"
    )
    fix = "move the robot until it is warm before recording, with the same load, and record shorter"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        s = point.trace.recording.drifting().share(point.motion.time)
        later = 0.0 if point.is_first else 1.0
        return of_own_drives(
            np.stack([point.model * s, point.model * s**2, point.model * later], axis=2)
        )

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        """Of one drive or of all: steadily, or in an arc."""
        s = fit.trace.recording.drifting().share(fit.motion.time) - 0.5
        for course in (s, s**2 - 1 / 12):
            columns = fit.rows.per_drive(fit.model * course)
            yield EffectCandidate(self.kind, "", columns.sum(axis=1)[:, None])
            yield from self.of_each(fit.drives, columns)

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        change = f"{percent(share)} of {torque_of(subject)}"
        return 100 * share, "%", f"{change} grows or falls with time as the torque itself does"
