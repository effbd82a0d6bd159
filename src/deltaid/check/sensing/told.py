"""Guesses about sensors in words, with the lines that mend them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from deltaid.check.sensing.guesses import Guess
from deltaid.check.sensing.sheet import Sensed
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed, percent
from deltaid.robot.sensors import BaseWrench, Sensor
from deltaid.sensors.weighings import rotation

# Units of forces and moments that a factor may be read as, and how near it must be.
_FORCES = {
    "N": 1.0, "kN": 1e3, "mN": 1e-3, "kgf": 9.80665, "gf": 0.00980665, "lbf": 4.4482216152605,
    "ozf": 0.278013851, "daN": 10.0, "cN": 0.01,
}  # fmt: skip
_MOMENTS = {
    "N*m": 1.0, "kN*m": 1e3, "mN*m": 1e-3, "N*cm": 0.01, "dN*m": 0.1, "kgf*m": 9.80665,
    "kgf*cm": 0.0980665, "lbf*ft": 1.3558179, "lbf*in": 0.1129848, "ozf*in": 0.007061552,
    "daN*m": 10.0,
}  # fmt: skip
_ALIKE = 0.15
# Factors nearer to one than this may as well be those of the drives' torques.
_GAIN = 3.0
# Axes turned by less [rad], and an origin that is nearer [m], are doubtful and not wrong.
_SLIGHTLY, _NEARBY = 0.09, 0.02
_AXES = "xyz"


def told(guess: Guess, sensed: Sensed, sensor: Sensor, left: float) -> Verdict:
    """What a guess says of a sensor.

    Args:
        sensor: as described.
        left: share of its motion that torques leave unexplained without it.
    """
    off = f"torques leave {percent(left)} of what {sensed.name} shows of the motion unexplained"
    if guess.kind in ("unit", "sign"):
        return _of_gains(guess, sensed, off)
    if guess.kind == "order":
        return _of_order(guess, sensed, off)
    if guess.kind == "exchanged":
        return _exchanged(guess, sensed, off)
    assert isinstance(sensor, BaseWrench)
    if guess.kind == "origin":
        return _of_origin(guess, sensed, sensor, off)
    return _of_axes(guess, sensed, sensor, off)


def _of_gains(guess: Guess, sensed: Sensed, off: str) -> Verdict:
    scaled, turned = ~np.isclose(np.abs(guess.gains), 1.0), guess.gains < 0
    largest = float(guess.gains[int(np.argmax(np.abs(np.log(np.abs(guess.gains)))))])
    seen, changes = list[str](), list[tuple[str, object]]()
    cause, cure = "a sensor or a column that counts the other way", "declare it in the mapping"
    grade, key = Grade.WRONG, "sensor-sign"
    if scaled.any():
        units, key = _units(guess.gains, sensed), "sensor-unit"
        factors = dict.fromkeys(f"{abs(x):.3g}" for x in guess.gains[scaled])
        of = "" if scaled.all() else f" in {_named(sensed, scaled)}"
        seen.append(f"its numbers are to be multiplied by {listed(list(factors))}{of}")
        names = dict.fromkeys(u for u, is_so in zip(units, scaled, strict=True) if is_so)
        cause = f"columns in {listed(list(names))}"
        if 1 / _GAIN < abs(largest) < _GAIN and not turned.any():
            return _of_gain(sensed, f"{off}; {seen[0]}", largest)
        changes.append(("unit", _short(units)))
    if turned.any():
        which = "all" if turned.all() else _named(sensed, turned)
        seen.append(f"the sign of {which} is the other one")
        now = np.sign([channel.scale for channel in sensed.given.channels])
        changes.append(("sign", _short(np.where(turned, -now, now).astype(int).tolist())))
    return Verdict(
        key,
        grade,
        f"{off}; {' and '.join(seen)}, and then it agrees",
        subject=sensed.name,
        cause=cause,
        cure=cure,
        proposals=mapped(sensed, changes),
        number=largest,
    )


def _of_gain(sensed: Sensed, seen: str, gain: float) -> Verdict:
    """A factor that is no unit's: the torques may be what is off."""
    return Verdict(
        "sensor-gain",
        Grade.DOUBTFUL,
        f"{seen}, and then it agrees",
        subject=sensed.name,
        cause="torque constants or gears of the drives that are off, or the sensor's own factor",
        cure="check the sensor with a known weight; the drives' gains follow from one whose "
        "gain_tolerance is 2 % or less",
        number=gain,
    )


def _named(sensed: Sensed, which: Bool[np.ndarray, " channels"]) -> str:
    """The channels among those of a sensor."""
    names = [one.name for one in sensed.rows.channels]
    return listed([name for name, is_so in zip(names, which, strict=True) if is_so])


def _of_order(guess: Guess, sensed: Sensed, off: str) -> Verdict:
    channels = [sensed.given.channels[k] for k in guess.order]
    columns = [one.column for one in channels]
    moved = [
        f"{one.column} is {shown.name}"
        for k, (one, shown) in enumerate(zip(channels, sensed.rows.channels, strict=True))
        if guess.order[k] != k
    ]
    return Verdict(
        "sensor-order",
        Grade.WRONG,
        f"{off}; with its columns in another order it agrees: {listed(moved)}",
        subject=sensed.name,
        cause="columns that are listed in another order than Fx, Fy, Fz, Mx, My, Mz",
        cure="list them in this order",
        proposals=mapped(sensed, [], columns),
    )


def _exchanged(guess: Guess, sensed: Sensed, off: str) -> Verdict:
    return Verdict(
        "sensor-order",
        Grade.WRONG,
        f"{off}; the column of {guess.other} shows what it should",
        subject=sensed.name,
        cause=f"columns of {sensed.name} and {guess.other} that are exchanged",
        cure="exchange them in the mapping, or where each is in the description",
    )


def _of_axes(guess: Guess, sensed: Sensed, sensor: BaseWrench, off: str) -> Verdict:
    R = rotation(sensor.rotation_deg) @ guess.turn
    angles = _angles(R)
    if guess.kind == "turned":
        rows = (
            f"{_AXES[k]} is {'-' if row.sum() < 0 else ''}{_AXES[int(np.argmax(np.abs(row)))]}"
            for k, row in enumerate(guess.turn)
        )
        how = f"by quarters of a turn: of the axes described, {listed(list(rows))} of those shown"
    else:
        how = f"by {np.rad2deg(guess.angle):.3g}°"
    return Verdict(
        "sensor-frame",
        Grade.DOUBTFUL if guess.angle < _SLIGHTLY else Grade.WRONG,
        f"{off}; turned {how}, it agrees",
        subject=sensed.name,
        cause="axes of the sensor that are not those described",
        cure="describe how it is mounted, or map its columns",
        proposals=(Proposal("robot", ((f"sensors.{sensed.name}.rotation_deg", angles),)),),
        number=float(np.rad2deg(guess.angle)),
        unit="°",
    )


def _of_origin(guess: Guess, sensed: Sensed, sensor: BaseWrench, off: str) -> Verdict:
    moved = np.array(sensor.position) + rotation(sensor.rotation_deg) @ guess.offset
    place = [float(f"{x:.4g}") for x in np.round(moved, 4)]
    apart = ", ".join(f"{x:.3g}" for x in guess.offset)
    return Verdict(
        "sensor-frame",
        Grade.DOUBTFUL if np.linalg.norm(guess.offset) < _NEARBY else Grade.WRONG,
        f"{off}; with moments about a point ({apart}) m from its origin, it agrees",
        subject=sensed.name,
        cause="an origin that is not the one moments are about, such as the plate's surface",
        cure="give the point that moments are about, in the world",
        proposals=(Proposal("robot", ((f"sensors.{sensed.name}.position", place),)),),
        number=float(np.linalg.norm(guess.offset)),
        unit="m",
    )


def _units(gains: Float[np.ndarray, " channels"], sensed: Sensed) -> list[str]:
    """The unit that each column has, by its factor."""
    return [
        _unit(abs(channel.scale * gain), shown.unit)
        for channel, gain, shown in zip(
            sensed.given.channels, gains, sensed.rows.channels, strict=True
        )
    ]


def _unit(factor: float, target: str) -> str:
    known = _FORCES if target == "N" else _MOMENTS
    name = min(known, key=lambda one: abs(np.log(known[one] / factor)))
    if abs(known[name] / factor - 1) < _ALIKE:
        return name
    return f"{factor:.3g} {'N' if target == 'N' else 'N*m'}"


def mapped(
    sensed: Sensed,
    changes: Sequence[tuple[str, object]],
    columns: Sequence[str] | None = None,
) -> tuple[Proposal, ...]:
    """Changes of an entry of the mapping, which has its columns whether it has been there or not.

    Args:
        columns: in the place of those that are read.
    """
    where = f"sensors.{sensed.name}"
    columns = columns or [one.column for one in sensed.given.channels]
    entry: list[tuple[str, object]] = [(f"{where}.column", None), (f"{where}.columns", [*columns])]
    if len(columns) == 1:
        entry = [(f"{where}.columns", None), (f"{where}.column", columns[0])]
    entry += [(f"{where}.{key}", value) for key, value in changes]
    return (Proposal("mapping", tuple(entry)),)


def _short(values: Sequence[object]) -> object:
    """One value where all are the same."""
    return values[0] if len(set(values)) == 1 else list(values)


def _angles(R: Float[np.ndarray, "3 3"]) -> list[float]:
    """Roll, pitch and yaw of R = Rz(yaw) Ry(pitch) Rx(roll) [degrees]."""
    pitch = np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))
    if abs(R[2, 0]) > 1 - 1e-9:  # roll and yaw are one angle
        angles = np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0
    else:
        angles = np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])
    return [float(f"{x:.4g}") + 0.0 for x in np.round(np.rad2deg(angles), 2)]
