"""Whether the gripper's signal tells what is held, and when, in words."""

from collections.abc import Iterator, Sequence

import numpy as np

from deltaid.errors import Doubt
from deltaid.online.events import WeighedLoad
from deltaid.online.instant import EMPTY, HOLDS
from deltaid.online.suspicion import RunEvidence

# Share of the time that the gripper calls empty with a contact, beyond which something is held.
_TOUCHED = 0.2
# The share of all loads at which it shows that they weigh nothing.
_SHARE = 0.5
# Signals that are off by so much [s] are told, and those of both kinds are alike within the other.
_OFF, _ALIKE = 0.008, 0.011


def gripper_doubts(
    seen: RunEvidence, loads: Sequence[WeighedLoad], grip_time: float, *, is_column: bool = True
) -> tuple[Doubt, ...]:
    """All that speaks against the gripper's signal.

    Args:
        grip_time: from the signal to the load, as it is known [s].
        is_column: whether a column tells, which should change.
    """
    if is_column and (seen.told <= {EMPTY} or seen.told <= {HOLDS}):
        what = "empty" if EMPTY in seen.told else "something held"
        constant = Doubt(
            f"the gripper signals {what} from the first row to the last",
            cause="the column is not the gripper's, or was not recorded",
            cure="give the column that changes with each pick, or leave --gripper out: loads are "
            "then found from torques alone",
        )
        return (constant,)
    nothing = sum(load.mass.low <= 0 for load in loads)
    weightless = nothing >= max(1, _SHARE * len(loads))
    if weightless and seen.touched_empty > _TOUCHED * seen.empty:
        inverted = Doubt(
            f"{nothing} of {len(loads)} loads weigh nothing, and torques are beyond the model for "
            f"{seen.touched_empty:.3g} s while the gripper signals nothing held",
            cause="the signal is 0 while something is held, and 1 while not",
            cure="give the numbers that mean held in a mapping, load: {column: …, when: [0]}",
        )
        return (inverted,)
    if apart := tuple(_apart(seen, grip_time)):
        return apart
    without_part = Doubt(
        f"{nothing} of {len(loads)} loads weigh nothing that torques show",
        cause="the gripper closed without a part, or its signal is another one",
        cure="check what the column holds",
    )
    return (without_part,) if weightless else ()


def _apart(seen: RunEvidence, grip_time: float) -> Iterator[Doubt]:
    """Signals that come before or after what they tell of."""
    kinds = {"are taken": seen.taken, "are left": seen.left}
    shown = {word: offset for word, offset in kinds.items() if offset.low or offset.high}
    # By how much they are off at least.
    least = {w: np.clip(grip_time, o.low, o.high) - grip_time for w, o in shown.items()}
    off = {w: o for w, o in shown.items() if abs(least[w]) > _OFF}
    if not off:
        return
    low, high = max(o.low for o in off.values()), min(o.high for o in off.values())
    alike = len(off) == 2 and high > low - _ALIKE
    if alike:
        low, high = min(low, high), max(low, high)
        said = f"{_in_words(low, high, grip_time)} loads are taken, and left"
    else:
        said = " and ".join(
            f"{_in_words(o.low, o.high, grip_time)} loads {w}" for w, o in off.items()
        )
    signals, saying = (sum(getattr(o, n) for o in off.values()) for n in ("signals", "saying"))
    early = min(offset.middle for offset in off.values()) > grip_time
    yield Doubt(
        f"the gripper signals {said} ({saying} of {signals} signals show it): masses of the first "
        "tenths of a second are wrong, later ones a little, and contacts about then may be the "
        "load",
        cause="the signal is the command to the gripper, or parts are gripped before being lifted"
        if early
        else "the signal comes through a sensor or a bus that is slow",
        cure=f"give the time from the signal to the load by --grip-time {0.5 * (low + high):.2g}"
        if alike and early
        else "record a signal that comes with the load, or leave --gripper out",
    )


def _in_words(low: float, high: float, grip_time: float) -> str:
    """'50 ms before', '40 to 60 ms after'."""
    first, last = sorted((abs(low - grip_time), abs(high - grip_time)))
    word = "before" if low + high > 2 * grip_time else "after"
    span = f"{1e3 * first:.0f} to " if last - first > _ALIKE else ""
    value = last if span else 0.5 * (first + last)
    return f"{span}{1e3 * value:.0f} ms {word}"
