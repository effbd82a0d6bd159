"""Least squares of a trace's rows, for parameters with a prior and for something beside them.

    τ = X x + A a + e,    D [x; a] = known, with standard deviations of 1

X are columns of the free parameters, A those of what is looked for beside them: lags, compliances.
Each drive's rows count by what its own columns leave of them. As in `scatter`, a errs by the sum
over rows of what is left times its influence, and how these sums scatter between stretches of time
tells by how much; white noise of the same size is believed where that is more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.objective import NOISE_FLOOR
from deltaid.identification.reduction import Reduction, build_reduction
from deltaid.identification.regularizer import Euclidean
from deltaid.identification.traces import Trace

# Stretches of time of a recording whose scatter says how certain something is.
BLOCKS = 40
# Singular values below this share of the largest are zero.
_DEPENDENT = 1e-9

Influence = Float[np.ndarray, "rows beside"]


@dataclass(frozen=True, eq=False)
class Sheet:
    """The filtered rows of one recording.

    Attributes:
        X: columns of the free parameters.
        A: columns beside them; zero for what only other recordings have.
        tau: torques less what is known of them.
    """

    X: Float[np.ndarray, "dof samples free"]
    A: Float[np.ndarray, "dof samples beside"]
    tau: Float[np.ndarray, "dof samples"]

    def over(self, noise: Float[np.ndarray, " dof"]) -> Float[np.ndarray, "rows columns"]:
        """Columns of all drives, one drive after the other, over the noise of each."""
        columns = np.concatenate([self.X, self.A], axis=2) / noise[:, None, None]
        return columns.reshape(self.tau.size, -1)

    @property
    def noise(self) -> Float[np.ndarray, " dof"]:
        """What each drive's columns leave of its torques, root mean square."""
        noise = []
        for X, A, tau in zip(self.X, self.A, self.tau, strict=True):
            columns = np.column_stack([X, A])
            norms = np.linalg.norm(columns, axis=0)
            own = columns[:, norms > 0] / norms[norms > 0]
            left = tau - own @ np.linalg.lstsq(own, tau, rcond=_DEPENDENT)[0]
            floor = NOISE_FLOOR * max(float(np.abs(tau).max()), np.finfo(float).tiny)
            noise.append(max(float(np.sqrt(np.mean(left**2))), floor))
        return np.array(noise)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before: D [x; a] = known, with standard deviations of 1."""

    D: Float[np.ndarray, "known columns"]
    known: Float[np.ndarray, " known"]

    @classmethod
    def of(cls, reduction: Reduction, spread: float) -> "Prior":
        """Of free parameters.

        Args:
            spread: its relative standard deviation.
        """
        prior = Euclidean().regularizer(reduction).quadratic
        D = prior.D / spread
        return cls(D, D @ prior.x_reg)

    def beside(
        self, centre: Float[np.ndarray, " beside"], deviation: Float[np.ndarray, " beside"]
    ) -> "Prior":
        """The same with what is known of a; an infinite deviation is nothing."""
        D = np.zeros((len(self.D) + len(centre), self.D.shape[1] + len(centre)))
        D[: len(self.D), : self.D.shape[1]] = self.D
        D[len(self.D) :, self.D.shape[1] :] = np.diag(1.0 / deviation)
        return Prior(D, np.concatenate([self.known, centre / deviation]))


@dataclass(frozen=True, eq=False)
class Solution:
    """Free parameters x, what is beside them, a, and the covariance of a."""

    x: Float[np.ndarray, " free"]
    a: Float[np.ndarray, " beside"]
    covariance: Float[np.ndarray, "beside beside"]


def reduced(trace: Trace, additions: Sequence[Addition]) -> Reduction:
    """The free variables of a robot with additions."""
    regressor = extended(trace.dynamics, additions)
    added = [(one.parameters, one.free) for one in additions]
    return build_reduction(trace.dynamics.robot, active_columns(regressor), added)


def solved(
    sheets: Sequence[Sheet],
    prior: Prior,
    instruments: Sequence[Sequence[Sheet]] | None = None,
) -> Solution:
    """Least squares over all recordings; in two stages, where there are instruments.

    Args:
        sheets: their rows, with the same columns.
        prior: of x and a.
        instruments: for each recording, columns that go with those of its rows, and have none of
            the noise that these share with torques.
    """
    free, noise = sheets[0].X.shape[2], [one.noise for one in sheets]
    rows = np.vstack([*map(Sheet.over, sheets, noise), prior.D])
    torques = ((one.tau / each[:, None]).ravel() for one, each in zip(sheets, noise, strict=True))
    right = np.concatenate([*torques, prior.known])
    norms = _norms(rows)
    clean = rows if instruments is None else _beside_each_other(instruments, noise, prior)
    Q, _ = np.linalg.qr(clean / _norms(clean))
    inverse = np.linalg.pinv(Q.T @ (rows / norms), rcond=_DEPENDENT)
    x = inverse @ (Q.T @ right) / norms
    left = right - rows @ x
    influence = Q @ inverse[free:].T / norms[free:]
    covariance, first = np.zeros((len(x) - free, len(x) - free)), 0
    for one in sheets:
        own = slice(first, first + one.tau.size)
        covariance += _scatter(influence[own], left[own], len(one.tau))
        first += one.tau.size
    return Solution(x[:free], x[free:], covariance + influence[first:].T @ influence[first:])


def _beside_each_other(
    instruments: Sequence[Sequence[Sheet]], noise: Sequence[Float[np.ndarray, " dof"]], prior: Prior
) -> Float[np.ndarray, "rows columns"]:
    """All instruments of all recordings; the prior is an instrument for what it knows."""
    parts = [
        np.hstack([one.over(each) for one in some])
        for some, each in zip(instruments, noise, strict=True)
    ]
    known = np.zeros((len(prior.D), parts[0].shape[1]))
    known[:, : prior.D.shape[1]] = prior.D
    return np.vstack([*parts, known])


def _norms(rows: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, " columns"]:
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0] = 1.0
    return norms


def stretches(samples: int) -> Int[np.ndarray, " stretches"]:
    """First samples of `BLOCKS` stretches of time that are as long as each other, or of as many as
    there are samples."""
    return np.unique(np.arange(BLOCKS) * samples // BLOCKS)


def _scatter(
    influence: Influence, left: Float[np.ndarray, " rows"], dof: int
) -> Float[np.ndarray, "beside beside"]:
    """Covariance by the scatter between stretches of time, or white if that is wider."""
    samples = len(left) // dof
    starts = stretches(samples)
    shares = (influence * left[:, None]).reshape(dof, samples, -1)
    sums = np.add.reduceat(shares, starts, axis=1).sum(axis=0)
    scatter = sums.T @ sums * len(starts) / max(len(starts) - 1, 1)
    white = np.sum(influence**2, axis=0) * np.mean(left**2)
    grown = np.sqrt(np.maximum(white / np.maximum(np.diag(scatter), 1e-300), 1.0))
    return scatter * np.outer(grown, grown)
