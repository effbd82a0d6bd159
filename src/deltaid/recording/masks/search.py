"""Searches of a survey: rows in which drives do not power the motion, and changes of loads.

At rest, all drives stay within steps and noise of their encoders for longer than a reversal takes.
With coarse steps, slow motion does so too, so rest must also be slow against the largest speeds of
the recording, as far as its duration shows; if it is not, parts of it may still be rest. A constant
torque means that the drive is off only if its channel has noise elsewhere: without noise, the
torque that holds a robot at rest is constant too.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.columns import Columns
from deltaid.recording.masks.masks import (
    LOAD_CHANGES,
    NONE,
    Mask,
    Reason,
    Runs,
    as_runs,
    joined,
    rolling,
    runs_of,
    without,
)
from deltaid.recording.masks.stuck import Extreme, StaleSearch
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import Clock

# Least duration of rest, also on brakes [s]; fewest rows of rest, and of torque that is off.
_LASTS, _ROWS = 0.04, 5
# Width of the band of rest during that time, in encoder steps plus narrowest bands of the drive;
# and largest width of a whole rest, in bands of rest: this, or its duration in seconds if larger.
_STEPS, _BANDS, _WANDER = 1.5, 2.0, 3.0
# Largest speed of a robot at rest, as a share of its drives' largest speeds.
_SLOW = 0.005
# Torque that is off: least duration [s], and largest mean and range, as shares of the largest
# torque.
_OFF_LASTS, _OFF, _OFF_RANGE = 0.01, 0.04, 0.2
# Share of changes that reverse the previous one above which a channel has noise: two thirds for
# white noise, hardly any for a smooth torque.
_NOISY = 0.2
DriveRows = Float[np.ndarray, "rows dof"]
# Time before and after saturated samples during which a channel counts as saturated [s]: whether
# torque near its end saturates depends on its noise, so the noise that remains has one sign.
_BESIDE = 0.003
# Longest emergency stop without torque of the drives [s].
_STOPS = 1.5
# Longest time between a gripper's signal and its grip [s].
_ABOUT = 0.012
# Excluded rows: reason, drives, runs.
Exclusion = tuple[Reason, tuple[int, ...], Runs]


@dataclass
class _Rest:
    """Rows at rest, their range of positions, and parts that each stay in the band of rest."""

    first: int
    last: int
    low: Float[np.ndarray, " dof"]
    high: Float[np.ndarray, " dof"]
    parts: list["_Rest"] = field(default_factory=list["_Rest"])


def _rest(q: DriveRows, row: int) -> _Rest:
    return _Rest(row, row + len(q) - 1, q.min(axis=0), q.max(axis=0))


class RestSearch:
    """Running search for rest; `add` blocks of rows, then read `at_rest` and `off`.

    Attributes:
        period: time between two rows [s].
        length: fewest rows of a rest.
        overlap: number of rows that two blocks share, `length` − 1.
    """

    def __init__(self, dof: int, period: float) -> None:
        self.period, self.length = period, max(_ROWS, round(_LASTS / period))
        self.overlap = self.length - 1
        self._step, self._band, self._low = np.full((3, dof), np.inf)
        self._speed, self._torque = np.zeros((2, dof))
        self._high, self._changes = np.full(dof, -np.inf), np.zeros((2, dof))
        self._rests, self._off, self._constant = list[_Rest](), list[Runs](), list[Runs]()

    @property
    def steps(self) -> Float[np.ndarray, " dof"]:
        """Smallest change of each position [rad or m], its encoder's step; 0 without changes."""
        return np.where(np.isfinite(self._step), self._step, 0.0)

    def add(self, q: DriveRows, torque: DriveRows, row: int) -> None:
        """Add a block; `row` is the number of its first row."""
        if len(q) < self.length:
            return
        self._add_torque(torque, row)
        low, high = rolling(q, self.length)
        width, change = high - low, np.abs(np.diff(q, axis=0))
        self._step = np.minimum(self._step, np.where(change > 0, change, np.inf).min(axis=0))
        self._band = np.minimum(self._band, width.min(axis=0))
        travel = np.abs(q[self.overlap :] - q[: len(q) - self.overlap])
        self._speed = np.maximum(self._speed, travel.max(axis=0) / (self.overlap * self.period))
        self._low = np.minimum(self._low, q.min(axis=0))
        self._high = np.maximum(self._high, q.max(axis=0))
        for first, last in runs_of(np.all(width <= self._widest, axis=1), row).tolist():
            stays = q[first - row : last - row + self.length]
            rest = _rest(stays, first)
            if np.any(rest.high - rest.low > self._widest):
                rest.parts = list(self._parts(stays, first))
            if self._rests and rest.first <= self._rests[-1].last + 1:
                before = self._rests.pop()
                low, high = np.minimum(rest.low, before.low), np.maximum(rest.high, before.high)
                end, parts = max(rest.last, before.last), before.parts + rest.parts
                rest = _Rest(before.first, end, low, high, parts)
            self._rests.append(rest)

    @property
    def at_rest(self) -> Runs:
        rests = [
            (part.first, part.last)
            for rest in self._rests
            for part in ([rest] if self._slow(rest) else filter(self._slow, rest.parts))
        ]
        return joined(as_runs(rests))

    @property
    def off(self) -> Runs:
        back, changes = self._changes
        noisy = np.any(back > _NOISY * changes)
        return joined(np.concatenate([NONE, *self._off, *(self._constant if noisy else [])]))

    @property
    def _widest(self) -> Float[np.ndarray, " dof"]:
        return _STEPS * self.steps + _BANDS * self._band

    def _parts(self, q: DriveRows, row: int) -> Iterator[_Rest]:
        """Consecutive parts of rows that stay in the band of rest."""
        start = 0
        while start < len(q):
            size, stays = self.length, np.ones(1, dtype=bool)
            while stays.all() and len(stays) < len(q) - start:  # checks no more rows than needed
                size *= 2
                ahead = q[start : start + size]
                width = np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead)
                stays = np.all(width <= self._widest, axis=1)
            count = len(stays) if stays.all() else int(np.argmin(stays))
            yield _rest(q[start : start + count], row + start)
            start += count

    def _slow(self, rest: _Rest) -> bool:
        time, width = (rest.last - rest.first) * self.period, rest.high - rest.low
        moves = self._high - self._low > self._widest
        slow = width + self.steps <= _SLOW * self._speed * time
        steady = width <= self._widest * max(_WANDER, time)
        return bool(np.all((slow & steady) | ~moves) and moves.any())

    def _add_torque(self, torque: DriveRows, row: int) -> None:
        length = max(_ROWS, round(_OFF_LASTS / self.period))
        self._torque = np.maximum(self._torque, np.abs(torque).max(axis=0))
        low, high = rolling(torque, length)
        sums = np.cumsum(np.vstack([np.zeros_like(torque[:1]), torque]), axis=0)
        mean = (sums[length:] - sums[:-length]) / length
        near = (np.abs(mean) <= _OFF * self._torque) & (high - low <= _OFF_RANGE * self._torque)
        for spans, flags in ((self._off, near), (self._constant, high == low)):
            spans.append(joined(runs_of(np.all(flags, axis=1), row) + np.array([0, length - 1])))
        change = np.diff(torque, axis=0)
        turned = change[1:] * change[:-1]
        self._changes += [np.count_nonzero(turned < 0, axis=0), np.count_nonzero(change, axis=0)]


class MaskSearch:
    """Running search for excluded rows; `add` consecutive rows, then read `runs`.

    Args:
        dof: number of drives.
        limits: described torque limits of the drives [N m or N]; infinite without a limit.
    """

    def __init__(self, dof: int, limits: Sequence[float]) -> None:
        self._dof, self._row, self._stale = dof, 0, StaleSearch(dof)
        self._ends = [(Extreme(limit), Extreme(limit)) for limit in limits]
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
        for (top, bottom), torque in zip(self._ends, values[:, -n:].T, strict=True):
            top.add(torque, updated, first)
            bottom.add(-torque, updated, first)

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
        on_brakes = _on_brakes(resting, off, round(_LASTS / rest.period))
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
