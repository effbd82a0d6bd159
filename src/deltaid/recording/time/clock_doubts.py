"""What was found of a recording's time, in words: one sentence each."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Int

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import Clock

# Jitter that is worth a word, as a share of a period.
_WORTH = 0.01
# Where a larger share of stamps is far off those about them, none is believed.
_MOST_WILD = 0.2


def doubts_about_stamps(clock: Clock, table: LogTable, column: str) -> Iterator[Doubt]:
    """Stamps that are none, jitter, uneven sampling, rows that are left out.

    Raises:
        RecordingError: too many stamps are none.
    """
    if clock.wild > _MOST_WILD * clock.rows:
        raise RecordingError(
            f"column {column} jumps about: {clock.wild} of {clock.rows} stamps are far off those "
            "before and after them; it is no time",
            where=table.row_place(table.first_row + clock.first_wild),
            cure="map the column of the time with --columns MAPPING.yaml (time: {column: NAME}), "
            "or give the sampling rate in its place (time: {rate: 1000})",
        )
    if clock.wild:
        yield Doubt(
            f"{column} of {_rows(clock.wild)} far off the stamps before and after, the first "
            f"in {_row(table, np.array([clock.first_wild]))}: excluded",
            cause="numbers that were damaged on their way into the file",
            cure="export the log again if there are many",
            key="clock",
        )
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
    elif share > _WORTH:
        why = "positions are even" if clock.even else "positions do not show which is right"
        yield Doubt(
            f"stamps of {column} jitter by {off}; {why}, so rows are taken as evenly spaced at "
            f"{clock.rate:.6g} Hz",
            cause="rows are stamped when they are written, not when they are measured",
            cure="record the controller's own time or count of cycles"
            + ("" if clock.even else "; if rows are known to be even, declare `rate:`"),
            key="clock",
        )
    if clock.doubled:
        yield Doubt(
            f"{_rows(clock.doubled)} there twice and excluded once, the first in "
            f"{_row(table, clock.extra)}",
            cause="the logger ran ahead of the controller, or a packet came twice",
            cure="nothing is lost; to avoid it, log once a cycle of the controller",
            key="clock",
        )
    if others := clock.late:
        yield Doubt(
            f"{_rows(others)} late or stamped like another one, and excluded"
            + ("" if clock.doubled else f", the first in {_row(table, clock.extra)}"),
            cause="packets overtook one another on their way to the logger",
            cure="log with the controller's own stamps, sorted by them",
            key="clock",
        )


def doubts_about_holes(
    clock: Clock, table: LogTable, longest: int, shortest: int
) -> Iterator[Doubt]:
    """Holes that are bridged, gaps that cut, and what is too short between them.

    Args:
        longest: rows missing that are bridged.
        shortest: samples that a segment must have.

    Raises:
        RecordingError: no segment has so many.
    """
    cuts = clock.cuts(longest)
    bridged = clock.lost[~cuts]
    if bridged.size:
        first = clock.holes[~cuts]
        yield Doubt(
            f"{_rows(int(bridged.sum()))} missing in {_places(bridged.size)} "
            f"({100 * bridged.sum() / clock.rows:.2g} % of the recording), the first before "
            f"{_row(table, first)}: bridged by the motion about them, torques there do not "
            "count",
            cause="packets were lost on their way to the logger",
            cure="nothing is to be done for a few; else log on the controller itself",
            key="clock",
        )
    restarts = clock.lost < 0
    if restarts.any():
        where = _row(table, clock.holes[restarts])
        yield Doubt(
            f"time starts again in {_places(int(restarts.sum()))}, the first in {where}: a new "
            "segment begins there",
            cause="several recordings stand in one file",
            cure="split it if load or wiring were others; else nothing is to be done",
            key="clock",
        )
    gaps = cuts & ~restarts
    if gaps.any():
        length = (clock.until - clock.since)[gaps]
        spans = [
            f"{since:.6g} to {until:.6g} s"
            for since, until in zip(clock.since, clock.until, strict=True)
        ]
        shown = ", ".join(np.array(spans)[gaps][:5]) + (" …" if gaps.sum() > 5 else "")
        yield Doubt(
            f"{gaps.sum()} gap{'s' if gaps.sum() > 1 else ''} of up to "
            f"{1e3 * length.max():.4g} ms ({shown}): no filter reaches across",
            cause="logging stopped, or its buffer ran over",
            cure="log fewer channels or at a lower rate if gaps come again and again",
            key="clock",
        )
    sizes = clock.segments(longest)
    short = sizes[sizes < shortest]
    if len(short) == len(sizes):
        raise RecordingError(
            f"has no stretch of {shortest} samples without a gap; the longest has "
            f"{sizes.max()}, between {_places(len(sizes) - 1)} where rows are missing or time "
            "starts again",
            where=str(table.path),
            cure="record without gaps, or lower the rate at which the logger falls behind; a "
            "higher --cutoff needs shorter stretches",
        )
    if short.size:
        yield Doubt(
            f"{short.size} of {len(sizes)} stretches between gaps are shorter than the "
            f"{shortest} samples that the filter needs, and excluded: "
            f"{100 * short.sum() / sizes.sum():.2g} % of the recording",
            cause="gaps follow close on one another",
            cure="record without gaps, or take a higher --cutoff, whose filter is shorter",
            key="clock",
        )


def _row(table: LogTable, rows: Int[np.ndarray, " rows"]) -> str:
    """The first of some rows, counted from 0, as a user counts it."""
    return table.row_name(table.first_row + int(rows[0]))


def _rows(count: int) -> str:
    return "1 row is" if count == 1 else f"{count} rows are"


def _places(count: int) -> str:
    return "1 place" if count == 1 else f"{count} places"
