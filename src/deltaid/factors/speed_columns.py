"""Friction of any law as a few columns: splines over speed.

The friction of a joint is sign(v) φ(|v|), φ a sum of terms. A cubic spline through knots v_k on the
axis of speed follows every usual φ, φ(|v|) ≈ Σ_k φ(v_k) s_k(|v|), with cardinal splines s_k that
are one at their knot and zero at all others. A recording that has been gathered with the columns
sign(v) s_k(|v|) of its joints tells what it would tell with any law, and with any constants of that
law: its columns are combinations of those. Viscous and Coulomb friction are exact.

Of a drive there are the columns 1 and |v| as well, for what differs between directions.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import entry_speeds
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Knots as shares of a joint's reference speed: dense where Stribeck's terms bend. From the last one
# on splines go on as lines.
KNOTS = (0.0, 0.0025, 0.006, 0.012, 0.024, 0.045, 0.08, 0.14, 0.24, 0.4, 0.65, 1.0)

# A column of a joint from speed |v| and direction: what a law is made of.
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


@cache
def _cardinal() -> CubicSpline:
    return CubicSpline(KNOTS, np.eye(len(KNOTS)), bc_type="natural")


def splines(v: Float[np.ndarray, " samples"], top: float) -> Float[np.ndarray, "knots samples"]:
    """s_k(v) at speeds v ≥ 0 for a reference speed; together 1 everywhere, and Σ v_k s_k(v) = v."""
    x, spline = v / top, _cardinal()
    beyond = x > 1.0
    found = spline(np.minimum(x, 1.0)).T
    if beyond.any():
        found[:, beyond] += np.outer(spline(1.0, 1), x[beyond] - 1.0)
    return found


@dataclass(frozen=True, eq=False)
class SpeedColumns(Addition):
    """The columns of one joint's friction over speed.

    Attributes:
        dynamics: of the robot.
        joint: which.
        top: its reference speed [rad/s or m/s].
    """

    dynamics: Dynamics
    joint: str
    top: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One a spline; of a drive those of both directions alike behind them."""
        unit = self.dynamics.robot.units(self.joint).force
        names = [f"speed{k}" for k in range(len(KNOTS))]
        names += ["one_way", "one_way_speed"] if self.is_drive else []
        return tuple(
            Parameter("constant", self.joint, name, unit, -np.inf, np.inf, 0.0, 1.0)
            for name in names
        )

    @property
    def is_drive(self) -> bool:
        """Whether it is a drive's joint, whose law may differ between directions."""
        return self.joint in self.dynamics.robot.drives

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Every column in all rows that feel the joint."""
        rows, _ = self.dynamics.regressor_pattern
        own, count = rows[self._coulomb], len(self.parameters)
        return np.tile(own, count), np.repeat(np.arange(count), len(own))

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """sign(v) s_k(|v|) ∂v/∂q̇; behind them 1 and |v|."""
        del w, recording
        C = own[self._coulomb]
        v = entry_speeds(own[self._viscous], C)
        found = [C * s for s in splines(v, self.top)]
        if self.is_drive:
            found += [np.ones_like(C), np.broadcast_to(v, C.shape)]
        return np.vstack(found)

    def on(self, dynamics: Dynamics) -> "SpeedColumns":
        return replace(self, dynamics=dynamics)

    def of(self, shape: Shape) -> Float[np.ndarray, " columns"]:
        """The combination of columns that follows a shape of |v| and direction.

        Args:
            shape: what it is at speeds, for a direction of +1 or −1.
        """
        knots = self.top * np.array(KNOTS)
        ahead, back = shape(knots, np.ones_like(knots)), shape(knots, -np.ones_like(knots))
        odd, even = 0.5 * (ahead - back), 0.5 * (ahead + back)
        if not self.is_drive:
            return odd
        return np.array([*odd, even[0], (even[-1] - even[0]) / knots[-1]])

    @cached_property
    def _coulomb(self) -> np.ndarray:
        return self._of("coulomb")

    @cached_property
    def _viscous(self) -> np.ndarray:
        return self._of("viscous")

    def _of(self, symbol: str) -> np.ndarray:
        _, columns = self.dynamics.regressor_pattern
        names = np.array(self.dynamics.layout.names)[columns]
        return np.flatnonzero(names == f"{symbol}.{self.joint}")
