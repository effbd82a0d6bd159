"""Search for the fixed point of a cable at the platform, beside other effects of a contest.

Directions along a cable change slowly compared with the filter, so they multiply the filtered
torques of constant forces.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from deltaid.dynamics.geometry import across
from deltaid.effects.at_platform import Cable, ConstantForce, of_cable
from deltaid.effects.point import Added, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.shrinkage import Shrunk
from deltaid.levels import FAINT

# Distances that are searched, in radii of the motion; a cable from farther away pulls as a force
# and a spring along it do.
_DISTANCES = (1.5, 3.0, 6.0, 12.0)
# Directions from which the search starts, for there are several maxima.
_STARTS = 3
# First step of the search, in radians and as a share of the inverse distance; share of the inverse
# distance to which the point is found; the fit corrects it.
_FIRST, _NEAR = 0.3, 0.01

Place = Float[np.ndarray, " 3"]


def largest_cable(points: Sequence[TracePoint], fit: Shrunk) -> Added | None:
    """The cable that explains most beside all groups of a fit; None if one that pushes explains
    more, for then it mimics another cause."""
    dynamics = points[0].dynamics
    task, home = dynamics.robot.task, dynamics.kinematics.home
    places = [task.point(point.motion.z) - task.point(home) for point in points]
    pull = ConstantForce(dynamics, (), (1.0,) * len(ConstantForce.symbols))
    explained = partial(_explained, fit, places, [point.added(pull) for point in points])
    x = np.concatenate(places)
    middle = 0.5 * (x.min(axis=0) + x.max(axis=0))
    radius = float(np.linalg.norm(x - middle, axis=1).max())
    ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    away = radius * ways[:, None] * np.array(_DISTANCES)[:, None]
    gains = explained(middle + away.reshape(-1, 3))[0].reshape(away.shape[:2])
    best = np.argsort(-gains.max(axis=1))[:_STARTS]
    ends = [
        _refined(explained, middle, radius, ways[i], 1.0 / _DISTANCES[np.argmax(gains[i])])
        for i in best
    ]
    place, _, (T, k) = max(ends, key=lambda end: end.gain)
    if not T > _NEAR * radius * k > 0:
        return None
    orders = (*place.tolist(), float(T), float(k))
    return Added(Cable.name, Cable(dynamics, (), (1.0,) * len(Cable.symbols), orders))


_Gains = tuple[Float[np.ndarray, " anchors"], Float[np.ndarray, "anchors 2"]]


def _explained(
    fit: Shrunk,
    places: Sequence[Float[np.ndarray, "samples 3"]],
    forces: Sequence[ColumnsOfDrives],
    anchors: Float[np.ndarray, "anchors 3"],
) -> _Gains:
    """Sum of squares that a cable from each point explains; its T and k.

    Args:
        fit: of all other effects.
        places: x in each recording.
        forces: torques of a force along each axis.
        anchors: the points.
    """
    sets = list[Float[np.ndarray, "samples anchors 2"]]()
    for x, columns in zip(places, forces, strict=True):
        u, longer = of_cable(anchors, x)
        pulled = np.einsum("dsi,asi->dsa", columns, u)
        sets += list(np.stack([pulled, pulled * longer[:, :, 0].T], axis=3))
    return fit.explained(range(len(sets)), sets, FAINT)


class _End(NamedTuple):
    place: Place
    gain: float  # sum of squares that a cable from there explains
    coefficients: Float[np.ndarray, " 2"]  # its T and k


def _refined(
    explained: Callable[[np.ndarray], _Gains],
    middle: Place,
    radius: float,
    way: Place,
    near: float,
) -> _End:
    """The point with the largest gain near one in a direction, at the inverse distance `near` in
    radii."""
    first, second = across(way)

    def end(a: float, b: float, inverse: float) -> _End:
        """At a point in the direction way + a e_1 + b e_2. One far away pulls as one that pushes
        from the opposite direction, so the search passes an inverse distance of 0."""
        turned = way + a * first + b * second
        distance = np.copysign(1.0 / max(abs(inverse), FAINT), inverse)
        place = middle + radius * distance * turned / np.linalg.norm(turned)
        gains, coefficients = explained(place[None])
        return _End(place, float(gains[0]), coefficients[0])

    def cost(v: Place) -> float:
        return -end(*v.tolist()).gain if abs(v[2]) < 1 else 0.0  # 0 inside the motion

    start = np.array([0.0, 0.0, near])
    simplex = start + _FIRST * np.vstack([np.zeros(3), np.diag([1.0, 1.0, near])])
    options = {"initial_simplex": simplex, "xatol": _NEAR * near, "fatol": np.inf}
    return end(*minimize(cost, start, method="Nelder-Mead", options=options).x.tolist())
