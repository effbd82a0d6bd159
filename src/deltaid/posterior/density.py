"""The posterior of a model as a density over its free variables.

    log π(x) = −½ ‖L⁻¹ (K p(x) − b)‖² − ρ(x) / (2 spread²),   p(x) = A x + p_0,   M_b(x) ≻ 0

L, K, b are what data says (`PosteriorRecord`) and ρ is the regulariser of the fit. Free are the
variables of the fit, and masses and second moments that no torque determines and the fit leaves at
their prior. Bodies with `free: []` and structural zeros stay.

With a quadratic ρ the posterior is a normal distribution on the cones. Else ρ's curvature at the
prior stands in the normal distribution, and the rest of ρ is a factor beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.errors import DescriptionError
from deltaid.estimation.information import triangle
from deltaid.estimation.posing import METRICS
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.regularizer import Regularizer, SpectralTerm, prior_root
from deltaid.estimation.scatter import inverse
from deltaid.model.posterior_record import PosteriorRecord
from deltaid.model.record import IdentifiedModel
from deltaid.posterior.cones import Cones
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia

_OF_ROWS = ("Sxx", "Syy", "Szz", "m")

Points = Float[np.ndarray, "points n"]


@dataclass(frozen=True, eq=False)
class Density:
    """A normal distribution on cones, perhaps with a factor: x = mean + root·y, y ~ N(0, 1)."""

    reduction: Reduction  # what x means
    mean: Float[np.ndarray, " n"]  # mean, root: of the normal distribution
    root: Float[np.ndarray, "n n"]
    cones: Cones  # what y must hold
    fitted: Float[np.ndarray, " n"]  # fitted, prior: y of the model and of its prior
    prior: Float[np.ndarray, " n"]
    # logarithm of the factor at some x inside; None if the regulariser is quadratic
    rest: Callable[[Points], Float[np.ndarray, " points"]] | None = None

    def parameters(self, y: Points) -> Float[np.ndarray, "points parameters"]:
        x = self.mean + y @ self.root.T
        return x @ self.reduction.A.T + self.reduction.p_0

    def log_factor(self, y: Points) -> Float[np.ndarray, " points"]:
        """Logarithm of the factor of the normal distribution, inside the cones."""
        return np.zeros(len(y)) if self.rest is None else self.rest(self.mean + y @ self.root.T)


def density(model: IdentifiedModel, where: str = "") -> Density:
    """The posterior of an identified model.

    Raises:
        DescriptionError: its file is of a version that kept no posterior.
        IdentificationError: the prior's sizes are too far apart for the arithmetic.
    """
    record = model.posterior
    if record is None:
        raise DescriptionError(
            "was identified by a version of deltaid that kept no posterior to draw models from",
            where=where or model.robot.name,
            cure="identify it again: `deltaid identify ROBOT LOG… -o MODEL`",
        )
    reduction = _reduction(model, record)
    regularizer = METRICS[model.settings.regularizer].regularizer(reduction)
    mean, root = _normal(record, reduction, regularizer)
    rest = None
    if regularizer.spectral is not None:
        rest = _spectral_rest(regularizer.spectral, reduction.prior, record.spread)
    M = {body: pseudo_inertia(model.p[model.layout.body(body)]) for body in model.layout.bodies}
    x = [
        M[variable.owner][PSEUDO_INERTIA_ENTRIES[variable.symbol]]
        if variable.kind == "inertia"
        else model.value(variable.name)
        for variable in reduction.variables
    ]
    fitted, prior = (np.linalg.solve(root, at - mean) for at in (np.array(x), reduction.prior))
    return Density(reduction, mean, root, Cones.of(reduction, mean, root), fitted, prior, rest)


def _reduction(model: IdentifiedModel, record: PosteriorRecord) -> Reduction:
    """That of the fit, with moments free that no torque shows."""
    names = model.layout.names
    visible = np.flatnonzero(~np.isin(names, record.unseen))
    completed = build_reduction(model.robot, visible).completed
    bodies = {
        name: body.changed(free=(*body.free, *(_OF_ROWS[i] for i in completed[name])))
        if body.free
        else body
        for name, body in model.robot.bodies.items()
    }
    reduction = build_reduction(model.robot.changed(bodies=bodies), visible)
    return replace(reduction, stated={}, widened=record.wider)


def _normal(
    record: PosteriorRecord, reduction: Reduction, regularizer: Regularizer
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """Mean and root of data and curvature of the prior together."""
    K, scale = record.combination(reduction.layout.names), reduction.scale
    _, _, curvature = regularizer.evaluate(reduction.prior)
    prior = prior_root(0.5 * curvature * np.outer(scale, scale)) / record.spread
    off = np.array(record.values) - K @ reduction.p_reg
    data = np.column_stack([K @ (reduction.A * scale), off])
    data, n = solve_triangular(record.root, data, lower=True), reduction.size
    R = triangle(np.vstack([data, np.column_stack([prior, np.zeros(n)])]))
    root = scale[:, None] * inverse(R[:n, :n])
    return reduction.prior + root @ R[:n, n], root


def _spectral_rest(
    term: SpectralTerm, prior: Float[np.ndarray, " n"], spread: float
) -> Callable[[Points], Float[np.ndarray, " points"]]:
    """−(ρ − its curvature at the prior) / (2 spread²) of a spectral regulariser."""
    _, _, hessian = term.evaluate(prior)

    def rest(points: Points) -> Float[np.ndarray, " points"]:
        off = points - prior
        curved = 0.5 * np.einsum("ci,ij,cj->c", off, hessian, off)
        return (curved - term.values(points)) / (2 * spread**2)

    return rest
