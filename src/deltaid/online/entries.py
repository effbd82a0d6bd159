"""Identifiable parameters of a load, and the consistent load nearest to an estimate.

A load adds to the body that carries it. If that body only translates, torques determine its mass;
if it also turns about one axis, the first moments across that axis and the moment of inertia about
it; otherwise all ten.

A consistent load has a positive mass m and, about its centre, positive definite second moments
Σ − mc mcᵀ/m, which includes the triangle inequality. If only one moment of inertia Θ is
identifiable, a consistent load exists if and only if Θ > |mc|²/m. Pivots of [m mcᵀ; mc Σ] are made
positive one after the other, each by the minimiser of

    (x⁺ − x)² / (2 s²) − μ log x⁺,   x⁺ = (x + √(x² + 4 μ s²)) / 2,

which hardly changes clearly positive values. It needs no iteration and is finite for any estimate.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import DescriptionError
from deltaid.robot.inertia import INERTIA_NAMES

# Weight μ of the barrier.
_BARRIER = 1e-4
# For each axis: the moment of inertia and the first moments across it.
_AXES = ((4, (2, 3)), (5, (1, 3)), (6, (1, 2)))
# Least moment about the centre, as a share of mass times squared extent, and least pivot as a share
# of that.
_LEAST = 1e-3


@dataclass(frozen=True)
class LoadEntries:
    """Identifiable entries of a load that a body carries.

    Attributes:
        shown: indices of the entries among a body's ten, the mass first.
        axis: first moments across the axis about which the body turns; None where it does not turn
            or turns about several.
    """

    body: str
    shown: tuple[int, ...]
    axis: tuple[int, int] | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries, such as m, mcx, mcy, Izz."""
        return tuple(INERTIA_NAMES[k] for k in self.shown)

    def places(self, layout: ParameterLayout) -> list[int]:
        """Indices of the entries among all parameters."""
        return [layout.body(self.body).start + k for k in self.shown]

    def scales(self, mass: float, extent: float) -> tuple[float, ...]:
        """Sizes of the entries for a load of this mass [kg] and extent [m]."""
        return tuple(mass * extent ** ((k > 0) + (k > 3)) for k in self.shown)

    def consistent(self, x: ca.SX, P: ca.SX, scales: tuple[float, ...], extent: float) -> ca.SX:
        """Entries of the consistent load for an estimate and its covariance.

        A corrected mass moves the other entries by their correlation. The load lies within the
        extent.

        Args:
            x, P: estimate and covariance, in units of the scales.
            scales: of the entries.
        """
        spread = ca.sqrt(ca.fmax(P[0, 0], 0) + 1e-12)
        m = _positive(x[0], spread)
        rest = x + P[:, 0] / (spread * spread) * (m - x[0])
        ten = {k: rest[i] * scales[i] for i, k in enumerate(self.shown)}
        ten[0] = m * scales[0]
        if len(self.shown) == 1:
            return ten[0]
        across, most = self.axis or (1, 2, 3), extent**2 * ten[0]
        mc, least = ca.vertcat(*(ten[k] for k in across)), _LEAST * most
        mc = mc / ca.fmax(1, ca.sqrt(ca.sumsqr(mc) + 1e-30) / (extent * ten[0]))
        ten |= dict(zip(across, ca.vertsplit(mc), strict=True))
        if self.axis is not None:
            of_centre, turned = ca.sumsqr(mc) / ten[0], self.shown[-1]
            ten[turned] = of_centre + _positive(ca.fmin(ten[turned], most) - of_centre, least)
        else:
            second = 0.5 * (ten[4] + ten[5] + ten[6])  # tr Σ
            shrunk = ca.fmin(1, most / ca.fmax(second, least))
            ten |= {k: ten[k] * shrunk for k in range(4, 10)}
            ten |= _second_moments(ten, mc, least)
        return ca.vertcat(*(ten[k] for k in self.shown))


def _positive(x: ca.SX, spread: ca.SX) -> ca.SX:
    """Compute x⁺ without cancellation where x is negative."""
    root = ca.sqrt(x * x + 4 * _BARRIER * spread * spread)
    share = 2 * _BARRIER * spread * spread / ca.fmax(root - x, 1e-300)
    return ca.if_else(x > 0, 0.5 * (x + root), share)


def _second_moments(ten: dict[int, ca.SX], mc: ca.SX, least: ca.SX) -> dict[int, ca.SX]:
    """The six moments with Σ − mc mcᵀ/m positive definite, by its factorisation L D Lᵀ.

    L is limited to possible products of inertia; tiny pivots would make it large.
    """
    place = {(0, 0): 4, (1, 1): 5, (2, 2): 6, (1, 0): 7, (2, 1): 8, (2, 0): 9}
    half, S = 0.5 * (ten[4] + ten[5] + ten[6]), ca.SX.zeros(3, 3)
    for (i, j), k in place.items():
        S[i, j] = (half if i == j else 0) - ten[k] - mc[i] * mc[j] / ten[0]
    L, D = ca.SX.eye(3), ca.SX.zeros(3)
    for j in range(3):
        pivot = S[j, j] - ca.dot(L[j, :j].T ** 2, D[:j])
        D[j] = ca.fmax(_positive(pivot, least), _LEAST * least)
        for i in range(j + 1, 3):
            most = ca.sqrt(_positive(S[i, i], least) / D[j])
            slope = (S[i, j] - ca.dot(L[i, :j].T * L[j, :j].T, D[:j])) / D[j]
            L[i, j] = ca.fmin(ca.fmax(slope, -most), most)
    Sigma = L @ ca.diag(D) @ L.T + mc @ mc.T / ten[0]
    return {k: (ca.trace(Sigma) if i == j else 0) - Sigma[i, j] for (i, j), k in place.items()}


def load_entries(dynamics: Dynamics, body: str | None = None) -> LoadEntries:
    """Identifiable entries of a robot's load.

    Args:
        body: that carries it; None for EE, or P where there is no EE.

    Raises:
        DescriptionError: the body does not exist, or must be named.
    """
    bodies = dynamics.layout.bodies
    chosen = body or dynamics.robot.load_carrier
    if chosen not in bodies:
        raise DescriptionError(
            f"has no body {body}" if body else "does not say which body carries a load",
            where=dynamics.robot.name,
            cure=f"name one of {', '.join(bodies)}",
        )
    first, (_, columns) = dynamics.layout.body(chosen).start, dynamics.regressor_pattern
    shown = tuple(sorted({int(k) - first for k in columns if 0 <= k - first < 10}))
    axes = {(0, *across, moment): across for moment, across in _AXES} | {(0,): None}
    if shown in axes:
        return LoadEntries(chosen, shown, axes[shown])
    return LoadEntries(chosen, tuple(range(10)), None)
