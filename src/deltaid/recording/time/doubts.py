"""Doubts about the clock of a recording, and rows at which a file may hold another recording."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Int

from deltaid.errors import Doubt, RecordingError, counted, quoted, visible
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import JITTER, NO_TIME, Clock
from deltaid.recording.time.grid import AGREE
from deltaid.recording.units import MOST_WRONG


def doubts_about_stamps(clock: Clock, table: LogTable, column: str) -> Iterator[Doubt]:
    """Doubts about wild stamps, jitter, uneven sampling and excluded rows.

    Raises:
        RecordingError: too many stamps are wild.
    """
    if clock.wild > MOST_WRONG * clock.rows:
        raise RecordingError(
            f"column {column} jumps about: {clock.wild} of {clock.rows} stamps are far off those "
            "before and after them; it is no time",
            where=table.row_place(table.first_row + clock.first_wild),
            cure=NO_TIME,
        )
    if clock.wild:
        yield Doubt(
            f"{column} of {rows_are(clock.wild)} far off the stamps before and after, the first "
            f"in {_row(table, np.array([clock.first_wild]))}: excluded",
            cause="numbers that were damaged on their way into the file",
            cure="export the log again if there are many",
            key="clock",
        )
    yield from _doubts_about_jitter(clock, column)
    stands, cause, cure = stood(clock, table, column)
    if stands:
        yield Doubt(stands, cause=cause, cure=cure, key="clock")
        return
    if clock.doubled:
        yield Doubt(
            f"{rows_are(clock.doubled)} there twice and excluded once, the first in "
            f"{_row(table, clock.extra)}",
            cause="the logger ran ahead of the controller, or a packet came twice",
            cure="nothing is lost; to avoid it, log once a cycle of the controller",
            key="clock",
        )
    if clock.late:
        yield Doubt(
            f"{rows_are(clock.late)} late or stamped like another one, and excluded"
            + ("" if clock.doubled else f", the first in {_row(table, clock.extra)}"),
            cause="packets overtook one another on their way to the logger",
            cure="log with the controller's own stamps, sorted by them",
            key="clock",
        )


def _doubts_about_jitter(clock: Clock, column: str) -> Iterator[Doubt]:
    share = clock.jitter * clock.rate
    off = f"{1e3 * clock.jitter:.3g} ms rms ({100 * share:.2g} % of a step)"
    if clock.even is False:
        yield Doubt(
            f"samples were taken at uneven times, off by {off}: positions follow the stamps of "
            f"{column}, so all is interpolated at {clock.rate:.6g} Hz",
            cause="the logger asks the controller when it finds time to",
            cure="log in the controller's own cycle",
            key="clock",
        )
    elif share > JITTER:
        why = "positions are even" if clock.even else "positions do not show which is right"
        yield Doubt(
            f"stamps of {column} jitter by {off}; {why}, so rows are taken as evenly spaced at "
            f"{clock.rate:.6g} Hz",
            cause="rows are stamped when they are written, not when they are measured",
            cure="record the controller's own time or count of cycles"
            + ("" if clock.even else "; if rows are known to be even, declare `rate:`"),
            key="clock",
        )


def stood(clock: Clock, table: LogTable, column: str) -> tuple[str, str, str]:
    """Message that time stands still, likeliest cause, and fix; empty if it does not.

    Args:
        column: name of the time column.
    """
    runs = np.split(clock.extra, np.flatnonzero(np.diff(clock.extra) > 1) + 1)
    longest = max(runs, key=len)
    if len(longest) <= AGREE:
        return "", "", ""
    return (
        f"{column} stands still in {len(longest)} rows, the first {_row(table, longest)}: excluded",
        "an array that was made longer than the recording, or a logger that hung",
        "write the file without such rows; else no action is needed",
    )


def slowed(clock: Clock, table: LogTable) -> tuple[str, str, str]:
    """Message that some rows have a lower rate than the rest, likeliest cause, and fix; empty if
    none have."""
    breaks = np.flatnonzero((np.diff(clock.holes) != 1) | np.diff(clock.lost).astype(bool)) + 1
    longest = max(np.split(np.arange(len(clock.holes)), breaks), key=len)
    if len(longest) <= AGREE or clock.lost[longest[0]] < 1:
        return "", "", ""
    first, slower = clock.holes[longest[0]] - 1, clock.rate / (1 + clock.lost[longest[0]])
    return (
        f"{len(longest) + 1} rows from {_row(table, np.array([first]))} on come at "
        f"{slower:.6g} Hz, others at {clock.rate:.6g} Hz",
        "the rate was changed while recording, or recordings of two rates are in one file",
        "record at one rate, or split the file there; else no action is needed",
    )


def restarted(clock: Clock, table: LogTable, column: str) -> tuple[str, str, str]:
    """Message that time restarts, likeliest cause, and fix; empty if it does not.

    Args:
        column: name of the time column.
    """
    rows = clock.holes[clock.lost < 0]
    if not rows.size:
        return "", "", ""
    seen = f"time starts again in {counted(rows.size, 'place')}, the first in {_row(table, rows)}"
    if (part := _part_column(table, column, rows)) is None:
        return (
            seen,
            "several recordings stand in one file, or the clock was set or passed midnight",
            "split it there if load or wiring changed; otherwise no action is needed",
        )
    name, before, after = part
    return (
        f"{seen}, and column {name} changes there only, first from {before} to {after}",
        "recordings of several robots or runs stand in one file",
        f"split it by column {name}, unless all of it is of one robot with the same load and "
        "wiring",
    )


def doubts_about_holes(
    clock: Clock, table: LogTable, column: str, longest: int, shortest: int
) -> Iterator[Doubt]:
    """Doubts about bridged holes, gaps, and segments that are too short.

    Args:
        column: name of the time column.
        longest: most missing rows that are bridged.
        shortest: fewest samples of a usable segment.

    Raises:
        RecordingError: no segment is usable.
    """
    report, sizes = clock.report(longest, shortest), clock.segments(longest)
    if report.bridged:
        yield _doubt_about_bridges(clock, table, report.bridged, clock.holes[~clock.cuts(longest)])
    if report.restarts:
        seen, cause, cure = restarted(clock, table, column)
        yield Doubt(f"{seen}: a new segment begins there", cause=cause, cure=cure, key="clock")
    if gaps := report.gaps:
        spans = [f"{since:.6g} to {until:.6g} s" for since, until in gaps[:5]]
        shown = ", ".join(spans) + (" …" if len(gaps) > 5 else "")
        yield Doubt(
            f"{counted(len(gaps), 'gap')} of up to "
            f"{1e3 * max(until - since for since, until in gaps):.4g} ms ({shown}): no filter "
            "reaches across",
            cause="logging stopped, or its buffer ran over",
            cure="log fewer channels or at a lower rate if gaps come again and again",
            key="clock",
        )
    if not report.segments:
        raise RecordingError(
            f"has no stretch of {shortest} samples without a gap; the longest has "
            f"{sizes.max()}, between {counted(len(sizes) - 1, 'place')} where rows are "
            "missing or time starts again",
            where=str(table.path),
            cure="record without gaps, or lower the rate at which the logger falls behind; a "
            "higher --cutoff needs shorter stretches",
        )
    if short := len(sizes) - report.segments:
        yield Doubt(
            f"{short} of {len(sizes)} stretches between gaps are shorter than the "
            f"{shortest} samples that the filter needs, and excluded: "
            f"{100 * report.too_short:.2g} % of the recording",
            cause="gaps follow close on one another",
            cure="record without gaps, or take a higher --cutoff, whose filter is shorter",
            key="clock",
        )


def _doubt_about_bridges(
    clock: Clock, table: LogTable, bridged: int, holes: Int[np.ndarray, " holes"]
) -> Doubt:
    missing = (
        f"{rows_are(bridged)} missing in {counted(holes.size, 'place')} "
        f"({100 * bridged / clock.rows:.2g} % of the recording), the first before "
        f"{_row(table, holes)}: bridged by the motion about them, torques there do not count"
    )
    slower, cause, cure = slowed(clock, table)
    return Doubt(
        f"{slower}; {missing}" if slower else missing,
        cause=cause or "packets were lost on their way to the logger",
        cure=cure or "no action is needed for a few; else log on the controller itself",
        key="clock",
    )


def _row(table: LogTable, rows: Int[np.ndarray, " rows"]) -> str:
    return table.row_name(table.first_row + int(rows[0]))


def rows_are(count: int) -> str:
    return f"{counted(count, 'row')} {'is' if count == 1 else 'are'}"


def _part_column(
    table: LogTable, time: str, starts: Int[np.ndarray, " starts"]
) -> tuple[str, str, str] | None:
    """First column that changes only where time restarts, with its values before and after its
    first change; None without one.

    Args:
        time: name of the time column.
        starts: rows in which time restarts, from 0.

    Raises:
        RecordingError: the recording cannot be read.
    """
    # Columns with one value per row.
    plain = [field.name for field in table.fields if len(field.shape) == 1 and not field.holds]
    names = [name for name in plain if name != time and table.can_read([time, name])]
    steady, parts = set(names), dict[str, tuple[str, str, str]]()
    last, row = dict[str, np.ndarray](), 0
    for block in table.rows([time, *names]) if names else ():
        for name, written in zip(names, map(np.asarray, block.written[1:]), strict=True):
            if name not in steady:
                continue
            values = np.concatenate([last[name], written]) if name in last else written
            changes = np.flatnonzero(values[1:] != values[:-1]) + 1
            rows = changes + row - (len(values) - len(written))
            if not np.isin(rows, starts).all():
                steady.remove(name)
            elif changes.size and name not in parts:
                before, after = values[changes[0] - 1 : changes[0] + 1].tolist()
                parts[name] = name, _shown(before), _shown(after)
            last[name] = values[-1:]
        if not steady:
            break
        row += block.size
    return next((parts[name] for name in names if name in steady & {*parts}), None)


def _shown(value: object) -> str:
    return quoted(visible(f"{value:g}" if isinstance(value, float) else str(value), kept=""))
