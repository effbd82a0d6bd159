"""Whether the gripper's signal tells what is held, and when, by what torques show about it.

A load that is taken before the gripper tells of it looks like a contact until it does, one that is
still held when the gripper tells that it is left, like a contact until it is: of the same length
again and again. What is told before it is held is found as no load, and then as a contact.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from deltaid.errors import Doubt
from deltaid.online.found import HeldLoad, Touch
from deltaid.online.rows import EMPTY, HOLDS
from deltaid.online.suspicion import Seen

# Share of the time that the gripper calls empty with a contact, beyond which something is held.
_TOUCHED = 0.2
# How far apart signal and load may be [s], what is not told [s], and the share of all changes, and
# their number, at which that shows.
_APART, _HARMLESS, _SHARE, _FEWEST = 0.3, 0.008, 0.5, 2
# A contact that ends within this [s] of a signal ends with it; and the share of all contacts that
# must be of that kind.
_TOGETHER, _OF_CONTACTS = 0.06, 0.3
# Contacts are found, and are over, so much late [s].
_FOUND, _OVER = 0.004, 0.009
# Signals are alike that differ by no more [s].
_ALIKE = 0.012


def gripper_doubts(
    seen: Seen, loads: Sequence[HeldLoad], touches: Sequence[Touch]
) -> tuple[Doubt, ...]:
    """All that speaks against the gripper's signal."""
    return tuple(_constant(seen)) or tuple(_inverted(seen, loads)) or tuple(_apart(loads, touches))


def _constant(seen: Seen) -> Iterator[Doubt]:
    if seen.told <= {EMPTY} or seen.told <= {HOLDS}:
        what = "empty" if EMPTY in seen.told else "something held"
        yield Doubt(
            f"the gripper tells of {what} from the first row to the last",
            cause="the column is not the gripper's, or was not recorded",
            cure="give the column that changes with each pick, or leave --gripper out: loads are "
            "then found from torques alone",
        )


def _inverted(seen: Seen, loads: Sequence[HeldLoad]) -> Iterator[Doubt]:
    nothing = sum(one.mass.low <= 0 for one in loads)
    if nothing < max(1, _SHARE * len(loads)):
        return
    if seen.touched_empty > _TOUCHED * seen.empty:
        yield Doubt(
            f"{nothing} of {len(loads)} loads weigh nothing, and torques are beyond the model for "
            f"{seen.touched_empty:.3g} s while the gripper tells of nothing held",
            cause="the signal is 0 while something is held, and 1 while not",
            cure="give the numbers that mean held in a mapping, load: {column: …, when: [0]}",
        )
        return
    yield Doubt(
        f"{nothing} of {len(loads)} loads weigh nothing that torques show",
        cause="the gripper closed without a part, or its signal is another one",
        cure="check what the column holds",
    )


def _apart(loads: Sequence[HeldLoad], touches: Sequence[Touch]) -> Iterator[Doubt]:
    """Signals that come earlier or later than what they tell of, by the same again and again."""
    signals = [one.start for one in loads] + [one.end for one in loads if one.end is not None]
    early, late = (_matches(signals, touches, how) for how in (_after, _before))
    times, word = (early, "earlier") if len(early) > len(late) else (late, "later")
    enough = max(_FEWEST, _SHARE * len(signals), _OF_CONTACTS * len(touches))
    if len(times) < enough or np.median(times) < _HARMLESS:
        return
    apart = round(1e3 * float(np.median(times)))
    yield Doubt(
        f"{len(times)} of {len(signals)} signals of the gripper come about {apart} ms {word} than "
        "the load shows: contacts that are told about then are the load, and its mass is wrong for "
        "some tenths of a second",
        cause="the signal is the command to the gripper, or parts are gripped before being lifted"
        if word == "earlier"
        else "the signal comes through a sensor or a bus that is slow",
        cure=f"give the time from the signal to the load by --grip-time {1e-3 * apart:g}"
        if word == "earlier"
        else "record a signal that comes in time, or leave --gripper out",
    )


def _matches(
    signals: Sequence[float],
    touches: Sequence[Touch],
    how: Callable[[float, Touch], float | None],
) -> list[float]:
    """By how much each signal is off, of those for which a contact says so, and alike."""
    each = ([how(at, touch) for touch in touches] for at in signals)
    told = ([one for one in found if one is not None] for found in each)
    first = np.array([found[0] for found in told if found])
    usual = float(np.median(first)) if first.size else 0.0
    return first[np.abs(first - usual) <= np.hypot(_ALIKE, 0.1 * usual)].tolist()


def _before(at: float, touch: Touch) -> float | None:
    """How long before a signal a contact began that ended with it."""
    with_it = abs(touch.end - at) < _TOGETHER
    return at - touch.start + _FOUND if with_it and at - _APART < touch.start < at else None


def _after(at: float, touch: Touch) -> float | None:
    """How long after a signal a contact ended, or began, that belongs to it."""
    if at < touch.start < at + _HARMLESS and touch.end < at + _APART:  # left, and held still
        return touch.end - _OVER - at
    return touch.start - _FOUND - at if at + _HARMLESS < touch.start < at + _APART else None
