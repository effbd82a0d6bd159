"""Holes of a recording, by its positions.

Where in a run of rows a few are missing, and whether they are, positions know better than stamps
that jitter by more than a tenth of a step, or that several rows share. About each hole that stamps
suggest, a polynomial is laid through the positions with the hole before each of the rows near by,
and without it; log-likelihoods −½ n log s², s² the residual of n rows, say which is right.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.recording.time.grid import Grid, spread

# How far from where stamps suggest it a hole may be: at least so many rows, and so many times the
# jitter, and no more than so many. Rows beside these.
_NEAR, _REACH, _FARTHEST, _BESIDE = 8, 4.0, 128, 4
# Degree of the polynomial.
_DEGREE = 5
# Longest hole that is looked at; longer ones show in the stamps.
_LONGEST = 3
# By how much the log-likelihood must be better before stamps are overruled.
_BETTER = 10.0


def revised(grid: Grid, q: Float[np.ndarray, "kept dof"]) -> Grid:
    """A grid with its short holes where positions have them, and without those that are none.

    Args:
        q: positions at the rows that are kept.
    """
    lost, rows = grid.lost.copy(), len(grid.lost)
    near = int(np.clip(_REACH * spread(grid.off), _NEAR, _FARTHEST))
    side = near + _BESIDE
    faults = np.flatnonzero(lost)
    alone = np.diff(faults, prepend=-2 * side, append=rows + 2 * side) > side + near
    inside = (faults >= side) & (faults <= rows - side)
    for missing in range(1, _LONGEST + 1):
        at = faults[alone[:-1] & alone[1:] & inside & (lost[faults] == missing)]
        if not at.size:
            continue
        around = q[at[:, None] + np.arange(-side, side)]
        likely = _likelihood(around, missing, near)  # of no hole, then of each place
        best = likely.argmax(axis=1)
        gain = likely[np.arange(len(at)), best] - likely[:, 1 + near]
        sure = gain > _BETTER
        lost[at[sure]] = 0
        moved = sure & (best > 0)
        lost[at[moved] + best[moved] - 1 - near] = missing
    return replace(grid, lost=lost)


def _likelihood(
    around: Float[np.ndarray, "holes rows dof"], missing: int, near: int
) -> Float[np.ndarray, "holes places"]:
    """Logarithms, for no hole, and for holes before the rows from −near to near."""
    side = near + _BESIDE
    x = np.arange(-side, side)
    places = [side, *range(-near, near + 1)]
    free = len(x) - _DEGREE - 1
    y = around - around.mean(axis=1, keepdims=True)
    found: list[np.ndarray] = []
    for row in places:
        basis = np.polynomial.legendre.legvander(
            (x + missing * (x >= row)) / (side + missing), _DEGREE
        )
        q = np.linalg.qr(basis)[0]
        rest = y - q @ (q.T @ y)
        squares = np.einsum("hrd,hrd->hd", rest, rest)
        found.append(-0.5 * free * np.log(squares + 1e-20).sum(axis=1))
    return np.stack(found, axis=1)
