"""Corrections, findings and exclusions of an identification: a sentence, tables, a chapter."""

import re
from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np

from deltaid.grouping import grouped
from deltaid.model.corrections import NAMES, Correction, Event, FittedSensor, LeftOut
from deltaid.model.parameter_record import HeldLoad
from deltaid.model.record import IdentifiedModel
from deltaid.robot.body import body_in_words
from deltaid.view.model_tables import MEASURED, value_and_width
from deltaid.view.numbers import FEW, in_words, number, percent, with_uncertainty
from deltaid.view.page import Section, Table

# Units that are displayed in thousandths.
_SMALLER = {"s": (1e3, "ms")}
# Origins of the parameters of a load that are shown: torques and the declaration.
_SHOWN_OF_LOADS = ("data", "fixed")
_EVENT_COLUMNS = (
    "event",
    "from [s]",
    "to [s]",
    "platform at x, y, z [m]",
    "force on it x, y, z [N]",
    "|F| [N]",
)


def corrected(corrections: Sequence[Correction]) -> str:
    """Number and kinds of corrections: 'Two corrections were made: …'."""
    things = []
    for kind, subjects in grouped((c.kind, c.subject) for c in corrections).items():
        said = ("", kind, *NAMES[kind].split())
        own = ", ".join(_short([name for name in dict.fromkeys(subjects) if name not in said]))
        things.append(NAMES[kind] + (f" ({own})" if own else ""))
    if len(things) < 2:
        return (
            f"One correction was made: {things[0]}." if things else "Nothing had to be corrected."
        )
    return f"{in_words(len(things)).capitalize()} corrections were made: {', '.join(things)}."


def _short(subjects: Sequence[str]) -> list[str]:
    """Bodies in words; of three or more consecutive drives the first and the last."""
    runs, said = list[list[str]](), list[str]()
    for subject in subjects:
        last = re.fullmatch(r"(.*?)(\d+)", runs[-1][-1]) if runs else None
        if last and f"{last[1]}{int(last[2]) + 1}" == subject:
            runs[-1].append(subject)
        else:
            runs.append([subject])
    for run in runs:
        words = [body_in_words(name) for name in run]
        said += [f"{words[0]} to {words[-1]}"] if words[1:-1] and words == run else words
    return said


def correction_table(corrections: Sequence[Correction]) -> Table:
    """All corrections in the order in which they were made.

    Drives with the same correction share a row.
    """
    several = len({correction.log for correction in corrections if correction.log}) > 1
    alike = groupby(corrections, key=lambda c: (c.kind, c.log, _size(c), c.text))
    table = Table(
        ("corrected", "of", "recording", "by (95 %)", "why"),
        tuple(
            (kind, ", ".join(c.subject for c in group if c.subject) or "all", log or "all", *rest)
            for (kind, log, *rest), group in alike
        ),
        "What was corrected before and in the fit. Intervals of the parameters hold with these "
        "corrections; each can be turned off.",
        title="corrections",
    )
    return _of_logs(table, several)


def _of_logs(table: Table, several: bool) -> Table:
    return table if several else table.without("recording")


def _size(correction: Correction) -> str:
    if correction.value is None:
        return ""
    scale, unit = 1.0, correction.unit
    if abs(correction.value) < 1:
        scale, unit = _SMALLER.get(unit, (scale, unit))
    value, half = number(scale * correction.value), ""
    if correction.low is not None and correction.high is not None:
        width = 0.5 * scale * (correction.high - correction.low)
        value, half = with_uncertainty(scale * correction.value, width)
    return f"{value}{half and f' ± {half}'} {unit}".rstrip()


def load_table(loads: Sequence[HeldLoad]) -> Table:
    """Mass, first moment and inertia of each load, as far as they are known."""
    return Table(
        ("load", "value", "± (95 %)", "unit", "from", "held by", "in"),
        tuple(
            (
                parameter.name,
                *value_and_width(parameter),
                parameter.unit,
                "declared" if parameter.determined_by == "fixed" else "data",
                load.body,
                ", ".join(load.logs),
            )
            for load in loads
            for parameter in load.parameters
            if parameter.determined_by in _SHOWN_OF_LOADS and parameter.value
        ),
        "Moments and inertia are about the origin of the body that holds the load. The model is of "
        "the robot without it.",
        title="loads",
    )


def sensor_tables(sensors: Sequence[FittedSensor]) -> tuple[Table, ...]:
    """Residual of each channel, and identified numbers of the sensors."""
    channels = Table(
        ("channel", "largest", "left by the fit", "noise stated", "unit"),
        tuple(
            (x.name, number(x.largest, 3), number(x.left, 2), number(x.stated, 2), x.unit)
            for sensor in sensors
            for x in sensor.channels
        ),
        "Root mean square of the residual, after the low-pass, which lets only a part of "
        "the stated noise through. Each channel counts by its residual.",
        title="sensors",
    )
    parameters = [parameter for sensor in sensors for parameter in sensor.parameters]
    unknowns = Table(
        ("of the sensor", "value", "± (95 %)", "unit", "from"),
        tuple((x.name, *value_and_width(x), x.unit, x.determined_by) for x in parameters),
        "What was unknown of sensors, fitted with the robot.",
        frozenset(i for i, p in enumerate(parameters) if p.determined_by not in MEASURED),
        "unknowns of sensors",
    )
    return channels, unknowns


def event_table(logs: Iterable[tuple[str, Sequence[Event]]], most: int) -> Table:
    """Events with time, place and force, in order of time; only the largest if there are many.

    Args:
        logs: names of recordings, and their events.
        most: largest number of rows.
    """
    events = [(name, event) for name, events in logs for event in events]
    shown = np.sort(np.argsort([-_force_size(event) for _, event in events], kind="stable")[:most])
    which = f" The {len(shown)} largest of {len(events)}; --json and the model file have all."
    table = Table(
        ("recording", *_EVENT_COLUMNS),
        tuple((events[k][0], *_event_cells(events[k][1])) for k in shown),
        "What acted on the robot besides its drives, with the platform's place and the largest "
        f"force on it. F = −Jᵀ r from the residual torques r."
        f"{which if len(shown) < len(events) else ''}",
        title="events",
    )
    return _of_logs(table, len({name for name, _ in events}) > 1)


def _force_size(event: Event) -> float:
    return 0.0 if event.force is None else float(np.linalg.norm(event.force))


def _event_cells(event: Event) -> tuple[str, ...]:
    times = (f"{event.start:.3f}", f"{event.end:.3f}")
    if event.place is None or event.force is None:
        return (f"{event.reason}, {', '.join(event.drives)}", *times, "", "", "")
    place = ", ".join(f"{x:.3f}" for x in event.place)
    force = ", ".join(f"{x:.0f}" for x in event.force)
    return event.reason, *times, place, force, number(_force_size(event), 3)


def left_out_table(logs: Iterable[tuple[str, Sequence[LeftOut]]]) -> Table | None:
    """Reason, share and times of exclusions; None if only reversals were excluded.

    Args:
        logs: names of recordings, and their exclusions.
    """
    parts = [(name, part) for name, parts in logs for part in parts]
    if not any(part.spans for _, part in parts):
        return None
    why = {part.reason: part.why for _, part in parts}
    words = "; ".join(f"{reason}: {text}" for reason, text in why.items())
    table = Table(
        ("recording", "excluded", "drives", "of the rows", "when [s]"),
        tuple(
            (
                name,
                part.reason,
                ", ".join(drive.removeprefix("drive") for drive in part.drives),
                percent(part.share),
                ", ".join(f"{span.start:.3f}–{span.end:.3f}" for span in part.spans[:FEW])
                + (f" and {rest} more" if (rest := len(part.spans) + part.more - FEW) > 0 else ""),
            )
            for name, part in parts
        ),
        f"What was excluded because it says nothing about the drives' torques, or something "
        f"wrong. {words[0].upper()}{words[1:]}. --keep-all (keep_all of the settings) goes without "
        "all of this.",
    )
    return _of_logs(table, len({name for name, _ in parts}) > 1)


def correction_tables(model: IdentifiedModel, most_events: int) -> tuple[Table, ...]:
    """Tables of corrections, loads, sensors, events and exclusions, without empty ones."""
    sources = model.sources
    tables = (
        correction_table(model.corrections),
        load_table(model.loads),
        *sensor_tables(model.sensors),
        event_table(((source.log, source.events) for source in sources), most_events),
        left_out_table((source.log, source.left_out) for source in sources),
    )
    return tuple(table for table in tables if table and table.rows)


def correction_section(model: IdentifiedModel | None) -> Section:
    """The section of a page on corrections, without blocks if there are none."""
    tables = correction_tables(model, most_events=200) if model else ()
    return Section("Corrections", tables, "what was detected, corrected and excluded")
