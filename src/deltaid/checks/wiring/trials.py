"""Wirings that are tried: maps whose loops close, orders, signs and units of the torque columns."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from deltaid.checks.wiring.candidate import MOSTLY_CLOSED, WiringHypothesis
from deltaid.checks.wiring.motion import FilteredMotion
from deltaid.checks.wiring.residual import Map, MapResidual, patterns, poses, residual
from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.problem import Span

# A gain so far from the others' is no calibration error; least margin that it needs.
_GAIN, _SHOWN_FAR = 2.5, 3.0
# How many are tried first.
_FEW = 40
# Patterns of one map that are judged.
_JUDGED = 4


def closed_share(dynamics: Dynamics, motion: FilteredMotion, map: Map) -> float:
    """Share of samples whose loops close, estimated from a few."""
    chosen = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)
    return float(poses(dynamics, map.values(motion.q[chosen]))[1].mean())


def residuals(
    dynamics: Dynamics, motion: FilteredMotion, maps: Iterable[Map], least: float = MOSTLY_CLOSED
) -> Iterator[MapResidual]:
    """Least squares under maps whose loops close at a share of the samples."""
    for map in maps:
        if closed_share(dynamics, motion, map) >= least:
            solved = residual(dynamics, motion, map)
            if solved is not None:
                yield solved


def tried(
    dynamics: Dynamics, motion: FilteredMotion, maps: Iterable[Map], *, as_is: bool = False
) -> Iterator[WiringHypothesis]:
    """The likeliest orders, signs and gains of the torque columns, under maps whose loops close;
    `as_is`, torque columns keep their order."""
    for solved in residuals(dynamics, motion, maps):
        dof = len(solved.still)
        (orders, signs), values = patterns(dof), solved.evidences.copy()
        moved = orders != np.arange(dof)
        # At rest friction balances any torque: neither sign nor order shows.
        values[np.any((moved | (signs < 0))[:, solved.still], axis=1)] = -np.inf
        if as_is:
            values[np.any(moved, axis=1)] = -np.inf
        ranked = np.argsort(-values, kind="stable")[: 1 if as_is else _JUDGED]
        for k in ranked[np.isfinite(values[ranked])]:
            order = tuple(orders[k].tolist())
            yield WiringHypothesis(solved, order, signs[k], float(values[k]))
        if not as_is and (far := _far_gains(solved)) is not None:
            yield far


def _far_gains(residual: MapResidual) -> WiringHypothesis | None:
    """Torque columns in their order, some of them in another unit than those of the others."""
    as_is = WiringHypothesis(
        residual, tuple(range(len(residual.still))), np.ones(len(residual.still))
    )
    tied = np.flatnonzero(~as_is.loose & ~residual.still)
    if len(tied) < 2:
        return None
    squares = np.sum(as_is.columns[:, tied] ** 2, axis=0)
    values, vectors = eigh(as_is.left_by_any[np.ix_(tied, tied)], np.diag(squares))
    if values[1] < _SHOWN_FAR**2 * max(values[0], 0.0):
        return None
    u = vectors[:, 0] * np.sign(np.sum(vectors[:, 0] * as_is.along[tied]))
    u = u / np.median(np.abs(u))
    far = (np.abs(u) > _GAIN) | (np.abs(u) < 1 / _GAIN)
    if not np.any(far):
        return None
    gains = np.ones(len(residual.still))
    gains[tied] = np.where(far, u, np.sign(u))
    # A large gain must add no weight; else an unexplained drive is only weighted less.
    by = np.repeat(np.abs(gains), residual.rows.samples)
    better = _share(residual.span, as_is.columns @ np.sign(gains))
    better /= _share(Span.of_columns(residual.Y / by[:, None]), as_is.columns @ gains / by)
    if better < _SHOWN_FAR:
        return None
    evidence = float(residual.evidences.max()) + len(residual.Y) * float(np.log(better))
    return WiringHypothesis(residual, as_is.order, gains, evidence)


def _share(span: Span, tau: Float[np.ndarray, " rows"]) -> float:
    """Residual as a share of the torques' root mean square."""
    return float(np.linalg.norm(span.without(tau)) / np.linalg.norm(tau))
