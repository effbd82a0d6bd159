"""The unknowns u of a plan and their posterior after rows of independent noise.

With u ~ N(0, 1) a priori, a square root R of the information is kept,

    R_c u = r_c + e,  e ~ N(0, 1)      ⇒      RᵀR = I + Σ R_cᵀR_c,    Cov u = (RᵀR)⁻¹

Factors are stacked and triangularised; no normal equations are formed, so a scale of 0.01 % next to
a prior of 50 % loses no digits.

All ten entries of every body and the coefficients of the joints are unknown. A description's `free`
is a choice for fits to torques, so here it only counts where it makes a body known (`[]`). An entry
of M̄ has the standard deviation spread · |prior|, or spread · √(M̄_ii M̄_jj) where its prior is
(nearly) zero: thin directions of a body are as certain as consistency makes them.

    w = [p; log of the drives' gains] = w_0 + W u,    u ~ N(0, 1) before any measurement
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.parameters import parameter_layout, stated_spreads
from deltaid.effects.geometry import opened
from deltaid.estimation.information import triangle
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.levels import HARDLY
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter


@dataclass(frozen=True, eq=False)
class Knowledge:
    """The posterior of the unknowns u of a plan.

    Attributes:
        root: an upper triangular R with Cov u = (RᵀR)⁻¹.
    """

    root: Float[np.ndarray, "n n"]

    def and_rows(self, rows: Float[np.ndarray, "rows n"]) -> "Knowledge":
        """The posterior with more rows, in units of their noise."""
        return Knowledge(triangle(np.vstack([self.root, rows])))

    @cached_property
    def inverse(self) -> Float[np.ndarray, "n n"]:
        """R⁻¹, whose rows have the standard deviations of u as their lengths."""
        return np.linalg.solve(self.root, np.eye(len(self.root)))

    @property
    def std(self) -> Float[np.ndarray, " n"]:
        """Standard deviations of u; 1 a priori."""
        return np.linalg.norm(self.inverse, axis=1)

    def std_of(self, G: Float[np.ndarray, "goals n"]) -> Float[np.ndarray, " goals"]:
        """Standard deviations of G u."""
        return np.linalg.norm(G @ self.inverse, axis=1)

    def log_det(self, G: Float[np.ndarray, "goals n"]) -> float:
        """½ log det(I + G Cov Gᵀ) [nats]; 0 where G u is known exactly."""
        half = G @ self.inverse
        gram = half @ half.T if len(half) < half.shape[1] else half.T @ half
        return 0.5 * float(np.linalg.slogdet(np.eye(len(gram)) + gram)[1])


@dataclass(frozen=True, eq=False)
class PlanUnknowns:
    """The variables of a plan.

    Attributes:
        names: of the variables: 'S.mcx', 'S.Sxx', 'viscous.drive1', 'gain.drive1'.
        owners: the body of each entry; '' for entries of no body.
        units: of each.
        sizes: |prior|, or √(M̄_ii M̄_jj) where that is zero; deviations are reported as shares of it.
        prior: prior values.
        spread: prior standard deviations, as shares of `sizes`.
        W: w = w_0 + W u.
        known: bodies taken as known.
    """

    names: tuple[str, ...]
    owners: tuple[str, ...]
    units: tuple[str, ...]
    sizes: Float[np.ndarray, " n"]
    prior: Float[np.ndarray, " n"]
    spread: Float[np.ndarray, " n"]
    W: Float[np.ndarray, "extended n"]
    known: tuple[str, ...]

    @property
    def bodies(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(owner for owner in self.owners if owner))

    def after(self, *rows: Float[np.ndarray, "_ extended"]) -> Knowledge:
        """The posterior after rows over w, in units of their noise."""
        return Knowledge(np.eye(len(self.names))).and_rows(np.vstack(rows) @ self.W)

    def of_bodies(self, *bodies: str) -> Int[np.ndarray, " entries"]:
        """Indices of the entries of some bodies; of all if none is named."""
        wanted = bodies or self.bodies
        return np.array([k for k, owner in enumerate(self.owners) if owner in wanted], dtype=int)


def unknowns(
    robot: RobotDescription, prior_spread: float = PRIOR_SPREAD, gain_spread: float = 0.0
) -> PlanUnknowns:
    """The variables of a robot.

    Args:
        prior_spread: relative standard deviation of the prior where the robot's file states none.
        gain_spread: of the drives' torque constants; zero for exact ones.
    """
    reduction = build_reduction(opened(robot), np.arange(len(parameter_layout(robot).names)))
    variables, dof = reduction.variables, len(robot.drives)
    of_body = np.array([variable.kind == "inertia" for variable in variables])
    sized = of_body & (np.abs(reduction.prior) >= HARDLY * reduction.scale)
    spread = _spreads(robot, reduction, prior_spread)
    gains = robot.drives if gain_spread > 0 else ()
    W = np.zeros((len(reduction.layout.names) + dof, len(variables) + len(gains)))
    sizes = np.where(sized, np.abs(reduction.prior), reduction.scale)
    W[:-dof, : len(variables)] = reduction.A * (spread * sizes)
    W[-dof:, len(variables) :] = gain_spread * np.eye(dof)[:, : len(gains)]
    return PlanUnknowns(
        names=(*reduction.names, *(f"gain.{drive}" for drive in gains)),
        owners=(*(v.owner if v.kind == "inertia" else "" for v in variables), *[""] * len(gains)),
        units=(*(variable.unit for variable in variables), *[""] * len(gains)),
        sizes=np.append(sizes, np.ones(len(gains))),
        prior=np.append(reduction.prior, np.ones(len(gains))),
        spread=np.append(spread, np.full(len(gains), gain_spread)),
        W=W,
        known=tuple(name for name in robot.body_names if not robot.bodies[name].free),
    )


def _spreads(
    robot: RobotDescription, reduction: Reduction, usual: float
) -> Float[np.ndarray, " n"]:
    """Relative spread of each variable: the widest stated one of the parameters it is part of.

    Variables of no body have the spread of their kind.
    """
    stated = stated_spreads(robot)

    def spread(k: int, variable: PriorParameter) -> float:
        if variable.kind != "inertia":
            return variable.spread / PRIOR_SPREAD * usual
        parts = np.flatnonzero(reduction.A[:, k])
        return max(stated.get(reduction.layout.names[i], usual) for i in parts)

    return np.array([spread(*entry) for entry in enumerate(reduction.variables)])
