"""Recordings that were surveyed."""

from deltaid.recording.log import Log
from deltaid.recording.recording import Recording
from deltaid.view.card import Card
from deltaid.view.models import warned
from deltaid.view.numbers import number


def card(value: Log | Recording) -> Card:
    """Size, rate, filter, and what is left out of it."""
    log = value.log if isinstance(value, Recording) else value
    facts = [
        ("samples", str(log.samples)),
        ("rate", f"{number(log.rate)} Hz"),
        ("seconds", number(log.samples / log.rate)),
    ]
    if isinstance(value, Recording) and value.cutoff:
        facts.append(("low-pass", f"{number(value.cutoff, 3)} Hz"))
    if log.masks:
        facts.append(("stretches left out", str(len(log.masks))))
    first = next(iter(log.warnings), "nothing about it is doubtful")
    return Card(
        f"Recording {log.path.name}, surveyed",
        (str(first),),
        "",
        tuple(facts),
        more=warned(tuple(str(text) for text in log.warnings)),
    )
