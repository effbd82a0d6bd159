"""What may be wrong with a sensor's columns: maps that would put them right, best first."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations, permutations, product
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.check.sensing.misfit import Map, Misfit
from deltaid.check.sensing.sheet import Sensed

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


@dataclass(frozen=True, eq=False)
class Guess:
    """One map of what is shown.

    Attributes:
        kind: what it puts right.
        T: T y is what it should show.
        Q: misfit with it.
        gains: of each channel, sign included.
        order: of the columns, so that channel k is column order[k].
        turn: axes that the sensor has, in those that it is described with.
        offset: of its origin along its axes [m].
        other: the sensor whose column it is.
    """

    kind: Kind
    T: Map
    Q: float
    gains: Float[np.ndarray, " channels"]
    order: tuple[int, ...] = ()
    turn: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    offset: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    other: str = ""

    @property
    def angle(self) -> float:
        """By which axes are turned [rad]."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.turn) - 1), -1.0, 1.0)))


def best_guess(misfit: Misfit, others: tuple[Sensed, ...]) -> Guess:
    """The guess that leaves least, freedom allowed for."""
    return min(_guesses(misfit, others), key=lambda one: one.Q * _FREEDOM[one.kind])


def _guesses(misfit: Misfit, others: tuple[Sensed, ...]) -> Iterator[Guess]:
    count = len(misfit.noise)
    yield _scaled(misfit)
    for other in others:
        exchanged = Misfit(misfit.sheet, misfit.sensor, other.channels)
        Q = exchanged.of(np.eye(1)).Q
        yield Guess("exchanged", np.eye(1), Q, np.ones(1), other=other.name)
    if count == 6:
        yield from _signs(misfit)
        yield from _orders(misfit)
        yield from _turns(misfit)
        yield _rotated(misfit)
        yield _moved(misfit)


def _judged(misfit: Misfit, kind: Kind, T: Map, **known: object) -> Guess:
    gains = known.pop("gains", np.ones(len(T)))
    return Guess(kind, T, misfit.of(T).Q, gains, **known)  # pyright: ignore[reportArgumentType]


def _scaled(misfit: Misfit) -> Guess:
    """A factor of all forces, and one of all moments."""
    gains = np.ones(len(misfit.noise))
    for group in misfit.groups:
        gains[group] = _gain(misfit, group)
    kind = "sign" if np.allclose(np.abs(gains), 1.0) else "unit"
    return _judged(misfit, kind, np.diag(gains), gains=gains)


def _gain(misfit: Misfit, group: list[int]) -> float:
    """The factor of some channels; exactly ±1 where it is near."""

    def left(power: float, sign: float) -> float:
        return misfit.of(sign * 10.0**power * np.eye(len(misfit.noise)), group).Q

    _, power, sign = min((left(x, s), x, s) for x in _POWERS for s in (1.0, -1.0))
    low, high = power - 0.2, power + 0.2
    for _ in range(_NARROWER):  # golden section
        a, b = high - 0.618 * (high - low), low + 0.618 * (high - low)
        low, high = (low, b) if left(a, sign) < left(b, sign) else (a, high)
    gain = sign * 10.0 ** (0.5 * (low + high))
    return sign if abs(abs(gain) - 1) < _NEAR_ONE else float(gain)


def _signs(misfit: Misfit) -> Iterator[Guess]:
    """Every choice of signs but those that a turned sensor has."""
    for signs in product((1.0, -1.0), repeat=6):
        turned = signs[:3] == signs[3:] and np.prod(signs[:3]) > 0
        if not turned:
            gains = np.array(signs)
            yield _judged(misfit, "sign", np.diag(gains), gains=gains)


def _orders(misfit: Misfit) -> Iterator[Guess]:
    """Moments first, by turns, axes in another order, two columns exchanged."""
    own = (0, 1, 2, 3, 4, 5)
    orders = {(3, 4, 5, 0, 1, 2), (0, 2, 4, 1, 3, 5), (5, 4, 3, 2, 1, 0)}
    orders |= {(*axes, *(3 + k for k in axes)) for axes in permutations(range(3))} - {own}
    for a, b in combinations(own, 2):
        swapped = list(own)
        swapped[a], swapped[b] = b, a
        orders.add(tuple(swapped))
    for order in sorted(orders):
        yield _judged(misfit, "order", np.eye(6)[list(order)], order=order)


def _turns(misfit: Misfit) -> Iterator[Guess]:
    """Axes turned by quarters of a turn."""
    for axes in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.diag(signs) @ np.eye(3)[list(axes)]
            if np.linalg.det(R) > 0 and not np.allclose(R, np.eye(3)):
                yield _judged(misfit, "turned", _both(R), turn=R)


def _rotated(misfit: Misfit) -> Guess:
    """Axes turned by any angle: the rotation nearest to what torques expect, and fitted again."""
    G, g = misfit.sheet.of_torques
    theta, R = np.linalg.solve(G, g), np.eye(3)
    y = misfit.moving
    for _ in range(_TURNS):
        expected = misfit.expected(theta)
        expected = expected - expected.mean(axis=1, keepdims=True)
        sizes = [max(float(np.sum(y[part] ** 2)), 1e-300) for part in (slice(3), slice(3, 6))]
        cross = sum(
            expected[part] @ y[part].T / size
            for part, size in zip((slice(3), slice(3, 6)), sizes, strict=True)
        )
        U, _, Vt = np.linalg.svd(cross)
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        theta = misfit.of(_both(R)).theta
    return _judged(misfit, "rotated", _both(R), turn=R)


def _moved(misfit: Misfit) -> Guess:
    """Moments about another point: M = M' − r × F with r to be found."""
    force = misfit.y[:3]
    beside = np.zeros((6, 3, force.shape[1]))
    for j, e in enumerate(np.eye(3)):
        beside[3:, j] = -np.cross(e, force.T).T
    found = misfit.of(np.eye(6), beside=beside, spread=_FAR)
    return Guess("origin", np.eye(6), found.Q, np.ones(6), offset=found.added)


def _both(R: Float[np.ndarray, "3 3"]) -> Map:
    """The map of forces and moments that turns both."""
    return np.kron(np.eye(2), R)
