"""How friction that depends on load changes with what gears are taken to carry.

Losses μ s |x| with x = X p and s = sign(q̇) are not linear. About the parameters p₀ of the fit
before, with x₀ = X p₀, they are

    μ s |x| ≈ μ s |x₀| + μ₀ s sign(x₀) X (p − p₀),

so columns of what gears carry come 1 + μ₀ s sign(x₀) times, and torques are μ₀ s sign(x₀) x₀ more.
Without the second term x₀ would stay at its prior where torques alone do not determine what a gear
carries: where only the sum of a rotor and what turns behind its gear is identifiable.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Parameters, Regressor
from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.additions import Extended, Values
from deltaid.recording.windows import Samples

Factor = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True, eq=False)
class LoadSlope:
    """The slope of all drives' losses."""

    # μ₀ of each drive; zero where friction does not depend on load
    shares: Float[np.ndarray, " dof"]
    drives: Int[np.ndarray, " entries"]  # of each entry of the regressor
    # which entries are of X: neither friction nor rotor of a drive's own motor
    carried: Bool[np.ndarray, " entries"]

    @classmethod
    def at(cls, regressor: Regressor | Extended, p: Parameters) -> "LoadSlope":
        """At parameters p of the robot; entries of additions behind its own are not of X."""
        robot = regressor.kinematics.robot
        layout, (drives, columns) = parameter_layout(robot), regressor.regressor_pattern
        of_links = [
            k for k, parameter in enumerate(layout.parameters)
            if not (parameter.owner in robot.drives and parameter.kind in ("friction", "rotor"))
        ]  # fmt: skip
        values = dict(zip(layout.names, p.tolist(), strict=True))
        shares = np.array([values.get(f"load.{drive}", 0.0) for drive in robot.drives])
        return cls(shares, drives, np.isin(columns, of_links))

    def factor(self, w: Samples, x: Float[np.ndarray, "samples dof"]) -> Factor:
        """μ₀ s sign(x₀) of each drive, where gears carry x₀."""
        return (self.shares * np.sign(w.qd) * np.sign(x)).T

    def scaled(self, entries: Values, factor: Factor) -> Values:
        return entries * (1.0 + self.carried[:, None] * factor[self.drives])
