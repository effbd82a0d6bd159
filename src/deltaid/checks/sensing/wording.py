"""Verdicts from guesses about sensors, with the lines that correct them."""

from collections.abc import Sequence

import numpy as np

from deltaid.checks.sensing.guesses import Guess
from deltaid.checks.sensing.rows import SensorSignal
from deltaid.model.verdict import Grade, Proposal, Verdict, listed, percent
from deltaid.robot.sensors import BaseWrench, Sensor
from deltaid.sensors.weighings import roll_pitch_yaw, rotation

# Units of forces and moments that a factor may be read as.
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
# A factor names a unit where it is nearer than torque constants and sensors err together.
_ALIKE = 0.15
# Factors nearer to one than this may as well be those of the drives' torques.
_GAIN = 3.0
# Axes turned by less [rad], and an origin that is nearer [m], are doubtful and not wrong.
_SLIGHTLY, _NEARBY = 0.09, 0.02
_AXES = "xyz"


def verdict_of(guess: Guess, signal: SensorSignal, sensor: Sensor, share: float) -> Verdict:
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


def _of_gains(guess: Guess, signal: SensorSignal, off: str) -> Verdict:
    """Units or signs; a factor that is no unit's may be the torques'."""
    gains, channels, measured = guess.gains, signal.columns.channels, signal.rows.channels
    scaled, turned = ~np.isclose(np.abs(gains), 1.0), gains < 0
    largest = float(gains[int(np.argmax(np.abs(np.log(np.abs(gains)))))])
    names = np.array([channel.name for channel in measured])
    findings, changes, grade = list[str](), list[tuple[str, object]](), Grade.WRONG
    key, cause = "sensor-sign", "a sensor or a column that counts the other way"
    cure = "declare it in the mapping"
    if scaled.any():
        factors = dict.fromkeys(f"{abs(gain):.3g}" for gain in gains[scaled])
        where = "" if scaled.all() else f" in {listed(names[scaled].tolist())}"
        findings.append(f"its numbers are to be multiplied by {listed(list(factors))}{where}")
        units = [
            _unit(abs(column.scale * gain), channel.unit)
            for column, gain, channel in zip(channels, gains, measured, strict=True)
        ]
        columns_in = dict.fromkeys(np.array(units)[scaled].tolist())
        key, cause = "sensor-unit", f"columns in {listed(list(columns_in))}"
        changes.append(("unit", units[0] if len(set(units)) == 1 else units))
        if 1 / _GAIN < abs(largest) < _GAIN and not turned.any():
            key, grade = "sensor-gain", Grade.DOUBTFUL
            cause = (
                "torque constants or gears of the drives that are off, or the sensor's own factor"
            )
            cure = (
                "check the sensor with a known weight; the drives' gains follow from one whose "
                "gain_tolerance is 2 % or less"
            )
    if turned.any():
        reversed_ = "all" if turned.all() else listed(names[turned].tolist())
        findings.append(f"the sign of {reversed_} is the other one")
        now = np.sign([column.scale for column in channels])
        signs = np.where(turned, -now, now).astype(int).tolist()
        changes.append(("sign", signs[0] if len(set(signs)) == 1 else signs))
    seen = f"{off}; {' and '.join(findings)}, and then it agrees"
    proposals = mapped(signal, changes) if grade is Grade.WRONG else ()
    return Verdict(key, grade, seen, signal.name, cause, cure, proposals, number=largest)


def _unit(factor: float, target: str) -> str:
    """The unit that a column has, by its factor."""
    target = "N" if target == "N" else "N*m"
    name = min(_UNITS[target], key=lambda unit: abs(np.log(_UNITS[target][unit] / factor)))
    return name if abs(_UNITS[target][name] / factor - 1) < _ALIKE else f"{factor:.3g} {target}"


def _of_order(guess: Guess, signal: SensorSignal, off: str) -> Verdict:
    """Columns in another order, or that of another sensor."""
    if guess.kind == "exchanged":
        seen, proposals = f"the column of {guess.other} shows what it should", ()
        cause = f"columns of {signal.name} and {guess.other} that are exchanged"
        cure = "exchange them in the mapping, or where each is in the description"
    else:
        order = np.argmax(guess.T, axis=1).tolist()
        columns = [signal.columns.channels[k].column for k in order]
        names = [channel.name for channel in signal.rows.channels]
        moved = [f"{columns[k]} is {names[k]}" for k, source in enumerate(order) if source != k]
        seen = f"with its columns in another order it agrees: {listed(moved)}"
        cause = "columns that are listed in another order than Fx, Fy, Fz, Mx, My, Mz"
        cure, proposals = "list them in this order", mapped(signal, [], columns)
    seen = f"{off}; {seen}"
    return Verdict("sensor-order", Grade.WRONG, seen, signal.name, cause, cure, proposals)


def _of_frame(guess: Guess, name: str, sensor: BaseWrench, off: str) -> Verdict:
    """Axes or an origin that are not those described."""
    R = rotation(sensor.rotation_deg)
    if guess.kind == "origin":
        number, unit = float(np.linalg.norm(guess.offset)), "m"
        origin, slight = np.array(sensor.position) + R @ guess.offset, number < _NEARBY
        key, value = "position", [float(f"{coordinate:.4g}") for coordinate in np.round(origin, 4)]
        offset = ", ".join(f"{coordinate:.3g}" for coordinate in guess.offset)
        seen = f"with moments about a point ({offset}) m from its origin"
        cause = "an origin that is not the one moments are about, such as the plate's surface"
        cure = "give the point that moments are about, in the world"
    else:
        number, unit, slight = float(np.rad2deg(guess.angle)), "°", guess.angle < _SLIGHTLY
        angles = np.round(np.rad2deg(roll_pitch_yaw(R @ guess.turn)), 2)
        key, value = "rotation_deg", [float(f"{angle:.4g}") + 0.0 for angle in angles]
        seen = f"turned by {number:.3g}°"
        if guess.kind == "turned":
            rows = [
                f"{axis} is {'-' if row.sum() < 0 else ''}{_AXES[int(np.argmax(np.abs(row)))]}"
                for axis, row in zip(_AXES, guess.turn, strict=True)
            ]
            seen = f"turned by quarters of a turn: of the axes described, {listed(rows)} of those "
            seen += "shown"
        cause = "axes of the sensor that are not those described"
        cure = "describe how it is mounted, or map its columns"
    grade, seen = Grade.DOUBTFUL if slight else Grade.WRONG, f"{off}; {seen}, it agrees"
    proposals = (Proposal("robot", ((f"sensors.{name}.{key}", value),)),)
    return Verdict("sensor-frame", grade, seen, name, cause, cure, proposals, number, unit)


def mapped(
    signal: SensorSignal,
    changes: Sequence[tuple[str, object]],
    columns: Sequence[str] | None = None,
) -> tuple[Proposal, ...]:
    """Changes of an entry of the mapping, which has its columns whether it has been there or not.

    Args:
        columns: in the place of those that are read.
    """
    columns = columns or [channel.column for channel in signal.columns.channels]
    entry: list[tuple[str, object]] = [("column", None), ("columns", [*columns])]
    if len(columns) == 1:
        entry = [("columns", None), ("column", columns[0])]
    entry = [(f"sensors.{signal.name}.{key}", new) for key, new in (*entry, *changes)]
    return (Proposal("mapping", tuple(entry)),)
