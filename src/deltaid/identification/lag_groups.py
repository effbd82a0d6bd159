"""Which drives have a lag, and which have the same, by what the scatter of their estimates allows.

With as few lags as can be: none, if that is not contradicted, then one that all drives or some of
them have, then more. A hypothesis is a matrix S, δ = S ε, that says whose lags are alike and whose
are zero; ε by generalised least squares, and what S cannot follow by Hotelling's T².
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from deltaid.estimation.drive_rows import STRETCHES

# How often it is rejected, if true, that there is no lag or that all drives have the same; and what
# else is alike or zero by chance only.
_REJECTED, _UNLIKELY = 1e-3, 0.2
_SELDOM = 0.01
# Lags [s] that do no harm, and need not be put right.
_HARMLESS = 2e-5
# Drives beyond which only common lags and lags of single drives are told apart.
_MANY = 6


@dataclass(frozen=True, eq=False)
class Choice:
    """Drives with a lag.

    Attributes:
        groups: those that have the same.
        delay: of every drive [s].
    """

    groups: tuple[tuple[int, ...], ...]
    delay: tuple[float, ...]


def chosen_groups(
    values: Float[np.ndarray, " dof"], covariance: Float[np.ndarray, "dof dof"]
) -> Choice:
    """The simplest hypothesis on lags that their estimates do not contradict.

    Of several that are as simple, the one with fewer drives without a lag is taken, then the one
    that is contradicted least: a drive that hardly moves has the lag of the others.

    Args:
        values: estimate of each drive's lag [s].
        covariance: of these, by scatter between `STRETCHES` stretches.
    """
    dof = len(values)
    best: tuple[tuple[int, int, float], Choice] | None = None
    _, together = _fitted(values, covariance, np.ones((dof, 1)))
    for labels in _labels(dof):
        count = max(labels)
        rank = (count, labels.count(0) if count else 0)
        if best is not None and rank > best[0][:2]:
            continue
        S = np.array([[label == k + 1 for k in range(count)] for label in labels], dtype=float)
        delay, distance = _fitted(values, covariance, S)
        if np.abs(values - delay).max() >= _HARMLESS and _contradicted(labels, distance, together):
            continue
        if best is None or (*rank, distance) < best[0]:
            groups = tuple(
                tuple(i for i, label in enumerate(labels) if label == k + 1) for k in range(count)
            )
            best = (*rank, distance), Choice(groups, tuple(delay.tolist()))
    assert best is not None  # a lag for every drive is never contradicted
    return best[1]


def agree(values: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> bool:
    """Whether estimates do not contradict that all are of the same size."""
    _, distance = _fitted(values, covariance, np.ones((len(values), 1)))
    return distance <= _limit(len(values) - 1, _SELDOM)


def common_lag(
    values: Float[np.ndarray, " dof"], covariance: Float[np.ndarray, "dof dof"]
) -> tuple[float, float]:
    """The lag that all drives have by generalised least squares, and its standard deviation [s]."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, np.column_stack([values, np.ones(len(values))]) / scale[:, None])
    size = float(white[:, 1] @ white[:, 1])
    return float(white[:, 1] @ white[:, 0]) / size, size**-0.5


def _fitted(
    values: Float[np.ndarray, " dof"],
    covariance: Float[np.ndarray, "dof dof"],
    S: Float[np.ndarray, "dof groups"],
) -> tuple[Float[np.ndarray, " dof"], float]:
    """S ε by generalised least squares, and T² of what it leaves."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, np.column_stack([values / scale, S / scale[:, None]]))
    free = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    return S @ free, float(np.sum((white[:, 0] - white[:, 1:] @ free) ** 2))


def _contradicted(labels: tuple[int, ...], distance: float, together: float) -> bool:
    """Whether T² says that a hypothesis is wrong.

    Args:
        labels: the hypothesis.
        distance: T² of what it leaves.
        together: T² of what one lag for all leaves.
    """
    free = len(labels) - max(labels)
    if not free:
        return False
    if not any(labels):
        common = distance - together > _limit(1, 0.5 * _REJECTED)
        return common or distance > _limit(free, 0.5 * _REJECTED)
    return distance > _limit(free, _REJECTED if len(set(labels)) == 1 else _UNLIKELY)


def _limit(free: int, rejected: float) -> float:
    """What T² with so many directions exceeds by chance in this share of cases."""
    nu = STRETCHES - 1
    return free * nu / (nu - free + 1) * float(fdtri(free, nu - free + 1, 1 - rejected))


def _labels(dof: int) -> Iterator[tuple[int, ...]]:
    """For each drive 0, no lag, or the number of its group; fewest groups first."""
    if dof > _MANY:
        yield from ((0,) * dof, (1,) * dof, tuple(range(1, dof + 1)))
        return
    every = list(_grown((), dof))
    yield from sorted(every, key=lambda labels: (max(labels), labels.count(0)))


def _grown(labels: tuple[int, ...], dof: int) -> Iterator[tuple[int, ...]]:
    if len(labels) == dof:
        yield labels
        return
    for label in range(max(labels, default=0) + 2):
        yield from _grown((*labels, label), dof)
