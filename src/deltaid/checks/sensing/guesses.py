"""Possible errors of a sensor's columns: maps that would correct them, and their verdicts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from deltaid.checks.priors import size_of
from deltaid.checks.sensing.misfit import Map, Misfit
from deltaid.checks.wiring.residual import UNIT
from deltaid.levels import FEW_ROUNDS
from deltaid.model.verdict import Grade, Proposal, Verdict, listed, percent
from deltaid.robot.sensors import BaseWrench
from deltaid.sensors.weighings import roll_pitch_yaw, rotation

Kind = Literal["unit", "sign", "order", "exchanged", "turned", "rotated", "origin"]

# Scales tried, as powers of ten; largest deviation of a scale from a unit, or from 1.
_POWERS, _NEAR = np.linspace(-4.5, 4.5, 46), 0.2
# Factor by which a guess with more freedom must leave less.
_FREEDOM: dict[Kind, float] = {
    "sign": 1.0, "unit": 1.1, "turned": 1.1, "order": 1.2, "exchanged": 1.2, "rotated": 1.6,
    "origin": 1.6,
}  # fmt: skip
_FORCE, _MOMENT = slice(3), slice(3, 6)
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
# Turn of axes [rad] and shift of the origin [m] below which a frame is doubtful instead of wrong.
_SLIGHTLY, _NEARBY = 0.09, 0.02
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Guess:
    """One map T of the measured values y: T y agrees with the robot, with the misfit Q."""

    kind: Kind
    T: Map
    Q: float
    # of the origin along the sensor's axes [m]
    offset: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    other: str = ""  # the sensor whose column it is

    @property
    def gains(self) -> Float[np.ndarray, " channels"]:
        return np.diag(self.T)

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """The sensor's axes in those described."""
        return self.T[_FORCE, _FORCE]

    @property
    def angle(self) -> float:
        """Rotation angle of the axes [rad]."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.turn) - 1), -1.0, 1.0)))


def best_guess(misfit: Misfit, others: Sequence[Misfit]) -> Guess:
    """The guess of least misfit, penalized by its freedom."""
    guesses = [Guess(kind, T, misfit.judge(T).Q) for kind, T in _maps(misfit)]
    for other in others:
        Q = replace(misfit, y=other.y, samples=other.samples, raw=other.raw).judge(np.eye(1)).Q
        guesses.append(Guess("exchanged", np.eye(1), Q, other=other.name))
    if len(misfit.noise) == 6:  # moments about another point: M = M' − r × F with an unknown r
        by_place = np.stack([np.cross(misfit.y[_FORCE].T, e).T for e in np.eye(3)], axis=1)
        columns = np.concatenate([np.zeros_like(by_place), by_place])
        size = size_of(misfit.rows.dynamics.robot)  # prior deviation of r
        shifted = misfit.with_columns(columns, size).judge(np.eye(6))
        guesses.append(Guess("origin", np.eye(6), shifted.Q, shifted.theta[-3:]))
    return min(guesses, key=lambda guess: guess.Q * _FREEDOM[guess.kind])


def _maps(misfit: Misfit) -> Iterator[tuple[Kind, Map]]:
    """A factor of all forces and one of all moments; for a wrench signs, orders and rotations."""
    gains = np.ones(len(misfit.noise))
    for group in misfit.groups:
        gains[group] = _gain(misfit, group)
    yield "sign" if np.allclose(np.abs(gains), 1.0) else "unit", np.diag(gains)
    if len(gains) != 6:
        return
    for signs in product((1.0, -1.0), repeat=6):
        if signs[_FORCE] != signs[_MOMENT] or np.prod(signs[_FORCE]) < 0:  # else a rotation
            yield "sign", np.diag(signs)
    for order in _orders():
        yield "order", np.eye(6)[list(order)]
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.diag(signs) @ np.eye(3)[list(axes)]  # by quarters of a turn
        if np.linalg.det(R) > 0 and not np.allclose(R, np.eye(3)):
            yield "turned", np.kron(np.eye(2), R)
    yield "rotated", np.kron(np.eye(2), _rotation(misfit))


def _gain(misfit: Misfit, group: list[int]) -> float:
    """The factor of some channels, rounded to ±1 if it is near."""

    def misfit_of(power: float, sign: float) -> float:
        return misfit.judge(sign * 10.0**power * np.eye(len(misfit.noise)), group).Q

    _, power, sign = min((misfit_of(power, s), power, s) for power in _POWERS for s in (1.0, -1.0))
    near = minimize_scalar(misfit_of, (power - _NEAR, power + _NEAR), args=(sign,))
    gain = sign * 10.0**near.x
    return sign if abs(abs(gain) - 1) < _NEAR else float(gain)


def _orders() -> list[tuple[int, ...]]:
    """Moments first, forces and moments in turn, axes in another order, two columns exchanged."""
    as_listed = (0, 1, 2, 3, 4, 5)
    orders = {(3, 4, 5, 0, 1, 2), (0, 2, 4, 1, 3, 5), (5, 4, 3, 2, 1, 0)}
    orders |= {(*axes, *(3 + k for k in axes)) for axes in permutations(range(3))} - {as_listed}
    exchanged = ({a: b, b: a} for a, b in combinations(as_listed, 2))
    return sorted(orders | {tuple(pair.get(k, k) for k in as_listed) for pair in exchanged})


def _rotation(misfit: Misfit) -> Float[np.ndarray, "3 3"]:
    """Any rotation of the axes: alternately the best rotation and the best parameters."""
    theta, R, y = misfit.by_torques, np.eye(3), misfit.moving
    for _ in range(FEW_ROUNDS):
        expected = misfit.expected(theta)
        expected = expected - expected.mean(axis=1, keepdims=True)
        cross = sum(
            expected[part] @ y[part].T / max(float(np.sum(y[part] ** 2)), 1e-300)
            for part in (_FORCE, _MOMENT)
        )
        U, _, Vt = np.linalg.svd(cross)
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        theta = misfit.judge(np.kron(np.eye(2), R)).theta
    return R


def verdict_of(guess: Guess, misfit: Misfit, share: float) -> Verdict:
    """The verdict of a guess about a sensor.

    Args:
        share: of the sensor's motion that is unexplained without the guess.
    """
    off = f"torques leave {percent(share)} of what {misfit.name} shows of the motion unexplained"
    if guess.kind in ("unit", "sign"):
        return _of_gains(guess, misfit, off)
    return (_of_order if guess.kind in ("order", "exchanged") else _of_frame)(guess, misfit, off)


def _of_gains(guess: Guess, misfit: Misfit, off: str) -> Verdict:
    """Units or signs; a factor near one may be an error of the drives' torques."""
    gains, channels, measured = guess.gains, misfit.columns.channels, misfit.rows.channels
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
        if 1 / UNIT < abs(largest) < UNIT and not turned.any():
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
    proposals = mapped(misfit, changes) if grade is Grade.WRONG else ()
    return Verdict(key, grade, seen, misfit.name, cause, cure, proposals, number=largest)


def _unit(factor: float, target: str) -> str:
    target = "N" if target == "N" else "N*m"
    name = min(_UNITS[target], key=lambda unit: abs(np.log(_UNITS[target][unit] / factor)))
    return name if abs(_UNITS[target][name] / factor - 1) < _NEAR else f"{factor:.3g} {target}"


def _of_order(guess: Guess, misfit: Misfit, off: str) -> Verdict:
    if guess.kind == "exchanged":
        seen, proposals = f"the column of {guess.other} shows what it should", ()
        cause = f"columns of {misfit.name} and {guess.other} that are exchanged"
        cure = "exchange them in the mapping, or where each is in the description"
    else:
        order = np.argmax(guess.T, axis=1).tolist()
        columns = [misfit.columns.channels[k].column for k in order]
        names = [channel.name for channel in misfit.rows.channels]
        moved = [f"{columns[k]} is {names[k]}" for k, source in enumerate(order) if source != k]
        seen = f"with its columns in another order it agrees: {listed(moved)}"
        cause = "columns that are listed in another order than Fx, Fy, Fz, Mx, My, Mz"
        cure, proposals = "list them in this order", mapped(misfit, [], columns)
    seen = f"{off}; {seen}"
    return Verdict("sensor-order", Grade.WRONG, seen, misfit.name, cause, cure, proposals)


def _of_frame(guess: Guess, misfit: Misfit, off: str) -> Verdict:
    name, sensor = misfit.name, misfit.rows.sensor
    assert isinstance(sensor, BaseWrench)
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
    misfit: Misfit,
    changes: Sequence[tuple[str, object]],
    columns: Sequence[str] | None = None,
) -> tuple[Proposal, ...]:
    """Changes of a sensor's entry of the mapping, complete even where the mapping has none.

    Args:
        columns: in place of the present ones.
    """
    columns = columns or [channel.column for channel in misfit.columns.channels]
    entry: list[tuple[str, object]] = [("column", None), ("columns", [*columns])]
    if len(columns) == 1:
        entry = [("columns", None), ("column", columns[0])]
    entry = [(f"sensors.{misfit.name}.{key}", new) for key, new in (*entry, *changes)]
    return (Proposal("mapping", tuple(entry)),)
