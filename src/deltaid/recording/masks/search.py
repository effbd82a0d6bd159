"""Finding what of a recording is no motion under power of its drives, while it is surveyed.

That is also when the loads of a recording are taken up and put down.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.columns import Columns
from deltaid.recording.masks.masks import LOAD_CHANGES, NONE, Mask, Reason, Runs, joined, without
from deltaid.recording.masks.rest import RestSearch
from deltaid.recording.masks.stuck import Extreme, StaleSearch
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import Clock

# A channel at its end is taken to stay there for so long [s] between two samples on it: noise took
# it off for a moment, and what it leaves there is noise of one sign.
_BETWEEN = 0.003
# What is on brakes or not is not told apart in less than this [s].
_SHORT = 0.04
# An emergency stop ends so long after the drives are without torque at most [s].
_STOPS = 1.5
# A gripper's signal and its grip are so far apart at most [s].
_ABOUT = 0.012

# What is left out: why, for which drives, and which rows counted from 0.
Found = tuple[Reason, tuple[int, ...], Runs]


class MaskSearch:
    """Running search; `add` consecutive rows, then ask for `runs`.

    Args:
        dof: number of drives.
        limits: torque limits of the drives by the description; infinite where there is none.
    """

    def __init__(self, dof: int, limits: Sequence[float]) -> None:
        self._dof, self._row = dof, 0
        self._stale = StaleSearch(dof)
        self._ends = [(Extreme(limit), Extreme(limit)) for limit in limits]
        self._rest: RestSearch | None = None
        self._before: np.ndarray | None = None

    def add(self, values: Float[np.ndarray, "rows channels"], period: float) -> None:
        """Take in rows: time, positions, what else is recorded, torques.

        Args:
            period: usual time between two rows [s].
        """
        n = self._dof
        if not period:  # stamps that several rows share
            period = float(np.ptp(values[:, 0])) / max(1, len(values) - 1)
        if not period and self._rest is None:
            self._row += len(values)
            return
        rest = self._rest = self._rest or RestSearch(n, period)
        block = values if self._before is None else np.vstack([self._before, values])
        rest.add(block[:, 1 : 1 + n], block[:, -n:], self._row + len(values) - len(block))
        self._before = block[-rest.overlap :]
        new = self._stale.add(values[:, 1:], rest.steps)
        for (top, bottom), torque in zip(self._ends, values[:, -n:].T, strict=True):
            top.add(torque, new, self._row)
            bottom.add(-torque, new, self._row)
        self._row += len(values)

    def runs(self) -> list[Found]:
        """All that is left out."""
        rest, everyone = self._rest, tuple(range(self._dof))
        if rest is None:
            return []
        stale = self._stale.runs(rest.steps)
        short = round(_SHORT / rest.period)
        off, resting = rest.off, without(rest.at_rest, stale)
        resting = resting[resting[:, 1] - resting[:, 0] >= rest.overlap]
        on_brakes, under_control = _told_apart(resting, off, short)
        stopping = _stops(off, on_brakes, round(_STOPS / rest.period))
        found: list[Found] = [
            ("standing still", everyone, under_control),
            ("on brakes", everyone, on_brakes),
            ("emergency stop", everyone, stopping),
            ("stale rows", everyone, stale),
        ]
        between = round(_BETWEEN / rest.period)
        for i, ends in enumerate(self._ends):
            largest = max(abs(end.level) for end in ends)
            saturated = np.concatenate([joined(e.runs(largest), between) for e in ends])
            ordered = saturated[np.argsort(saturated[:, 0])]
            found.append(("saturated torque", (i,), without(ordered, on_brakes)))
        return [part for part in found if len(part[2])]


class LoadSearch:
    """Running search; `add` consecutive rows, then ask for `runs` and `doubts`."""

    def __init__(self, table: LogTable, columns: Columns) -> None:
        self._table, self._columns, self._rows = table, columns, 0
        self._changes = [np.zeros(0, dtype=np.int64)]
        self._last = np.zeros((len(columns.loads), 0), dtype=bool)
        self._ever = np.zeros(len(columns.loads), dtype=bool)

    def add(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Take in rows, columns as in `Columns.all`; `row` numbers the first for messages.

        Raises:
            RecordingError: a column is neither 0 nor 1, and the mapping names no other numbers.
        """
        extra = values[:, self._columns.extra_places]
        for load in self._columns.loads:
            if load.column is None or load.holding is not None:
                continue
            numbers = extra[:, self._columns.beside(load.column)]
            other = np.flatnonzero((numbers != 0.0) & (numbers != 1.0))
            if other.size:
                raise RecordingError(
                    f"column {load.column} of load {load.name} is {numbers[other[0]]:.10g}, "
                    "neither 0 nor 1",
                    where=self._table.row_place(row + int(other[0])),
                    cure="list the numbers at which the load is held: "
                    f"load: {{column: {load.column}, when: [{numbers[other[0]]:.10g}]}}",
                )
        held = np.hstack([self._last, self._columns.held(values[:, 0], extra)])
        changes = np.flatnonzero(np.any(np.diff(held, axis=1), axis=0))
        self._changes.append(self._rows + changes + 1 - self._last.shape[1])
        self._last = held[:, -1:]
        self._ever |= held.any(axis=1)
        self._rows += len(values)

    def runs(self, rate: float) -> list[Found]:
        """Rows about the changes, which count for no drive, at a sampling rate [Hz]."""
        about = max(1, round(_ABOUT * rate))
        changes = np.concatenate(self._changes)
        runs: Runs = joined(np.column_stack([changes - about, changes + about - 1]))
        drives = tuple(range(len(self._columns.torque)))
        return [(LOAD_CHANGES, drives, np.clip(runs, 0, self._rows - 1))] if drives else []

    def doubts(self) -> list[Doubt]:
        """Spans in which nothing was recorded."""
        return [
            Doubt(
                f"load {load.name} is declared for spans in which nothing was recorded",
                cause="spans count in the time of another recording, or in another unit",
                cure="give spans in s, by the time of this recording",
            )
            for load, ever in zip(self._columns.loads, self._ever, strict=True)
            if load.spans is not None and not ever
        ]


def timed(found: Iterable[Found], clock: Clock) -> tuple[Mask, ...]:
    """Rows as masks, in their order; the clock tells when they were."""
    masks = [
        Mask(reason, drives, first, last, *clock.stamps(np.array([first, last])).tolist())
        for reason, drives, runs in found
        for first, last in runs.tolist()
    ]
    return tuple(sorted(masks, key=lambda mask: (mask.first, mask.drives)))


def _told_apart(resting: Runs, off: Runs, short: int) -> tuple[Runs, Runs]:
    """Rest on brakes and rest under control; the shorter parts belong to what they lie in."""
    brakes: list[Runs] = []
    for first, last in resting:
        here = off[(off[:, 1] >= first) & (off[:, 0] <= last)]
        here = joined(np.clip(here, first, last), short)
        here = here[here[:, 1] - here[:, 0] >= min(short, last - first)]
        if len(here):
            here[0, 0] = first if here[0, 0] - first <= short else here[0, 0]
            here[-1, 1] = last if last - here[-1, 1] <= short else here[-1, 1]
        brakes.append(here)
    on_brakes = np.concatenate([NONE, *brakes])
    return on_brakes, without(resting, on_brakes)


def _stops(off: Runs, on_brakes: Runs, longest: int) -> Runs:
    stops = []
    for first, last in off:
        after = on_brakes[(on_brakes[:, 0] > first) & (on_brakes[:, 0] <= last + 1)]
        if len(after) and after[0, 0] - first <= longest:
            stops.append((first, after[0, 0] - 1))
    return np.array(stops, dtype=np.int64).reshape(-1, 2)
