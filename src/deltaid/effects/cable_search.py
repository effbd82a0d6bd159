"""Search for the fixed point of a cable at the platform, beside other effects of a contest."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from deltaid.effects.at_platform import Cable
from deltaid.effects.point import Added, TracePoint
from deltaid.estimation.shrinkage import Shrunk
from deltaid.levels import FAINT

# Distances that are searched, in radii of the motion; a cable from farther away pulls as a force
# and a spring along it do.
_DISTANCES = (1.5, 3.0, 6.0, 12.0)
# Share of the inverse distance to which the point is found; the fit corrects it.
_NEAR = 0.01

Place = Float[np.ndarray, " 3"]


def largest_cable(points: Sequence[TracePoint], fit: Shrunk) -> Added | None:
    """The cable that explains most beside all groups of a fit; None if one that pushes explains
    more, for then it mimics another cause."""
    task, home = points[0].dynamics.robot.task, points[0].dynamics.kinematics.home
    x = np.concatenate([task.point(point.motion.z) for point in points]) - task.point(home)
    middle = 0.5 * (x.min(axis=0) + x.max(axis=0))
    radius = float(np.linalg.norm(x - middle, axis=1).max())

    def anchor(w: Place) -> Place:
        """The point in the direction of w, at the inverse distance |w| in radii."""
        return middle + radius * w / max(float(w @ w), np.finfo(float).tiny)

    def cost(w: Place) -> float:
        if w @ w > 1:  # inside the motion
            return 0.0
        return -_explained(points, fit, [anchor(w)])[0][0]

    ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    starts = np.concatenate([ways / distance for distance in _DISTANCES])
    gains, _ = _explained(points, fit, [anchor(w) for w in starts])
    w = starts[np.argmax(gains)]
    simplex = w + np.linalg.norm(w) * np.vstack([np.zeros(3), 0.3 * np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": _NEAR * np.linalg.norm(w), "fatol": np.inf}
    place = anchor(minimize(cost, w, method="Nelder-Mead", options=options).x)
    _, ((T, k),) = _explained(points, fit, [place])
    return _cable(points[0], place, T, k) if T > _NEAR * radius * k > 0 else None


def _explained(
    points: Sequence[TracePoint], fit: Shrunk, anchors: Sequence[Place]
) -> tuple[Float[np.ndarray, " anchors"], Float[np.ndarray, "anchors 2"]]:
    """Sum of squares that a cable from each point explains, 0 if it would push; its T and k."""
    sets = list[Float[np.ndarray, "samples anchors 2"]]()
    for point in points:
        columns = [_cable(point, a).columns(point)[:, :, :2] for a in anchors]
        sets += list(np.stack(columns, axis=2))
    gains, coefficients = fit.explained(range(len(sets)), sets, FAINT)
    return np.where(coefficients.min(axis=1) > 0, gains, 0.0), coefficients


def _cable(point: TracePoint, anchor: Place, T: float = 0.0, k: float = 0.0) -> Added:
    count = len(Cable.symbols)
    orders = (*anchor.tolist(), float(T), float(k))
    return Added(Cable.name, Cable(point.dynamics, (), (1.0,) * count, orders))
