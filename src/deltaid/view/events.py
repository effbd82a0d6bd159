"""Table of what acted on a robot beside its drives, for the terminal and for pages alike."""

from collections.abc import Iterable, Sequence

import numpy as np

from deltaid.model.events import Event
from deltaid.view.numbers import number
from deltaid.view.table import Table

_HEAD = (
    "event",
    "from [s]",
    "to [s]",
    "platform at x, y, z [m]",
    "force on it x, y, z [N]",
    "|F| [N]",
)


def event_table(logs: Iterable[tuple[str, Sequence[Event]]], most: int) -> Table | None:
    """Events with time, place and force; of many the largest, in the order of time.

    Args:
        logs: names of recordings, and their events.
        most: so many rows at most.

    Returns:
        None if there are no events.
    """
    all_of_them = [(name, event) for name, events in logs for event in events]
    if not all_of_them:
        return None
    size = np.array([_size(event) for _, event in all_of_them])
    shown = np.sort(np.argsort(-size, kind="stable")[:most])
    several = len({name for name, _ in all_of_them}) > 1
    rows = tuple(
        (*((all_of_them[k][0],) if several else ()), *_cells(all_of_them[k][1])) for k in shown
    )
    fewer = len(all_of_them) - len(shown)
    which = (
        f" The {len(shown)} largest of {len(all_of_them)}; --json and the model file have all."
        if fewer
        else ""
    )
    return Table(
        (*(("recording",) if several else ()), *_HEAD),
        rows,
        "What acted on the robot beside its drives, with the platform's place and the force on it "
        f"when it was largest, F = −Jᵀ r from the torques r that were left.{which}",
        title="events",
    )


def _size(event: Event) -> float:
    return 0.0 if event.force is None else float(np.linalg.norm(event.force))


def _cells(event: Event) -> tuple[str, ...]:
    times = (f"{event.start:.3f}", f"{event.end:.3f}")
    if event.place is None or event.force is None:
        return (f"{event.reason}, {', '.join(event.drives)}", *times, "", "", "")
    place = ", ".join(f"{x:.3f}" for x in event.place)
    force = ", ".join(f"{x:.0f}" for x in event.force)
    return event.reason, *times, place, force, number(_size(event), 3)
