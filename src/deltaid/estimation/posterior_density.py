"""The posterior of a model as a density over its free variables.

    log π(x) = −½ ‖L⁻¹ (K p(x) − b)‖² − ρ(x) / (2 spread²),   p(x) = A x + p_0,   M_b(x) ≻ 0

L, K, b are the record of the data (`PosteriorRecord`), and ρ is the fit's regulariser. Free are the
variables of the fit, and masses and second moments that no torque determines, which the fit
leaves at their prior. Bodies with `free: []` and structural zeros are fixed.

With a quadratic ρ the posterior is a normal distribution on the cones. Otherwise the normal
distribution has ρ's curvature at the prior, and the rest of ρ is a factor.

Samples are drawn by elliptical slice sampling, many chains at once. From a point y inside the
cones, a point ν ~ N(0, 1) is drawn, then angles on the ellipse y cos θ + ν sin θ until its point
lies inside (Murray, Adams and MacKay 2010). The interval of angles shrinks towards y, so this ends,
and it leaves the distribution exactly invariant. On the ellipse, entries of the blocks are
combinations of those of y and ν, so a trial needs no matrix product.

Where data contradicts consistency, the distribution is a thin layer at an edge, across which no
ellipse is long; most directions meet no edge. So axes are turned to those of the curvature of
−Σ log det M_b. Steps alternate: along each axis that soon meets an edge, along random parts of the
axes that meet one, along all free axes, and along all axes without steps of their own."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular

from deltaid.errors import DescriptionError, IdentificationError
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import (
    METRICS,
    Matrix,
    Regularizer,
    SpectralTerm,
    Vector,
    prior_root,
    regularizer,
)
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.scatter import inverse
from deltaid.levels import FAINT
from deltaid.model.parameter_record import PosteriorRecord
from deltaid.model.record import IdentifiedModel
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia

_OF_ROWS = ("Sxx", "Syy", "Szz", "m")
# Curvature above which an axis has steps of its own, and below which it counts as free.
_ALONE, _FREE = 0.3, 0.05
# Number of random parts in which axes that are not free take steps together.
_PARTS = 4
# Number of steps after which entries are recomputed, before rounding errors add up.
_ANEW = 50
# Most trials on an ellipse; each halves the interval on average.
_TRIALS = 200
# Standard deviations of the rays from the model at whose ends, or at the edge, chains begin.
_WIDER = 2.0

Points = Float[np.ndarray, "points n"]
OfPoints = Float[np.ndarray, " points"]
OfChains = Float[np.ndarray, "n chains"]
Each = Float[np.ndarray, " chains"]
Some = Int[np.ndarray, " some"]


@dataclass(frozen=True, eq=False)
class Cones:
    """Blocks C_b + Σ y_k S_bk ≻ 0, each written as the entries of its lower triangle.

    Entries of all blocks are numbers in one array, a row an entry and a column a point; elimination
    runs over blocks of one size and all points together, with no loop but over rows and columns of
    a block.
    """

    constant: Float[np.ndarray, " entries"]  # entries at y = 0
    slopes: Float[np.ndarray, "entries n"]  # by how much each changes with y
    # for each size of blocks, the place of every entry (row, column, block)
    groups: tuple[Int[np.ndarray, "_ _ _"], ...]

    @classmethod
    def in_prior_units(cls, reduction: Reduction, mean: Vector, root: Matrix) -> "Cones":
        """The fit's blocks for x = mean + root·y, each relative to its prior; coefficients with an
        upper bound have a second block."""
        blocks = [
            (variables, fixed - FAINT * np.eye(len(fixed)), per_variable)
            for variables, fixed, per_variable in (block.normalised for block in reduction.blocks)
        ]
        for k, variable in enumerate(reduction.variables):
            if np.isfinite(variable.high):
                bound, slope = np.array([[variable.high]]), np.array([[[-1.0]]])
                blocks.append((np.array([k]), bound / variable.scale, slope / variable.scale))
        entries, places, count = list[np.ndarray](), dict[int, list[np.ndarray]](), 0
        for variables, fixed, per_variable in blocks:
            k = len(fixed)
            i, j = np.tril_indices(k)
            place = np.zeros((k, k), dtype=int)
            place[i, j] = place[j, i] = count + np.arange(len(i))
            count += len(i)
            own = per_variable[:, i, j].T @ np.column_stack([mean, root])[variables]
            own[:, 0] += fixed[i, j]
            entries.append(own)
            places.setdefault(k, []).append(place)
        groups = tuple(np.moveaxis(np.array(group), 0, 2) for _, group in sorted(places.items()))
        every = np.concatenate([np.zeros((0, 1 + len(mean))), *entries])
        return cls(every[:, 0], every[:, 1:], groups)

    def hold(self, entries: Float[np.ndarray, "entries points"]) -> Bool[np.ndarray, " points"]:
        """Which points lie inside, by the entries of their blocks (Gauss, pivots positive)."""
        inside = np.ones(entries.shape[1], dtype=bool)
        with np.errstate(all="ignore"):  # what follows a pivot of zero does not matter
            for places in self.groups:
                A = entries[places]
                for j in range(len(A)):
                    pivot = A[j, j]
                    inside &= np.all(pivot > 0, axis=0)
                    for i in range(j + 1, len(A)):
                        A[i, j + 1 : i + 1] -= A[i, j] / pivot * A[j + 1 : i + 1, j]
        return inside

    def curvature(self, y: Vector) -> Matrix:
        """Second derivative of −Σ log det M_b at a point inside: along a direction of curvature h,
        an edge is about 1/√h away."""
        entries = self.constant + self.slopes @ y
        H = np.zeros((len(y), len(y)))
        for places in self.groups:
            for block in np.moveaxis(places, 2, 0):
                W = inverse(np.linalg.cholesky(entries[block]).T).T
                flat = np.einsum("ij,jkn,lk->nil", W, self.slopes[block], W).reshape(len(y), -1)
                H += flat @ flat.T
        return H


@dataclass(frozen=True, eq=False)
class Density:
    """A normal distribution on cones, perhaps with a factor: x = mean + root·y, y ~ N(0, 1)."""

    reduction: Reduction  # what x means
    mean: Vector  # mean, root: of the normal distribution
    root: Matrix
    cones: Cones  # what y must hold
    fitted: Vector  # fitted, prior: y of the model and of its prior
    prior: Vector
    # logarithm of the factor at some x inside; None if the regulariser is quadratic
    rest: Callable[[Points], OfPoints] | None = None

    def parameters(self, y: Points) -> Float[np.ndarray, "points parameters"]:
        return (self.mean + y @ self.root.T) @ self.reduction.A.T + self.reduction.p_0

    def log_factor(self, y: Points) -> OfPoints:
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
    prior_term = regularizer(reduction, METRICS[model.settings.regularizer])
    mean, root = _normal(record, reduction, prior_term)
    term, rest = prior_term.spectral, None
    if term is not None:
        rest = _spectral_rest(term, reduction.prior, record.spread)
    M = {body: pseudo_inertia(model.p[model.layout.body(body)]) for body in model.layout.bodies}
    x = [
        M[variable.owner][PSEUDO_INERTIA_ENTRIES[variable.symbol]]
        if variable.kind == "inertia"
        else model.value(variable.name)
        for variable in reduction.variables
    ]
    points = np.array(x), reduction.prior
    fitted, prior = (np.linalg.solve(root, point - mean) for point in points)
    cones = Cones.in_prior_units(reduction, mean, root)
    return Density(reduction, mean, root, cones, fitted, prior, rest)


def _reduction(model: IdentifiedModel, record: PosteriorRecord) -> Reduction:
    """The reduction of the fit, with masses and moments free that no torque determines."""
    visible = np.flatnonzero(~np.isin(model.layout.names, record.unseen))
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
    record: PosteriorRecord, reduction: Reduction, prior_term: Regularizer
) -> tuple[Vector, Matrix]:
    """Mean and root of data and curvature of the prior together."""
    K, scale, n = record.combination(reduction.layout.names), reduction.scale, reduction.size
    _, _, curvature = prior_term.evaluate(reduction.prior)
    prior = prior_root(0.5 * curvature * np.outer(scale, scale)) / record.spread
    off = np.array(record.values) - K @ reduction.p_reg
    data = np.column_stack([K @ (reduction.A * scale), off])
    data = solve_triangular(record.root, data, lower=True)
    R = triangle(np.vstack([data, np.column_stack([prior, np.zeros(n)])]))
    root = scale[:, None] * inverse(R[:n, :n])
    return reduction.prior + root @ R[:n, n], root


def _spectral_rest(
    term: SpectralTerm, prior: Vector, spread: float
) -> Callable[[Points], OfPoints]:
    """−(ρ − its curvature at the prior) / (2 spread²) of a spectral regulariser."""
    _, _, hessian = term.evaluate(prior)

    def rest(points: Points) -> OfPoints:
        off = points - prior
        curved = 0.5 * np.einsum("ci,ij,cj->c", off, hessian, off)
        return (curved - term.values(points)) / (2 * spread**2)

    return rest


class Chains:
    """Markov chains over a posterior."""

    def __init__(self, density: Density, count: int, rng: np.random.Generator) -> None:
        self.density, self.count, self.rng = density, count, rng
        self._turn, self._steps = np.eye(density.reduction.size), 0
        self._y = self._starts()
        self.turn()

    def turn(self) -> None:
        """Choose axes by the mean of the chains' points; only before draws that count."""
        y = self.y.T
        cones = self.density.cones
        values, vectors = np.linalg.eigh(cones.curvature(y.mean(axis=1)))
        self._turn, curvature = vectors[:, ::-1], values[::-1]
        self._near, self._middle = (int(np.sum(curvature > edge)) for edge in (_ALONE, _FREE))
        self._cones = replace(cones, slopes=cones.slopes @ self._turn)
        self._y = self._turn.T @ y
        self._entries = self._cones.slopes @ self._y
        self._log = self._factor(self._y)

    @property
    def y(self) -> Float[np.ndarray, "chains n"]:
        return (self._turn @ self._y).T

    def walk(self, rounds: int) -> None:
        n = len(self._y)
        for _ in range(rounds):
            for k in range(self._near):
                self._step(np.array([k]))
            for part in np.array_split(self.rng.permutation(self._middle), _PARTS):
                self._step(part)
            self._step(np.arange(self._middle, n))
            self._step(np.arange(self._near, n))

    def _step(self, axes: Some) -> None:
        if not axes.size:
            return
        self._steps += 1
        if self._steps % _ANEW == 0:
            self._entries = self._cones.slopes @ self._y
        old = self._y[axes]
        new = self.rng.standard_normal(old.shape)
        slopes = self._cones.slopes[:, axes]
        current, target = slopes @ old, slopes @ new
        stays = self._cones.constant[:, None] + self._entries - current
        threshold = self._log + np.log(self.rng.random(self.count))

        def accepted(angle: Each, k: Some) -> Bool[np.ndarray, " some"]:
            """Which of the chains k may go to these angles."""
            cos, sin = np.cos(angle), np.sin(angle)
            good = self._cones.hold(stays[:, k] + current[:, k] * cos + target[:, k] * sin)
            if self.density.rest is not None:
                y = self._y[:, k[good]]
                y[axes] = (old[:, k] * cos + new[:, k] * sin)[:, good]
                good[good] = self._factor(y) > threshold[k[good]]
            return good

        angle = self._angle(accepted)
        cos, sin = np.cos(angle), np.sin(angle)
        self._y[axes] = old * cos + new * sin
        self._entries += current * (cos - 1) + target * sin
        if self.density.rest is not None:
            self._log = self._factor(self._y)

    def _angle(self, accepted: Callable[[Each, Some], np.ndarray]) -> Each:
        angle = self.rng.uniform(0, 2 * np.pi, self.count)
        low, high = angle - 2 * np.pi, angle.copy()
        active = np.arange(self.count)
        for _ in range(_TRIALS):
            active = active[~accepted(angle[active], active)]
            if not active.size:
                return angle
            back = angle[active] < 0
            low[active] = np.where(back, angle[active], low[active])
            high[active] = np.where(back, high[active], angle[active])
            angle[active] = self.rng.uniform(low[active], high[active])
        angle[active] = 0.0  # rounding at the very edge: these stay where they are
        return angle

    def _factor(self, y: OfChains) -> Each:
        return self.density.log_factor((self._turn @ y).T)

    def _starts(self) -> OfChains:
        """Points inside the cones, about the model, that are spread wider than the distribution."""
        cones, centre = self.density.cones, _inner(self.density)
        rays = _WIDER * self.rng.standard_normal((len(centre), self.count))
        entries, along = cones.constant + cones.slopes @ centre, cones.slopes @ rays
        length = np.ones(self.count)
        for _ in range(_TRIALS):
            outside = ~cones.hold(entries[:, None] + along * length)
            if not outside.any():
                break
            length[outside] *= 0.7 * self.rng.random(outside.sum()) + 0.3
        return centre[:, None] + rays * length


def _inner(density: Density) -> Float[np.ndarray, " n"]:
    """The model, moved slightly towards its prior if it touches the edge."""
    cones = density.cones
    for share in (0.0, *np.geomspace(1e-9, 1.0, 19)):
        y = density.fitted + share * (density.prior - density.fitted)
        if cones.hold((cones.constant + cones.slopes @ y)[:, None])[0]:
            return y
    raise IdentificationError(
        "the model lies outside of what its own description allows",
        where="posterior",
        cure="take back what was changed in the model file by hand, or identify it again",
    )
