"""Verdicts from guesses about sensors, with the lines that correct them."""

from collections.abc import Sequence

import numpy as np

from deltaid.check.sensing.guesses import Guess
from deltaid.check.sensing.sheet import Signal
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed, percent
from deltaid.robot.sensors import BaseWrench, Sensor
from deltaid.sensors.weighings import rotation

# Units of forces and moments that a factor may be read as, and how near it must be.
_UNITS = {
    "N": {
        "N": 1.0, "kN": 1e3, "mN": 1e-3, "kgf": 9.80665, "gf": 0.00980665, "lbf": 4.4482216152605,
        "ozf": 0.278013851, "daN": 10.0, "cN": 0.01,
    },
    "N*m": {
        "N*m": 1.0, "kN*m": 1e3, "mN*m": 1e-3, "N*cm": 0.01, "dN*m": 0.1, "kgf*m": 9.80665,
        "kgf*cm": 0.0980665, "lbf*ft": 1.3558179, "lbf*in": 0.1129848, "ozf*in": 0.007061552,
        "daN*m": 10.0,
    },
}  # fmt: skip
_ALIKE = 0.15
# Factors nearer to one than this may as well be those of the drives' torques.
_GAIN = 3.0
# Axes turned by less [rad], and an origin that is nearer [m], are doubtful and not wrong.
_SLIGHTLY, _NEARBY = 0.09, 0.02
_AXES = "xyz"


def verdict_of(guess: Guess, signal: Signal, sensor: Sensor, share: float) -> Verdict:
    """The verdict of a guess about a sensor.

    Args:
        sensor: as described.
        share: of the sensor's motion that is unexplained without the guess.
    """
    off = f"torques leave {percent(share)} of what {signal.name} shows of the motion unexplained"
    if guess.kind in ("unit", "sign"):
        return _of_gains(guess, signal, off)
    if guess.kind in ("order", "exchanged"):
        return _of_order(guess, signal, off)
    assert isinstance(sensor, BaseWrench)
    return _of_frame(guess, signal.name, sensor, off)


def _of_gains(guess: Guess, signal: Signal, off: str) -> Verdict:
    """Units or signs; a factor that is no unit's may be the torques'."""
    gains, channels = guess.gains, signal.columns.channels
    scaled, turned = ~np.isclose(np.abs(gains), 1.0), gains < 0
    largest = float(gains[int(np.argmax(np.abs(np.log(np.abs(gains)))))])
    findings, changes = list[str](), list[tuple[str, object]]()
    cause, cure = "a sensor or a column that counts the other way", "declare it in the mapping"
    names = np.array([read.name for read in signal.rows.channels])
    key, grade, proposals = "sensor-sign", Grade.WRONG, True
    if scaled.any():
        factors = dict.fromkeys(f"{abs(gain):.3g}" for gain in gains[scaled])
        where = "" if scaled.all() else f" in {listed(names[scaled].tolist())}"
        findings.append(f"its numbers are to be multiplied by {listed(list(factors))}{where}")
        measured = zip(channels, gains, signal.rows.channels, strict=True)
        units = [_unit(abs(read.scale * gain), channel.unit) for read, gain, channel in measured]
        columns_in = dict.fromkeys(np.array(units)[scaled].tolist())
        key, cause = "sensor-unit", f"columns in {listed(list(columns_in))}"
        changes.append(("unit", _short(units)))
        if 1 / _GAIN < abs(largest) < _GAIN and not turned.any():
            key, grade, proposals = "sensor-gain", Grade.DOUBTFUL, False
            cause = "torque constants or gears of the drives that are off, or the sensor's own "
            cause += "factor"
            cure = "check the sensor with a known weight; the drives' gains follow from one whose "
            cure += "gain_tolerance is 2 % or less"
    if turned.any():
        reversed_ = "all" if turned.all() else listed(names[turned].tolist())
        findings.append(f"the sign of {reversed_} is the other one")
        now = np.sign([read.scale for read in channels])
        changes.append(("sign", _short(np.where(turned, -now, now).astype(int).tolist())))
    findings = f"{off}; {' and '.join(findings)}, and then it agrees"
    proposals = mapped(signal, changes) if proposals else ()
    return Verdict(key, grade, findings, signal.name, cause, cure, proposals, number=largest)


def _unit(factor: float, target: str) -> str:
    """The unit that a column has, by its factor."""
    target = "N" if target == "N" else "N*m"
    units = _UNITS[target]
    name = min(units, key=lambda unit: abs(np.log(units[unit] / factor)))
    return name if abs(units[name] / factor - 1) < _ALIKE else f"{factor:.3g} {target}"


def _of_order(guess: Guess, signal: Signal, off: str) -> Verdict:
    """Columns in another order, or that of another sensor."""
    if guess.kind == "exchanged":
        seen, proposals = f"the column of {guess.other} shows what it should", ()
        cause = f"columns of {signal.name} and {guess.other} that are exchanged"
        cure = "exchange them in the mapping, or where each is in the description"
    else:
        columns = [signal.columns.channels[k].column for k in guess.order]
        exchanged = (
            f"{columns[k]} is {channel.name}"
            for k, channel in enumerate(signal.rows.channels)
            if guess.order[k] != k
        )
        seen = f"with its columns in another order it agrees: {listed(list(exchanged))}"
        cause = "columns that are listed in another order than Fx, Fy, Fz, Mx, My, Mz"
        cure, proposals = "list them in this order", mapped(signal, [], columns)
    key, seen = "sensor-order", f"{off}; {seen}"
    return Verdict(key, Grade.WRONG, seen, signal.name, cause, cure, proposals)


def _of_frame(guess: Guess, name: str, sensor: BaseWrench, off: str) -> Verdict:
    """Axes or an origin that are not those described."""
    R = rotation(sensor.rotation_deg)
    if guess.kind == "origin":
        distance, unit, slightly = float(np.linalg.norm(guess.offset)), "m", _NEARBY
        number, origin = distance, np.array(sensor.position) + R @ guess.offset
        key, value = "position", [float(f"{coordinate:.4g}") for coordinate in np.round(origin, 4)]
        offset = ", ".join(f"{coordinate:.3g}" for coordinate in guess.offset)
        seen = f"with moments about a point ({offset}) m from its origin"
        cause = "an origin that is not the one moments are about, such as the plate's surface"
        cure = "give the point that moments are about, in the world"
    else:
        distance, unit, slightly = guess.angle, "°", _SLIGHTLY
        number, key, value = float(np.rad2deg(distance)), "rotation_deg", _angles(R @ guess.turn)
        seen = f"turned by {number:.3g}°"
        if guess.kind == "turned":
            rows = (
                f"{_AXES[k]} is {'-' if row.sum() < 0 else ''}{_AXES[int(np.argmax(np.abs(row)))]}"
                for k, row in enumerate(guess.turn)
            )
            seen = "turned by quarters of a turn: of the axes described, "
            seen += f"{listed(list(rows))} of those shown"
        cause = "axes of the sensor that are not those described"
        cure = "describe how it is mounted, or map its columns"
    return Verdict(
        "sensor-frame",
        Grade.DOUBTFUL if distance < slightly else Grade.WRONG,
        f"{off}; {seen}, it agrees",
        name,
        cause,
        cure,
        (Proposal("robot", ((f"sensors.{name}.{key}", value),)),),
        number,
        unit,
    )


def mapped(
    signal: Signal, changes: Sequence[tuple[str, object]], columns: Sequence[str] | None = None
) -> tuple[Proposal, ...]:
    """Changes of an entry of the mapping, which has its columns whether it has been there or not.

    Args:
        columns: in the place of those that are read.
    """
    where = f"sensors.{signal.name}"
    columns = columns or [channel.column for channel in signal.columns.channels]
    entry: list[tuple[str, object]] = [("column", None), ("columns", [*columns])]
    if len(columns) == 1:
        entry = [("columns", None), ("column", columns[0])]
    return (Proposal("mapping", tuple((f"{where}.{key}", new) for key, new in (*entry, *changes))),)


def _short(values: Sequence[object]) -> object:
    """One value where all are the same."""
    return values[0] if len(set(values)) == 1 else list(values)


def _angles(R: np.ndarray) -> list[float]:
    """Roll, pitch and yaw of R = Rz(yaw) Ry(pitch) Rx(roll) [degrees]."""
    pitch = np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))
    if abs(R[2, 0]) > 1 - 1e-9:  # roll and yaw are one angle
        angles = np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0
    else:
        angles = np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])
    return [float(f"{angle:.4g}") + 0.0 for angle in np.round(np.rad2deg(angles), 2)]
