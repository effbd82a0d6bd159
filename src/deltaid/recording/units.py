"""Units of columns, their factors to SI, and units that follow from the numbers.

The registry has only the units below, and angle is a dimension, so counts, per cent or 1/min are
refused as angles. Before pint parses a text, a narrow grammar must match: an optional number, then
names with small powers. So no file can make pint compute more than a product.

The first numbers of a column show whether it is a time, and in which unit. If velocities are the
derivatives of positions, a missing unit follows from the others.
"""

import math
import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError

_DEFINITIONS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
deci- = 1e-1 = d-
deca- = 10 = da-
kilo- = 1e3 = k-
radian = [angle] = rad
degree = 0.017453292519943295 * radian = deg = °
arcminute = degree / 60 = arcmin
arcsecond = arcminute / 60 = arcsec
turn = 6.283185307179586 * radian = rev = revolution
second = [time] = s
minute = 60 * second = min
rpm = turn / minute
meter = [length] = m = metre
inch = 0.0254 * meter = in
foot = 12 * inch = ft
newton = [force] = N
gram_force = 0.00980665 * newton = gf
kilogram_force = 9.80665 * newton = kgf = kp
pound_force = 4.4482216152605 * newton = lbf
ounce_force = pound_force / 16 = ozf
newton_meter = newton * meter = Nm
newton_centimeter = 0.01 * newton_meter = Ncm
newton_millimeter = 0.001 * newton_meter = Nmm
kilogram_force_meter = kilogram_force * meter = kgfm = kpm
kilogram_force_centimeter = 0.01 * kilogram_force_meter = kgfcm
pound_force_foot = pound_force * foot = ftlbf = lbfft = ftlb = lbft = ft_lb = lb_ft = ft_lbf
pound_force_inch = pound_force * inch = inlbf = lbfin = inlb = lbin = in_lb = lb_in = in_lbf
ounce_force_inch = ounce_force * inch = ozin = inoz = oz_in = in_oz
ampere = [current] = A
"""
# Units of mass that are often given for forces, and the units of force that are meant.
_MASSES = {"kg": "kgf", "g": "gf", "lb": "lbf", "lbs": "lbf", "oz": "ozf"}
# SI units of quantities: for turning drives, then for sliding ones.
SI_UNITS = {
    "time": ("s",),
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "torque": ("N m", "N"),
    "current": ("A",),
}
_NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d{1,2})?"
_POWER = r"(?:(?:\^|\*\*)-?[1-3]|[²³])?"
_NAME = rf"[A-Za-zµμ°_]{{1,24}}{_POWER}"
_GRAMMAR = re.compile(
    rf"(?:(?P<number>{_NUMBER})(?:/(?P<divisor>{_NUMBER}))?[ ]?[*·]?[ ]?)?"
    rf"(?P<unit>{_NAME}(?:[ ]?[*·./ ][ ]?{_NAME}){{0,4}})"
)
Signal = Float[np.ndarray, " rows"]
# Largest share of a time's stamps that go back, or are far off their neighbours.
MOST_WRONG = 0.2
# Units with the steps that fit no other unit at rates of 10 Hz to 20 kHz. In ms the first would be
# above 100 kHz. In s the second would be below 10 Hz, and counts of cycles would be whole. In ticks
# of 100 ns the third would be below 10 Hz.
_STEPS = (("s", 5e-5, 0.0100001), ("ms", 0.11, 0.9), ("ns", 1.1e6, 1e8))
# Rows on either side that derivatives and interpolation span: a motion is smooth over them.
SIDE = 4
# Least correlation of velocities with derivatives of positions, and largest relative difference of
# their ratios between drives, or from the ratio of the units.
_SAME, _APART = 0.98, 0.03
_UNITS = {
    ("time", False): ("s", "ms", "us", "ns"),
    ("position", False): ("rad", "deg", "rev"),
    ("velocity", False): ("rad/s", "deg/s", "rpm", "rev/s"),
    ("position", True): ("m", "mm"),
    ("velocity", True): ("m/s", "mm/s"),
}


def si_factor(
    unit: str,
    target: str,
    *,
    where: str,
    torque_constant: float | None = None,
    cure: str = "",
) -> float:
    """Factor from values in `unit` to values in `target`.

    Args:
        unit: a unit such as 'deg', 'rpm', 'mN*m', '0.0235 N*m' or '360/65536 deg'.
        target: an SI unit.
        torque_constant: torque constant [N m/A], for a current in place of a torque.
        where: file and key, for messages.
        cure: fix of a wrong unit; by default that for drives.

    Raises:
        RecordingError: the unit is unknown, or of another quantity.
    """
    if unit == target and torque_constant is None:
        return 1.0
    import pint

    if (parsed := _parsed(unit)) is None:
        if unit.strip() in _MASSES and target in SI_UNITS["torque"]:
            raise RecordingError(
                f"unit '{unit.strip()}' is one of mass, not of force",
                where=where,
                cure=f"what a scale shows as weight is a force: {_MASSES[unit.strip()]}",
            )
        raise RecordingError(
            f"unit '{unit[:40]}' is not known",
            where=where,
            cure="write it as in m, mm, s, ms, rad, deg, rev, rad/s, rpm, rad/s^2, N*m, mN*m, A; a "
            "number may stand before it, such as 0.0235 N*m for per mille of 23.5 N m",
        )
    number, quantity = parsed
    try:
        if torque_constant is not None:
            return number * float(quantity.m_as("A")) * torque_constant
        return number * float(quantity.m_as(target.replace(" ", "*")))
    except pint.DimensionalityError:
        what, likely = f"is not a unit of {target}", "revolutions are rev, and rev/min is rpm"
        if target in ("m", "m/s", "m/s^2", "N"):
            likely = (
                "columns of the motor that drives a rail also need its lead in m per revolution"
            )
        if torque_constant is not None:
            what = "is not a current"
            likely = "leave torque_constant out, or give the unit as A or mA"
        elif target == "N m":
            likely = "a current also needs its torque_constant in N m/A"
        raise RecordingError(f"unit '{unit}' {what}", where=where, cure=cure or likely) from None


def factor_among(unit: str, *targets: str) -> float | None:
    """Factor to the first of the SI units that a unit converts to; None if it converts to none."""
    for target in targets:
        try:
            return si_factor(unit, target, where="")
        except RecordingError:
            continue
    return None


def is_unit(unit: str) -> bool:
    return _parsed(unit) is not None


def _parsed(unit: str) -> tuple[float, Any] | None:
    """Number before a unit, and the unit as a quantity; None if the unit is unknown."""
    import pint

    match = _GRAMMAR.fullmatch(unit.strip())
    if match is None:
        return None
    divisor = float(match["divisor"] or 1)
    number = float(match["number"] or 1) / divisor if divisor else float("inf")
    try:
        return number, _registry().Quantity(1.0, re.sub(r"[·.]", "*", match["unit"]))
    except (pint.UndefinedUnitError, ValueError):  # ValueError for words that are numbers: nan
        return None


@cache
def _registry() -> Any:
    import pint

    registry = pint.UnitRegistry(None)  # pyright: ignore[reportArgumentType]
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


def time_unit(start: Signal | None) -> str | None:
    """The only unit of time that fits a column; empty if several fit; None if it is no time."""
    start = None if start is None else start[np.isfinite(start)]
    if start is None or len(start) < 2:
        return ""
    steps = np.diff(start)
    if start[-1] <= start[0] or np.mean(steps < 0) > MOST_WRONG:
        return None
    usual = float(np.median(steps[steps > 0]))
    return next((unit for unit, low, high in _STEPS if low <= usual <= high), "")


def derivative_factor(
    time: Signal, positions: Sequence[Signal | None], velocities: Sequence[Signal | None]
) -> float | None:
    """Ratio of the derivatives of positions to velocities; None if they do not correlate, or
    nothing moves."""
    factors = list[float]()
    for position, velocity in zip(positions, velocities, strict=True):
        if position is None or velocity is None or len(time) <= 4 * SIDE:
            return None
        width = 2 * SIDE
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
    """Units of a quantity for which velocities are the derivatives of positions.

    Args:
        factor: result of `derivative_factor`.
        units: units of position, velocity and time.
        unknown: the quantity with an unknown unit; empty to check all three units, which returns
            the unit of time if they fit.
        slides: whether the drives slide.
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
