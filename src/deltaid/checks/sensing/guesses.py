"""Possible errors of a sensor's columns: maps that would correct them, best first."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.checks.sensing.misfit import Map, Misfit
from deltaid.checks.sensing.rows import SensorSignal

Kind = Literal["unit", "sign", "order", "exchanged", "turned", "rotated", "origin"]

# Scales that are tried, as powers of ten, and how near to one a scale has none.
_POWERS, _NEAR_ONE = np.linspace(-4.5, 4.5, 46), 0.2
# Rounds of turning and fitting by turns, and of narrowing a scale down.
_TURNS, _NARROWER = 6, 24
# A guess that has more freedom must leave so much less.
_FREEDOM: dict[Kind, float] = {
    "sign": 1.0, "unit": 1.1, "turned": 1.1, "order": 1.2, "exchanged": 1.2, "rotated": 1.6,
    "origin": 1.6,
}  # fmt: skip
# An origin is off by so much, a priori [m].
_FAR = 1.0
_FORCE, _MOMENT = slice(3), slice(3, 6)


@dataclass(frozen=True, eq=False)
class Guess:
    """One map T of what is shown: T y is what it should show, with the misfit Q."""

    kind: Kind
    T: Map
    Q: float
    # of its origin along its axes [m]
    offset: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    other: str = ""  # the sensor whose column it is

    @property
    def gains(self) -> Float[np.ndarray, " channels"]:
        """Of each channel, sign included."""
        return np.diag(self.T)

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Axes that the sensor has, in those that it is described with."""
        return self.T[_FORCE, _FORCE]

    @property
    def angle(self) -> float:
        """By which axes are turned [rad]."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.turn) - 1), -1.0, 1.0)))


def best_guess(misfit: Misfit, others: Sequence[SensorSignal]) -> Guess:
    """The guess of least misfit, penalized by its freedom."""
    guesses = [Guess(kind, T, misfit.judge(T).Q) for kind, T in _maps(misfit)]
    for signal in others:
        exchanged = Misfit(misfit.rows, misfit.signal, signal).judge(np.eye(1))
        guesses.append(Guess("exchanged", np.eye(1), exchanged.Q, other=signal.name))
    if len(misfit.noise) == 6:  # moments about another point: M = M' − r × F with r to be found
        by_place = np.stack([np.cross(misfit.shown.y[_FORCE].T, e).T for e in np.eye(3)], axis=1)
        beside = np.concatenate([np.zeros_like(by_place), by_place])
        shifted = replace(misfit, beside=beside, spread=_FAR).judge(np.eye(6))
        guesses.append(Guess("origin", np.eye(6), shifted.Q, shifted.theta[-3:]))
    return min(guesses, key=lambda guess: guess.Q * _FREEDOM[guess.kind])


def _maps(misfit: Misfit) -> Iterator[tuple[Kind, Map]]:
    """A factor of all forces and one of all moments; of a wrench signs, orders and turns."""
    gains = np.ones(len(misfit.noise))
    for group in misfit.groups:
        gains[group] = _gain(misfit, group)
    yield "sign" if np.allclose(np.abs(gains), 1.0) else "unit", np.diag(gains)
    if len(gains) != 6:
        return
    for signs in product((1.0, -1.0), repeat=6):
        if signs[_FORCE] != signs[_MOMENT] or np.prod(signs[_FORCE]) < 0:  # else it is turned
            yield "sign", np.diag(signs)
    for order in _orders():
        yield "order", np.eye(6)[list(order)]
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.diag(signs) @ np.eye(3)[list(axes)]  # by quarters of a turn
        if np.linalg.det(R) > 0 and not np.allclose(R, np.eye(3)):
            yield "turned", np.kron(np.eye(2), R)
    yield "rotated", np.kron(np.eye(2), _rotation(misfit))


def _gain(misfit: Misfit, group: list[int]) -> float:
    """The factor of some channels; exactly ±1 where it is near."""

    def misfit_of(power: float, sign: float) -> float:
        return misfit.judge(sign * 10.0**power * np.eye(len(misfit.noise)), group).Q

    _, power, sign = min((misfit_of(power, s), power, s) for power in _POWERS for s in (1.0, -1.0))
    low, high = power - 0.2, power + 0.2
    for _ in range(_NARROWER):  # golden section
        a, b = high - 0.618 * (high - low), low + 0.618 * (high - low)
        low, high = (low, b) if misfit_of(a, sign) < misfit_of(b, sign) else (a, high)
    gain = sign * 10.0 ** (0.5 * (low + high))
    return sign if abs(abs(gain) - 1) < _NEAR_ONE else float(gain)


def _orders() -> list[tuple[int, ...]]:
    """Moments first, by turns, axes in another order, two columns exchanged."""
    as_listed = (0, 1, 2, 3, 4, 5)
    orders = {(3, 4, 5, 0, 1, 2), (0, 2, 4, 1, 3, 5), (5, 4, 3, 2, 1, 0)}
    orders |= {(*axes, *(3 + k for k in axes)) for axes in permutations(range(3))} - {as_listed}
    exchanged = ({a: b, b: a} for a, b in combinations(as_listed, 2))
    return sorted(orders | {tuple(pair.get(k, k) for k in as_listed) for pair in exchanged})


def _rotation(misfit: Misfit) -> Float[np.ndarray, "3 3"]:
    """Any turn of the axes: the rotation nearest to what torques expect, and fitted again."""
    theta, R, y = misfit.by_torques, np.eye(3), misfit.moving
    for _ in range(_TURNS):
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
