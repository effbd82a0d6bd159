"""What columns of a foreign recording mean, by their names and their first numbers.

Names as people and drives write them say what each stands for, and which axes belong together.
Numbers say whether a column may be a time, and in which unit; whether velocities are the
derivatives of positions, and which unit follows from that.
"""

import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from deltaid.recording.column_words import (
    COMMANDED,
    DERIVATIVES,
    FILLERS,
    MEASURED,
    OTHERS,
    QUANTITIES,
    SIGNALS,
    UNITS,
)
from deltaid.recording.units import factor_among, is_unit

_KNOWN = frozenset[str]().union(
    *QUANTITIES.values(), MEASURED, COMMANDED, OTHERS, FILLERS, DERIVATIVES
)
# The quantity that a unit is of, by the SI units that it may be converted to.
_KINDS = {
    "time": ("s",),
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "torque": ("N m", "N"),
    "current": ("A",),
}
# Parts of a compound have three letters at least; German ones may be linked by two.
_PART, _LINKS = 3, ("", "s", "n", "en", "es")
_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]*?)\s*[\])]")
_LATIN = re.compile(r"[A-Za-zµ]+|[^\W\dA-Za-z_]+")
_HUMPS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NUMBER = re.compile(r"\d+")
_LETTER = re.compile(r"(?<![A-Za-z])[A-CX-Z](?![A-Za-z])|(?<=[a-z])[X-Z]$")
_SIGNAL = re.compile(
    r"(?<![a-z0-9])(?:0x)?("
    + "|".join(re.escape(name) for name in sorted(SIGNALS, key=len, reverse=True))
    + r")(?![a-z0-9])"
)
Signal = Float[np.ndarray, " rows"]
# Share of steps of a time that may run backwards, as damage.
_BACKWARDS = 0.01
# Usual steps that can be of one unit only, recorded at 10 Hz to 20 kHz: seconds up to the step
# that would be 100 kHz in ms; ms where seconds would be slower than 10 Hz and the number is no
# cycle's; ns where ticks of 100 ns would be slower.
_STEPS = (("s", 5e-5, 0.0100001), ("ms", 0.11, 0.9), ("ns", 1.1e6, 1e8))
# Rows on either side over which a position is differentiated, and a velocity averaged.
_HALF = 4
# Correlation of a derivative at least, and how far factors of drives or units may differ.
_SAME, _APART = 0.98, 0.03
_UNITS = {
    ("time", False): ("s", "ms", "us", "ns"),
    ("position", False): ("rad", "deg", "rev"),
    ("velocity", False): ("rad/s", "deg/s", "rpm", "rev/s"),
    ("position", True): ("m", "mm"),
    ("velocity", True): ("m/s", "mm/s"),
}


@dataclass(frozen=True)
class Reading:
    """What the name of a column says.

    Attributes:
        quantity: time, position, velocity, acceleration, torque or current; empty if none.
        unit: as pint reads it; empty where a rated value or an encoder decides; None if unstated.
        is_measured: whether it says so.
        is_usable: whether it is a drive's state, neither commanded nor of something else.
        words: all of it.
        documented: the name of a drive's signal that decided, if one did.
    """

    quantity: str
    unit: str | None
    is_measured: bool
    is_usable: bool
    words: tuple[str, ...]
    documented: str = ""

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Torque before current, measured before plain names, few words before many."""
        return self.quantity != "current", self.is_measured, -len(self.words)


@dataclass(frozen=True)
class Group:
    """Columns that differ in their axis only.

    Attributes:
        places: in the recording, one an axis in their order.
        axes: how many the recording has of them, which may be more.
        by_letter: whether letters stand for axes, which may mean directions in space.
    """

    places: tuple[int, ...]
    axes: int
    by_letter: bool = False


def unit_of(text: str) -> str | None:
    """A unit as pint reads it, empty for one that needs a rated value, None for no unit."""
    plain = text.replace(" ", "").casefold()
    if plain in UNITS:
        return UNITS[plain]
    if any(c.isalpha() or c == "°" for c in text) and is_unit(text):
        return text.strip()
    return None


@cache
def kind_of(unit: str) -> str:
    """The quantity that a unit is of: 'position' of 'deg'; empty if none that drives have."""
    return next((kind for kind, si in _KINDS.items() if factor_among(unit, *si) is not None), "")


def read_name(name: str) -> Reading:
    """What the name of a column stands for, as far as its words say."""
    name = unicodedata.normalize("NFKC", name)
    plain, unit = _without_unit(name)
    words = tuple(_in_words(plain))
    kind, said = kind_of(unit) if unit else "", {*words}
    measured, commanded = MEASURED & said, COMMANDED & said
    if measured - {"fb"}:  # a set of actual values
        commanded -= {"set"}
    usable = not (commanded or OTHERS & said)
    if signal := _SIGNAL.search(name.casefold()):
        quantity, usual = SIGNALS[signal[1]]
        if quantity == "commanded":
            return Reading("", None, is_measured=False, is_usable=False, words=words)
        unit = unit if kind == quantity else usual
        return Reading(quantity, unit, bool(measured), usable, words, signal[1])
    quantity, is_now = _quantity(words)
    if kind and kind != quantity and (quantity != "torque" or kind == "current"):
        bracketed = plain != name and name.rstrip()[-1:] in "])"
        quantity, unit = (kind, unit) if bracketed or not quantity else (quantity, None)
    return Reading(quantity, unit, bool(measured) or is_now, usable, words)


def groups_of(names: Sequence[str], drives: int) -> Iterator[Group]:
    """Columns whose names differ in the axis only, as many as there are drives; the axes begin
    with 0 or 1, or are letters in their order."""
    numbered, lettered = dict[str, dict[int, int]](), dict[str, dict[int, int]]()
    for place, name in enumerate(names):
        for match in _NUMBER.finditer(name):
            stem = f"{name[: match.start()]}#{name[match.end() :]}"
            numbered.setdefault(stem, {})[int(match[0])] = place
        for number in {*_NUMBER.findall(name)}:
            if len(re.findall(rf"(?<!\d){number}(?!\d)", name)) > 1:  # axis1.q1
                stem = re.sub(rf"(?<!\d){number}(?!\d)", "#", name)
                numbered.setdefault(stem, {})[int(number)] = place
        for match in _LETTER.finditer(name):
            family = "ABC" if match[0] in "ABC" else "XYZ"
            stem = f"{name[: match.start()]}{family}{name[match.end() :]}"
            lettered.setdefault(stem, {})[family.index(match[0])] = place
    grouped = set[int]()
    for stems, by_letter in ((numbered, False), (lettered, True)):
        for axes in stems.values():
            grouped |= {*axes.values()} if len(axes) > 1 else set()
            first = min(axes)
            run = range(first, first + drives)
            if first <= 1 and all(axis in axes for axis in run) and (drives > 1 or len(axes) > 1):
                yield Group(tuple(axes[axis] for axis in run), len(axes), by_letter)
    if drives == 1:
        yield from (Group((place,), 1) for place in range(len(names)) if place not in grouped)


def _without_unit(name: str) -> tuple[str, str | None]:
    """A name without the unit that it states, and the unit."""
    for match in reversed([*_BRACKETS.finditer(name)]):
        if not match[1].isdecimal() and (unit := unit_of(match[1])) is not None:
            return f"{name[: match.start()]} {name[match.end() :]}", unit
    # A unit may stand before the axis too, if it is no letter, which might be the axis.
    for text, shortest in ((name, 1), (re.sub(r"[_ ]?\d+$", "", name), 2)):
        parts = re.split(r"[_\s]+", text.strip())
        for count in (2, 1):
            last = "_".join(parts[-count:])
            if len(parts) > count and len(last) >= shortest and last.casefold() in UNITS:
                return text[: text.rindex(parts[-count])], UNITS[last.casefold()]
    return name, UNITS.get(name.casefold()) if name.casefold() == "millis" else None


def _in_words(name: str) -> Iterator[str]:
    """'Axis1.ActPos' as axis, act, pos; compounds in their parts; Chinese and Japanese by the
    longest words that are known."""
    for run in _LATIN.findall(name):
        if not run[0].isascii() and not unicodedata.name(run[0], "").startswith("LATIN"):
            yield from _longest_known(run)
    folded = unicodedata.normalize("NFKD", name)
    ascii_only = "".join(
        c if c.isascii() else "" if unicodedata.combining(c) else " " for c in folded
    )
    for run in re.findall(r"[A-Za-z]+", ascii_only):
        parts = [run] if run.lower() in _KNOWN else _HUMPS.split(run)
        for word in (part.lower() for part in parts):
            yield from ([word] if word in _KNOWN else _parts(word) or [word])


def _longest_known(run: str) -> Iterator[str]:
    while run:
        size = next((n for n in range(len(run), 0, -1) if run[:n] in _KNOWN), 1)
        yield run[:size]
        run = run[size:]


@cache
def _parts(word: str) -> tuple[str, ...]:
    """A compound as words that are known; nothing if it is none."""
    for size in range(len(word) - _PART, _PART - 1, -1):
        for link in _LINKS:
            rest = word[size + len(link) :]
            if word[:size] in _KNOWN and word[size:].startswith(link) and len(rest) >= _PART:
                tail = (rest,) if rest in _KNOWN else _parts(rest)
                if tail:
                    return (word[:size], *tail)
    return ()


def _quantity(words: Sequence[str]) -> tuple[str, bool]:
    """What words stand for, and whether 'current' among them means that it is now."""
    found = {quantity: [w for w in words if w in known] for quantity, known in QUANTITIES.items()}
    present = [quantity for quantity, matching in found.items() if matching]
    others = [quantity for quantity in present if quantity not in ("current", "time")]
    if found["current"] and others:
        first = min(words.index(word) for quantity in others for word in found[quantity])
        is_now = {*found["current"]} <= {"current"} and words.index("current") < first
        if not is_now:
            return "current", False
        present.remove("current")
        return present[0], True
    if present[:1] == ["position"]:
        return next((DERIVATIVES[word] for word in words if word in DERIVATIVES), "position"), False
    return (present[0] if present else ""), False


def time_unit(start: Signal | None) -> str | None:
    """The only unit that fits a column as a time; empty if several do, None if it is no time."""
    if start is None or len(start) < 2:
        return ""
    steps = np.diff(start)
    if not np.isfinite(start).all() or start[-1] <= start[0] or np.mean(steps < 0) > _BACKWARDS:
        return None
    usual = float(np.median(steps[steps > 0]))
    return next((unit for unit, low, high in _STEPS if low <= usual <= high), "")


def derivative_factor(
    time: Signal, positions: Sequence[Signal | None], velocities: Sequence[Signal | None]
) -> float | None:
    """How many times larger the derivative of positions is than what may be velocities; None where
    these are no derivatives, or nothing moves."""
    factors = list[float]()
    for position, velocity in zip(positions, velocities, strict=True):
        if position is None or velocity is None or len(time) <= 4 * _HALF:
            return None
        width = 2 * _HALF
        with np.errstate(all="ignore"):
            slope = (position[width:] - position[:-width]) / (time[width:] - time[:-width])
        mean = np.convolve(velocity, np.full(width + 1, 1 / (width + 1)), "valid")
        finite = np.isfinite(slope) & np.isfinite(mean)
        slope, mean = slope[finite], mean[finite]
        size = math.sqrt(float(slope @ slope) * float(mean @ mean))
        if size == 0 or abs(float(slope @ mean)) < _SAME * size:
            return None
        factors.append(abs(float(slope @ mean)) / float(mean @ mean))
    middle = float(np.median(factors)) if factors else 0.0
    near = bool(factors) and all(abs(factor / middle - 1) < _APART for factor in factors)
    return middle if near else None


def fitting_units(
    factor: float, units: tuple[str, str, str], unknown: str, *, slides: bool = False
) -> list[str]:
    """Units of the unknown quantity with which velocities are the derivatives of positions.

    Args:
        factor: of `derivative_factor`.
        units: of position, velocity and time.
        unknown: which of these is unknown; empty to ask whether all three fit, for which the answer
            is the unit of time or nothing.
        slides: whether the drives do.
    """
    place = ("position", "velocity", "time").index(unknown) if unknown else 2
    tried = _UNITS[unknown, slides and unknown != "time"] if unknown else (units[2],)
    fitting = list[str]()
    for unit in tried:
        position, velocity, time = (*units[:place], unit, *units[place + 1 :])
        q, v = factor_among(position, "rad", "m"), factor_among(velocity, "rad/s", "m/s")
        t = factor_among(time, "s")
        if q and v and t and abs(factor * q / (v * t) - 1) < _APART:
            fitting.append(unit)
    return fitting
