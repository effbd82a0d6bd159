"""Searches of a survey: rows in which drives do not power the motion, and changes of loads."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.columns import Columns
from deltaid.recording.masks.frozen import FrozenSearch
from deltaid.recording.masks.masks import (
    FROZEN,
    LOAD_CHANGES,
    NONE,
    Mask,
    Reason,
    Runs,
    joined,
    without,
)
from deltaid.recording.masks.rest import LASTS, RestSearch
from deltaid.recording.masks.stuck import Extreme, StaleSearch
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import Clock

# Time before and after saturated samples during which a channel counts as saturated [s]: whether
# torque near its end saturates depends on its noise, so the noise that remains has one sign.
_BESIDE = 0.003
# Longest emergency stop without torque of the drives [s].
_STOPS = 1.5
# Longest time between a gripper's signal and its grip [s].
_ABOUT = 0.012
# Excluded rows: reason, drives, runs.
Exclusion = tuple[Reason, tuple[int, ...], Runs]


class MaskSearch:
    """Running search for excluded rows; `add` consecutive rows, then read `runs`.

    Args:
        dof: number of drives.
        limits: described torque limits of the drives [N m or N]; infinite without a limit.
    """

    def __init__(self, dof: int, limits: Sequence[float]) -> None:
        self._dof, self._row, self._stale = dof, 0, StaleSearch(dof)
        self._ends = [(Extreme(limit), Extreme(limit)) for limit in limits]
        self._frozen = [FrozenSearch() for _ in limits]
        self._rest: RestSearch | None = None
        self._before = np.zeros((0, 0))

    def add(self, values: Float[np.ndarray, "rows channels"], period: float) -> None:
        """Add rows: time, positions, other channels, torques.

        Args:
            period: usual time between two rows [s]; 0 while it is unknown.
        """
        n, first = self._dof, self._row
        self._row += len(values)
        if not period and self._rest is None:
            return
        rest = self._rest = self._rest or RestSearch(n, period)
        block = np.vstack([self._before, values]) if self._before.size else values
        rest.add(block[:, 1 : 1 + n], block[:, -n:], self._row - len(block))
        self._before = block[-rest.overlap :]
        self._stale.add(values[:, 1:], rest.steps)
        changes = np.diff(block[:, -n:], axis=0, prepend=np.nan) != 0
        updated = np.any(changes, axis=1)[-len(values) :]
        for i, ((top, bottom), frozen) in enumerate(zip(self._ends, self._frozen, strict=True)):
            torque = values[:, i - n]
            top.add(torque, updated, first)
            bottom.add(-torque, updated, first)
            frozen.add(torque, values[:, 1 + i], first)

    def placeholders(self) -> Iterator[tuple[int, float, int]]:
        """Drives with numbers in the place of missing torques: the number and its first row."""
        for i, (top, bottom) in enumerate(self._ends if self._rest else ()):
            for end, other, sign in ((top, bottom, 1.0), (bottom, top, -1.0)):
                if end.is_placeholder(other.level):
                    yield i, sign * end.level, end.first_row

    def runs(self) -> list[Exclusion]:
        rest, everyone = self._rest, tuple(range(self._dof))
        if rest is None:
            return []
        stale, off = self._stale.runs(rest.steps), rest.off
        resting = without(rest.at_rest, stale)
        resting = resting[resting[:, 1] - resting[:, 0] >= rest.overlap]
        on_brakes = _on_brakes(resting, off, round(LASTS / rest.period))
        excluded: list[Exclusion] = [
            ("standing still", everyone, without(resting, on_brakes)),
            ("on brakes", everyone, on_brakes),
            ("emergency stop", everyone, _stops(off, on_brakes, round(_STOPS / rest.period))),
            ("stale rows", everyone, stale),
        ]
        beside = round(_BESIDE / rest.period) * np.array([-1, 1])
        for i, ends in enumerate(self._ends):
            largest = max(abs(end.level) for end in ends)
            saturated = np.concatenate([end.runs(largest) for end in ends])
            ordered = joined(saturated[np.argsort(saturated[:, 0])] + beside)
            ordered = np.clip(ordered, 0, self._row - 1)
            excluded.append(("saturated torque", (i,), without(ordered, on_brakes)))
            frozen = self._frozen[i].runs(float(rest.still[i]))
            excluded.append((FROZEN, (i,), without(without(frozen, ordered), on_brakes)))
        return [part for part in excluded if len(part[2])]


class LoadSearch:
    """Running search for changes of loads; `add` consecutive rows, then read `runs` and
    `doubts`."""

    def __init__(self, table: LogTable, columns: Columns) -> None:
        self._table, self._columns, self._rows = table, columns, 0
        self._changes, count = [np.zeros(0, dtype=np.int64)], len(columns.loads)
        self._last, self._ever = np.zeros((count, 0), dtype=bool), np.zeros(count, dtype=bool)

    def add(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Add rows, columns as in `Columns.all`; `row` is the number of the first one.

        Raises:
            RecordingError: a column is neither 0 nor 1, and the mapping lists no other numbers.
        """
        extra = values[:, self._columns.extra_places]
        for load in self._columns.loads:
            if load.column is None or load.holding is not None:
                continue
            numbers = extra[:, self._columns.extra_index(load.column)]
            for other in np.flatnonzero((numbers != 0.0) & (numbers != 1.0))[:1].tolist():
                raise RecordingError(
                    f"column {load.column} of load {load.name} is {numbers[other]:.10g}, "
                    "neither 0 nor 1",
                    where=self._table.row_place(row + other),
                    cure="list the numbers at which the load is held: "
                    f"load: {{column: {load.column}, when: [{numbers[other]:.10g}]}}",
                )
        held = np.hstack([self._last, self._columns.held(values[:, 0], extra) > 0])
        changes = np.flatnonzero(np.any(np.diff(held, axis=1), axis=0))
        self._changes.append(self._rows + changes + 1 - self._last.shape[1])
        self._last, self._ever = held[:, -1:], self._ever | held.any(axis=1)
        self._rows += len(values)

    def runs(self, rate: float) -> list[Exclusion]:
        """Rows around changes of loads, excluded for all drives, at a sampling rate [Hz]."""
        about = max(1, round(_ABOUT * rate))
        changes = np.concatenate(self._changes)
        runs: Runs = joined(np.column_stack([changes - about, changes + about - 1]))
        drives = tuple(range(len(self._columns.torque)))
        return [(LOAD_CHANGES, drives, np.clip(runs, 0, self._rows - 1))] if drives else []

    def doubts(self) -> list[Doubt]:
        return [
            Doubt(
                f"load {load.name} is declared for spans in which nothing was recorded",
                cause="spans count in the time of another recording, or in another unit",
                cure="give spans in s, by the time of this recording",
            )
            for load, ever in zip(self._columns.loads, self._ever, strict=True)
            if load.spans is not None and not ever
        ]


def timed(excluded: Iterable[Exclusion], clock: Clock) -> tuple[Mask, ...]:
    """Convert excluded rows to masks with times, in order."""
    masks = [
        Mask(reason, drives, first, last, *clock.stamps(np.array([first, last])).tolist())
        for reason, drives, runs in excluded
        for first, last in runs.tolist()
    ]
    return tuple(sorted(masks, key=lambda mask: (mask.first, mask.drives)))


def _on_brakes(resting: Runs, off: Runs, short: int) -> Runs:
    """Runs of rest on brakes; the drives control other rest. Parts shorter than `short` rows join
    their neighbours."""
    brakes = [NONE]
    for first, last in resting.tolist():
        braked = off[(off[:, 1] >= first) & (off[:, 0] <= last)]
        braked = joined(np.clip(braked, first, last), short)
        braked = braked[braked[:, 1] - braked[:, 0] >= min(short, last - first)]
        if len(braked):
            braked[0, 0] = first if braked[0, 0] - first <= short else braked[0, 0]
            braked[-1, 1] = last if last - braked[-1, 1] <= short else braked[-1, 1]
        brakes.append(braked)
    return np.concatenate(brakes)


def _stops(off: Runs, on_brakes: Runs, longest: int) -> Runs:
    after = np.searchsorted(on_brakes[:, 0], off[:, 0], side="right")
    starts = np.append(on_brakes[:, 0], np.iinfo(np.int64).max)[after]
    braked = (starts <= off[:, 1] + 1) & (starts - off[:, 0] <= longest)
    return np.column_stack([off[:, 0], starts - 1])[braked]
