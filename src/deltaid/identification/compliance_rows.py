"""Rows for compliances: of parameters, lags, and friction as a free curve."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.friction import SHAPES
from deltaid.effects.lag_columns import slopes
from deltaid.estimation.drive_rows import of_own_drives
from deltaid.estimation.trace_rows import RecordingRows, TraceRows
from deltaid.estimation.traces import Trace
from deltaid.identification.setup import Setup
from deltaid.recording.windows import Samples

Columns = Float[np.ndarray, "dof samples columns"]
# Columns of a drive's friction: shapes over its speed, an offset, what differs by direction, one
# that grows with the load and two with time.
_FREE = len(SHAPES) + 5


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of traces beside lags and friction as a free curve, of which nothing is known."""

    rows: TraceRows

    @classmethod
    def of(cls, setup: Setup) -> "Rows":
        """For the fit that a setup leads to."""
        return cls(TraceRows.of(setup.dynamics, setup.additions, setup.settings.prior_spread))

    def fitted(self, traces: Sequence[Trace]) -> tuple[list[np.ndarray], Parameters]:
        """What is left of each trace's rows, and p."""
        parts = [self.of_trace(one, one.load) for one in traces]
        p, first = self.parameters(parts), self.rows.size
        parts = [
            replace(
                one,
                A=np.concatenate([one.A[..., :first], late(now, p), one.A[..., first:]], axis=2),
            )
            for one, now in zip(parts, traces, strict=True)
        ]
        x = self.rows.problem(parts).x
        return [one.tau - one.A @ x for one in parts], self.parameters(parts)

    def of_trace(self, one: Trace, p: Parameters, *columns: Columns) -> RecordingRows:
        """Rows of a trace, with columns beside the parameters', those of friction behind.

        Args:
            p: whose torques gears carry, which losses grow with.
        """
        part = self.rows.of_trace(one)
        return replace(part, A=np.concatenate([part.A, *columns, _friction(one, p)], axis=2))

    def parameters(self, parts: Sequence[RecordingRows]) -> Parameters:
        """p of the robot, whose friction is viscous and Coulomb's as well as that goes: beside a
        free curve, hardly anything tells them."""
        free = _FREE * len(parts[0].tau)
        plain = [
            replace(
                one,
                A=one.A[:, :, :-free],
                instruments=tuple(by[:, :, :-free] for by in one.instruments),
            )
            for one in parts
        ]
        p = self.rows.parameters(self.rows.problem(plain).x)
        return p[: len(p) - sum(len(one.parameters) for one in self.rows.additions)]


def late(now: Trace, p: Parameters) -> Columns:
    """−τ̇ of each drive, in a column of its own."""
    return of_own_drives(slopes(now, p)[:, :, None])


def _friction(now: Trace, p: Parameters) -> Columns:
    """Friction of each drive beside Coulomb's and viscous, in columns of its own: a
    free curve, what grows with what its gear carries, by p, and what changes while it warms up."""
    fastest = np.max([np.abs(w.qd).max(axis=0) for w in now.stretches], axis=0)
    first, last = now.stretches[0].time[0], now.stretches[-1].time[-1]

    def shapes(w: Samples) -> np.ndarray:
        v, carried = w.qd / fastest, now.dynamics.carried(w.z, w.qd, w.qdd, p) + w.carried
        sign, later = np.sign(v), ((w.time - first) / (last - first))[:, None]
        both = [shape(np.abs(v)) for shape, _ in SHAPES] + [np.abs(carried), later, later**2]
        return np.hstack([*(sign * one for one in both), np.ones_like(v), np.abs(v)]).T

    dof = now.dynamics.dof
    out = now.filtered(shapes, np.tile(np.arange(dof), _FREE))
    return of_own_drives(out.reshape(_FREE, dof, -1).transpose(1, 2, 0))
