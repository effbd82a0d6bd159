"""Friction that builds up over a distance after a drive turns.

Seals, bristles and teeth of gears yield before they slip. By Dahl's law friction C z follows

    dz/dq = (1 − s z) / x_0,    s = sign q̇,

so along a swing that begins with z_0, at the distance d from its turn,

    z = s + (z_0 − s) exp(−d / x_0),

where rigid contacts have s. A sum over several x_0 is a Maxwell-slip model.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from deltaid.effects.at_drives import AtDrive, AtDrives, Columns
from deltaid.effects.effect import DescribedEffect
from deltaid.effects.point import Added, Deviations, EffectCandidate, RigidFit, TracePoint
from deltaid.estimation.scatter import NORMAL
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import percent

# x_0 as shares of the stroke: from what a turn hardly shows to a slow rise; sums fit any between.
_SHARES = np.array([0.001, 0.003, 0.01, 0.03])
_YIELDS = "its friction builds up over {} after it turns, as seals and gears yield before they slip"
_FALLS = (
    "its friction seems to fall over {} after it turns, where friction that yields would build up: "
    "likelier an average or a filter of its torque"
)


class Presliding(AtDrives):
    """C of each drive and x_0; orders are reciprocals of its stroke."""

    looks_like_events = True
    kind = "presliding"
    name = "presliding"
    symbols = tuple(f"over {percent(share)} of the stroke" for share in _SHARES.tolist())

    @classmethod
    def along(cls, point: TracePoint) -> Added:
        """With a prior of 1 in the drives' units, for the strokes of a recording."""
        strokes = np.maximum(np.ptp(point.q, axis=0), np.finfo(float).tiny)
        drives, deviation = tuple(range(point.dof)), (1.0,) * point.dof * len(_SHARES)
        addition = cls(point.dynamics, drives, deviation, tuple((1.0 / strokes).tolist()))
        return _Yielding(cls.name, addition)

    def of_drive(self, k: int, q: AtDrive, qd: AtDrive, qdd: AtDrive) -> Columns:
        return _dahl(q, qd, qdd, _SHARES / self.orders[k]) - np.sign(qd)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        corrections, count = list[Correction](), len(_SHARES)
        for k, (owner, order) in enumerate(zip(self.owners, self.orders, strict=True)):
            own = judged[k * count : (k + 1) * count]
            values = np.array([entry.value for entry in own])
            size = float(values.sum())
            along = np.maximum(np.copysign(1.0, size) * values, 0.0)
            length = float(along @ _SHARES) / max(float(along.sum()), 1e-300) / order
            linear = self.dynamics.robot.is_linear(owner)
            distance = f"{1e3 * length:.2g} mm" if linear else f"{np.degrees(length):.2g}°"
            text = (_YIELDS if size >= 0.0 else _FALLS).format(distance)
            corrections.append(self.correction(owner, size, own, self.unit, text))
        return tuple(corrections)


class YieldingFriction(DescribedEffect):
    """Friction of one drive or of all that builds up over one of these distances."""

    kind = "presliding"
    is_contested = True
    likeliest = "seals, bristles or teeth of gears that yield before they slip"
    fix = "deltaid identify corrects it from a recording, not from a factor file"
    follows = "the distance since the drive turned"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        of_all = Presliding.along(fit).columns(fit).reshape(fit.dof, -1, fit.dof, len(_SHARES))
        for k, share in enumerate(_SHARES.tolist()):
            words = f"friction that builds up over {percent(share)} of the stroke"
            yield from self.of_each(fit.drives, fit.rows.stack(of_all[..., k]), words)


class _Yielding(Added):
    """The columns in the contest."""

    def is_possible(
        self, values: Deviations, covariance: Float[np.ndarray, "coefficients coefficients"]
    ) -> bool:
        """Whether friction of no drive is higher just after a turn, beyond chance (95 %)."""
        of_drives = np.kron(np.eye(len(values) // len(_SHARES)), np.ones(len(_SHARES)))
        deviation = np.sqrt(np.diag(of_drives @ covariance @ of_drives.T))
        return bool(np.all(of_drives @ values >= -NORMAL * deviation))


def _dahl(
    q: AtDrive, qd: AtDrive, qdd: AtDrive, x_0: Float[np.ndarray, " shares"]
) -> Float[np.ndarray, "shares samples"]:
    """z along consecutive samples; the turn before them is as far away as by a constant
    acceleration, d = q̇² / 2|q̈|, so no sample needs those of other blocks."""
    z, lengths = np.zeros((len(x_0), len(q))), x_0[:, None]
    if not len(q):
        return z
    moves = np.maximum.accumulate(np.where(qd != 0, np.arange(len(q)), 0))
    s = np.sign(qd)[moves]  # at rest, of the swing before
    is_begun = qd[0] * qdd[0] > 0
    d = 0.5 * qd[0] ** 2 / abs(qdd[0]) if is_begun else np.inf
    now = s[0] * (1.0 - 2.0 * np.exp(-d / lengths))
    turns = np.flatnonzero(np.diff(s)) + 1
    for first, last in pairwise([0, *turns.tolist(), len(q)]):
        passed = np.abs(q[first:last] - q[first])
        z[:, first:last] = s[first] + (now - s[first]) * np.exp(-passed / lengths)
        now = z[:, [last - 1]]
    return z
