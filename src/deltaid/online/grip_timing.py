"""By how much a gripper's signal comes before or after the load that it tells of.

About a signal at θ the residual ρ of the empty model is m ψ as long as the load is held, ψ what a
kilogram takes of the filtered torques. For a load that is taken at θ + d, m free, this explains

    G(d) = (Σ ρᵀWψ)² / Σ ψᵀWψ,    sums over all cycles after θ + d about the signal,

of ρ's squares; for one that is left, over those before. W weighs by what the model may lack, a
tenth of a second as one measurement, so that G is twice the logarithm of a likelihood. Signals of
one kind are summed up: the largest G says d, and how far it stands above G(0), how surely.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

# Around a signal, and the grid of what it may be off by [s].
_AROUND, _STEP = 0.25, 0.005
# Over which torques that the model has not are one measurement [s].
_ONE = 0.1
# The most that one signal counts, what counts as something, how many must, which share of all, and
# what all must say.
_MOST, _SOME, _FEWEST, _SHARE, _SURE = 12.0, 2.0, 2, 0.2, 20.0
# What is less likely than the likeliest by no more than this may be as well.
_NEARLY = 2.0
# Filters show a load so much later [s].
_FILTERED = 0.005
_GRID = _STEP * np.arange(-round(0.2 / _STEP), round(0.2 / _STEP) + 1)


@dataclass(frozen=True)
class Offset:
    """How early signals of one kind come.

    Attributes:
        low, high: how much later than the signal the load is held, or left [s]: while a robot
            rests, friction hides when. Both 0 if nothing shows.
        signals: how many there are.
        saying: how many of them say so.
    """

    low: float
    high: float
    signals: int
    saying: int

    @property
    def middle(self) -> float:
        """Middle of what it may be [s]."""
        return 0.5 * (self.low + self.high)


@dataclass
class GripTiming:
    """Running sums; `add` consecutive cycles, `broken` at holes, then read `taken` and `left`.

    Attributes:
        period: of a cycle [s].
    """

    period: float
    _rows: Float[np.ndarray, "rows three"] = field(default_factory=lambda: np.zeros((0, 3)))
    _next: int = 0
    _better: dict[bool, list[np.ndarray]] = field(
        default_factory=lambda: dict[bool, list[np.ndarray]]({True: [], False: []})
    )

    def broken(self) -> None:
        """A hole: what is before it says nothing of what follows."""
        self._look(last=True)
        self._rows, self._next = np.zeros((0, 3)), 0

    def add(
        self,
        told: Float[np.ndarray, " rows"],
        residual: Float[np.ndarray, "rows drives"],
        lifted: Float[np.ndarray, "rows drives"],
        lacking: Float[np.ndarray, "rows drives"],
    ) -> None:
        """Take some more cycles.

        Args:
            told: what the gripper says.
            residual: ρ.
            lifted: ψ.
            lacking: what the model may lack, friction that no speed tells included.
        """
        W = self.period / _ONE / lacking**2
        rows = np.column_stack([told, (residual * W * lifted).sum(1), (W * lifted**2).sum(1)])
        self._rows = np.concatenate([self._rows, rows])
        self._look(last=False)

    def _look(self, *, last: bool) -> None:
        """At all signals whose surroundings are there."""
        around, rows = round(_AROUND / self.period), self._rows
        changes = 1 + np.flatnonzero(np.diff(rows[:, 0]))
        ends = np.concatenate([[0], changes, [len(rows)]])
        for k, at in enumerate(changes.tolist(), start=1):
            if at < self._next or (not last and at + 2 * around > len(rows)):
                continue
            before = min(around, (at - int(ends[k - 1])) // 2)
            after = min(around, (int(ends[k + 1]) - at) // 2)
            taken = bool(rows[at, 0] > rows[at - 1, 0])
            self._better[taken].append(
                self._explained(rows[at - before : at + after], before, taken)
            )
            self._next = at + 1
        cut = max(0, len(rows) - 4 * around)
        self._rows, self._next = rows[cut:], max(self._next - cut, 0)

    def _explained(
        self, rows: Float[np.ndarray, "rows three"], before: int, taken: bool
    ) -> Float[np.ndarray, " grid"]:
        """G(d) − G(0) on the grid."""
        both, power = (rows[::-1] if taken else rows)[:, 1:].T
        G = np.concatenate([[0.0], np.cumsum(both) ** 2 / (np.cumsum(power) + 1e-12)])
        at = before + np.round(_GRID / self.period).astype(int)
        at, zero = np.clip(at, 0, len(rows)), before
        if taken:
            at, zero = len(rows) - at, len(rows) - zero
        better = G[at] - G[zero]
        return better * min(1.0, _MOST / max(float(better.max()), 1e-12))

    @property
    def taken(self) -> Offset:
        """Of signals that something is held from now on."""
        return self._offset(taken=True)

    @property
    def left(self) -> Offset:
        """Of signals that nothing is held any longer."""
        return self._offset(taken=False)

    def _offset(self, *, taken: bool) -> Offset:
        better = np.array(self._better[taken] or np.zeros((0, len(_GRID))))
        total = better.sum(axis=0)
        likely = np.flatnonzero(total > total.max() - _NEARLY)
        saying = int(np.sum(better[:, int(total.argmax())] > _SOME))
        if total.max() < _SURE or saying < max(_FEWEST, _SHARE * len(better)):
            return Offset(0.0, 0.0, len(better), saying)
        low, high = _GRID[likely[[0, -1]]] - _FILTERED
        return Offset(float(low), float(high), len(better), saying)
