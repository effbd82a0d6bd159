"""Friction of any law as a few columns: splines over speed, and what gears lose of their load.

The friction of a joint is sign(v) φ(|v|), φ a sum of terms. A cubic spline through knots v_k on the
axis of speed follows every usual φ, φ(|v|) ≈ Σ_k φ(v_k) s_k(|v|), with cardinal splines s_k that
are one at their knot and zero at all others. The columns of any law and its constants are
combinations of sign(v) s_k(|v|). Viscous and Coulomb friction are exact.

A drive has the columns 1 and |v| as well, for one-way friction, and sign(q̇) |x|, x the load of its
gear.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import Joint, joints_of, of_load, one_way, one_way_speed
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Knots as shares of a joint's reference speed: dense where Stribeck's terms bend. From the last one
# on splines go on as lines.
KNOTS = (0.0, 0.0025, 0.006, 0.012, 0.024, 0.045, 0.08, 0.14, 0.24, 0.4, 0.65, 1.0)
# Friction at rest is that of hardly moving, on the side of the step that the direction says.
_CREEP = 1e-12


@cache
def _cardinal() -> CubicSpline:
    return CubicSpline(KNOTS, np.eye(len(KNOTS)), bc_type="natural")


def splines(v: Float[np.ndarray, " samples"], top: float) -> Float[np.ndarray, "knots samples"]:
    """s_k(v) at speeds v ≥ 0 for a reference speed; together 1 everywhere, and Σ v_k s_k(v) = v."""
    x, spline = v / top, _cardinal()
    beyond = x > 1.0
    values = spline(np.minimum(x, 1.0)).T
    if beyond.any():
        values[:, beyond] += np.outer(spline(1.0, 1), x[beyond] - 1.0)
    return values


@dataclass(frozen=True, eq=False)
class SpeedColumns(Addition):
    """The columns of one joint's friction over speed; `top` is its reference speed [rad/s, m/s]."""

    dynamics: Dynamics
    name: str
    top: float

    @cached_property
    def joint(self) -> Joint:
        """The joint and its entries in the regressor."""
        return next(joint for joint in joints_of(self.dynamics) if joint.name == self.name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One a spline; of a drive those of both directions alike behind them."""
        symbols = [f"speed{k}" for k in range(len(KNOTS))]
        symbols += [] if self.joint.drive is None else ["one_way", "one_way_speed"]
        return _constants(self.name, symbols, self.dynamics.robot.units(self.name).force)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Every column in all rows that feel the joint."""
        rows, count = self.joint.drives, len(self.parameters)
        return np.tile(rows, count), np.repeat(np.arange(count), len(rows))

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """sign(v) s_k(|v|) ∂v/∂q̇; behind them 1 and |v|."""
        del w, recording
        C, v = own[self.joint.coulomb], self.joint.speed(own)
        columns = [C * s for s in splines(v, self.top)]
        if self.joint.drive is not None:
            columns += [one_way(v, C, v), one_way_speed(v, C, v)]
        return np.vstack(columns)

    def on(self, dynamics: Dynamics) -> "SpeedColumns":
        return replace(self, dynamics=dynamics)

    def following(self, h: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, " columns"]:
        """The combination of columns that is a law's h(v), v with its sign."""
        knots = self.top * np.array(KNOTS)
        v = np.maximum(knots, _CREEP)
        odd, even = 0.5 * (h(v) - h(-v)), 0.5 * (h(v) + h(-v))
        if self.joint.drive is None:
            return odd
        return np.array([*odd, even[0], (even[-1] - even[0]) / knots[-1]])


@dataclass(frozen=True, eq=False)
class CarriedColumns(Addition):
    """One column a drive, sign(q̇) |x|; x by parameters p, of the robot and of what it holds."""

    dynamics: Dynamics
    p: Float[np.ndarray, " parameters"]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A share of the load each."""
        drives = self.dynamics.robot.drives
        return tuple(entry for drive in drives for entry in _constants(drive, ["carried"], "1"))

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Each in its drive's row."""
        drives = np.arange(self.dynamics.dof)
        return drives, drives

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """sign(q̇) |x|."""
        del own, recording
        x = self.dynamics.carried(w.z, w.qd, w.qdd, self.p) + w.carried
        return of_load(w.qd, np.sign(w.qd), x).T

    def on(self, dynamics: Dynamics) -> "CarriedColumns":
        return replace(self, dynamics=dynamics)


def _constants(joint: str, symbols: list[str], unit: str) -> tuple[Parameter, ...]:
    return tuple(
        Parameter("constant", joint, symbol, unit, -np.inf, np.inf, 0.0, 1.0) for symbol in symbols
    )
