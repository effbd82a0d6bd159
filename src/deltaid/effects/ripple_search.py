"""Search for the orders of the largest ripples beside all effects of a contest."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebpts1, chebvander

from deltaid.effects.at_drives import RippleColumns
from deltaid.effects.point import Added, TracePoint
from deltaid.estimation.scatter import surprise
from deltaid.estimation.shrinkage import Shrunk

# Orders that are searched, in waves over the stroke: least (less looks like a spring), most, step.
_LEAST, _MOST, _APART = 0.5, 160.0, 0.25
# Number of orders whose filtered columns are computed near one order; all others are interpolated
# to 1e-6, for phases differ by π/4 at most.
_NODES = 7
# Least share of a ripple's square that is no spring, zero or other effect.
_ALIKE = 1e-2
# Least share of a ripple that must pass the filter at a drive's usual speed.
_PASSED = 0.1

Orders = Float[np.ndarray, " orders"]
# Of each drive, which differ in number.
OrdersOfDrives = Sequence[Float[np.ndarray, " _"]]


def largest_ripples(
    points: Sequence[TracePoint], fit: Shrunk, least: float, searched: OrdersOfDrives
) -> list[tuple[int, float]]:
    """Drive and order of the largest ripple of each drive beside all groups of a fit, if it is
    more surprising than `least` [decades]."""
    ripples = list[tuple[int, float]]()
    for i, orders in enumerate(searched):
        if len(orders) < 2:
            continue
        pairs = [waves_of(point, i, orders) for point in points]
        explained, _ = fit.explained(_blocks(points, i), pairs, _ALIKE)
        best = int(np.argmax(explained))
        if surprise(float(explained[best]), 2) - np.log10(len(orders)) > least:
            ripples.append((i, nearest_order(points, fit, i, float(orders[best]), orders)))
    return ripples


def nearest_order(
    points: Sequence[TracePoint], fit: Shrunk, i: int, order: float, orders: Orders
) -> float:
    """The order near another that explains most beside all groups of a fit, by filtered columns.

    It is not below the least order searched: along a shorter part of a wave, torques are those of a
    spring, and coefficients grow without bound.
    """
    step = orders[1] - orders[0]
    near = np.linspace(max(order - step, orders[0]), order + step, num=41)
    pairs = [waves_near(point, i, near) for point in points]
    explained, _ = fit.explained(_blocks(points, i), pairs, _ALIKE)
    return float(near[np.argmax(explained)])


def waves_near(point: TracePoint, i: int, near: Orders) -> Float[np.ndarray, "samples orders 2"]:
    """Filtered columns of a drive's ripples of orders that are close together: sine and cosine of
    n (q − q_0) with q_0 in the middle of its stroke, by polynomials in n."""
    x = chebpts1(_NODES)
    nodes = near[0] + 0.5 * (x + 1.0) * (near[-1] - near[0])
    ripples = RippleColumns(point.dynamics, (i,) * _NODES, (1.0,) * (2 * _NODES), tuple(nodes))
    sine, cosine = np.moveaxis(point.added(ripples)[i].reshape(-1, _NODES, 2), 2, 0)
    turn = 0.5 * nodes * (point.q[:, i].min() + point.q[:, i].max())
    C, S = np.cos(turn), np.sin(turn)
    # Values at nodes to coefficients of Chebyshev polynomials, and these to values.
    of_nodes = np.linalg.solve(chebvander(x, _NODES - 1), np.eye(_NODES))
    weights = chebvander(np.linspace(-1.0, 1.0, len(near)), _NODES - 1) @ of_nodes
    centred = np.stack([sine * C - cosine * S, cosine * C + sine * S])
    return np.einsum("psk,nk->snp", centred, weights)


def _blocks(points: Sequence[TracePoint], i: int) -> list[int]:
    """Numbers of a drive's blocks in all recordings."""
    return [k * point.dof + i for k, point in enumerate(points)]


def waves_of(point: TracePoint, i: int, orders: Orders) -> Float[np.ndarray, "samples orders 2"]:
    turns, size = np.outer(point.q[:, i], orders), passed(point, i, orders).T
    return np.stack([size * np.sin(turns), size * np.cos(turns)], axis=2)


def ripple_of(point: TracePoint, drive: int, order: float) -> Added:
    name = f"ripple of {point.drives[drive]}, {order:.4g}"
    return Added(name, RippleColumns(point.dynamics, (drive,), (1.0, 1.0), (order,)))


def searched_orders(points: Sequence[TracePoint]) -> OrdersOfDrives:
    """Orders of ripples that are searched for each drive [1/rad or 1/m]."""
    return [_orders(points, i) for i in range(points[0].dof)]


def _orders(points: Sequence[TracePoint], i: int) -> Orders:
    stroke = np.ptp(np.concatenate([point.q[:, i] for point in points]))
    usual = max(float(np.sqrt(np.mean(point.motion.qd[:, i] ** 2))) for point in points)
    if stroke <= 0 or usual <= 0:
        return np.zeros(0)
    wave = 2 * np.pi / stroke
    fastest = 2 * np.pi * points[0].trace.low_pass.cutoff / usual / _PASSED
    orders = np.arange(_LEAST, min(fastest / wave, _MOST), _APART) * wave
    sizes = [np.sqrt(np.mean(passed(point, i, orders) ** 2, axis=1)) for point in points]
    return orders[np.max(sizes, axis=0) > _PASSED]


def passed(point: TracePoint, i: int, orders: Orders) -> Float[np.ndarray, "orders samples"]:
    """Share of a drive's ripples that passes the low-pass, at the frequency n q̇ / 2π."""
    low_pass = point.trace.low_pass
    frequency = np.fft.rfftfreq(1 << 14, 1 / low_pass.rate)
    response = np.abs(np.fft.rfft(low_pass.response, 1 << 14))
    speeds = np.abs(np.outer(orders, point.motion.qd[:, i])) / (2 * np.pi)
    return np.interp(speeds, frequency, response) * point.motion.weights[:, i]
