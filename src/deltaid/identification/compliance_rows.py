"""Rows for compliances: of parameters, lags, and friction as a free curve."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.reduction import Reduction
from deltaid.identification.rows_with_prior import Prior, Sheet, Solution, reduced, solved
from deltaid.identification.setup import Setup
from deltaid.identification.traces import Trace
from deltaid.recording.windows import Samples

Columns = Float[np.ndarray, "dof samples columns"]
Speeds = Float[np.ndarray, "samples dof"]


def _falling(knee: float) -> Callable[[Speeds], Speeds]:
    return lambda v: np.exp(-np.abs(v) / knee)


def _either_way(shape: Callable[[Speeds], Speeds]) -> Callable[[Speeds], Speeds]:
    return lambda v: np.sign(v) * shape(v)


# Friction over the speed, as a share v of the largest, beside Coulomb's and viscous: what falls
# within a knee and what grows with the square; then what differs between the two ways.
_SHAPES: tuple[Callable[[Speeds], Speeds], ...] = (
    *(_either_way(_falling(knee)) for knee in (0.03, 0.1, 0.3)),
    _either_way(np.square),
    np.ones_like,
    np.abs,
    _falling(0.1),
)
# Columns of a drive's friction: these, one that grows with the load and two with time.
_FREE = len(_SHAPES) + 3


@dataclass(frozen=True, eq=False)
class Rows:
    """What rows of traces are made for: the free parameters of a fit, and their prior."""

    reduction: Reduction
    additions: tuple[Addition, ...]
    prior: Prior

    @classmethod
    def of(cls, traces: Sequence[Trace], setup: Setup) -> "Rows":
        """For the fit that a setup leads to."""
        reduction = reduced(traces[0], setup.additions)
        return cls(reduction, setup.additions, Prior.of(reduction, setup.settings.prior_spread))

    def fitted(self, traces: Sequence[Trace]) -> tuple[list[np.ndarray], Parameters]:
        """What is left of each trace's rows, and p."""
        nothing = [np.zeros((*torques_of(one).shape, 0)) for one in traces]
        sheets = [self.sheet(one, None, none) for one, none in zip(traces, nothing, strict=True)]
        p = self.parameters(sheets)
        sheets = [
            replace(one, A=np.concatenate([_slopes(now, p), one.A], axis=2))
            for one, now in zip(sheets, traces, strict=True)
        ]
        solution = self.solved(sheets)
        x = np.concatenate([solution.x, solution.a])
        left = [one.tau - np.concatenate([one.X, one.A], axis=2) @ x for one in sheets]
        return left, self.parameters(sheets)

    def sheet(self, one: Trace, p: Parameters | None, columns: Columns) -> Sheet:
        """Rows of a trace, with columns beside the parameters', those of lags and friction behind.

        Args:
            p: whose torques lag; without lags if not given.
        """
        active = active_columns(extended(one.dynamics, self.additions))
        rows = one.regressor(self.additions)
        tau = torques_of(one) - rows @ self.reduction.p_0[active]
        lags = [] if p is None else [_slopes(one, p)]
        A = np.concatenate([columns, *lags, _friction(one, one.load if p is None else p)], axis=2)
        return Sheet(rows @ self.reduction.A[active], A, tau)

    def solved(
        self, sheets: Sequence[Sheet], clean: Sequence[Sequence[Sheet]] | None = None
    ) -> Solution:
        """Of all recordings; of what stands beside the parameters nothing is known."""
        nothing = np.zeros(sheets[0].A.shape[2])
        return solved(sheets, self.prior.beside(nothing, nothing + np.inf), clean)

    def parameters(
        self, sheets: Sequence[Sheet], clean: Sequence[Sequence[Sheet]] | None = None
    ) -> Parameters:
        """p of the robot, whose friction is viscous and Coulomb's as well as that goes: beside a
        free curve, hardly anything tells them."""
        free = _FREE * len(sheets[0].tau)
        plain = [replace(one, A=one.A[:, :, :-free]) for one in sheets]
        x = self.solved(plain, clean).x
        p = self.reduction.A @ x + self.reduction.p_0
        return p[: len(p) - sum(len(one.parameters) for one in self.additions)]


def torques_of(one: Trace) -> Float[np.ndarray, "dof samples"]:
    return one.torques(np.zeros(one.dynamics.dof))


def _slopes(now: Trace, p: Parameters) -> Columns:
    """−τ̇ of each drive, in a column of its own."""
    dof = now.dynamics.dof

    def slope(w: Samples) -> np.ndarray:
        return -np.gradient(now.dynamics.torque(w.z, w.qd, w.qdd, p), axis=0).T

    return _apart(now.low_pass.rate * now.filtered(slope, np.arange(dof), 1)[:, :, None])


def _friction(now: Trace, p: Parameters) -> Columns:
    """Friction of each drive beside Coulomb's and viscous, in columns of its own; the last are what
    grows with what its gear carries, by p, and what changes while it warms up."""
    fastest = np.max([np.abs(w.qd).max(axis=0) for w in now.stretches], axis=0)
    first, last = now.stretches[0].time[0], now.stretches[-1].time[-1]

    def shapes(w: Samples) -> np.ndarray:
        v, carried = w.qd / fastest, now.dynamics.carried(w.z, w.qd, w.qdd, p) + w.carried
        of_load, later = np.sign(v) * np.abs(carried), ((w.time - first) / (last - first))[:, None]
        warmer = [np.sign(v) * later, np.sign(v) * later**2]
        return np.hstack([*(shape(v) for shape in _SHAPES), of_load, *warmer]).T

    dof = now.dynamics.dof
    out = now.filtered(shapes, np.tile(np.arange(dof), _FREE))
    return _apart(out.reshape(_FREE, dof, -1).transpose(1, 2, 0))


def _apart(own: Float[np.ndarray, "dof samples own"]) -> Columns:
    """Columns that each drive has by itself, zero in the rows of others."""
    dof, samples, count = own.shape
    out = np.zeros((dof, samples, dof, count))
    out[np.arange(dof), :, np.arange(dof)] = own
    return out.reshape(dof, samples, dof * count)
