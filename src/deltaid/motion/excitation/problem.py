"""The optimisation problem (9)–(11) for Fourier coefficients and base frequency, with gradients.

The unknowns are the base frequency and, for each task coordinate, its centre and its sine and
cosine coefficients (`Series`). The phase ω₀ t of the grid points is fixed, so z = Φ c, ż = ω₀ Φ′ c,
z̈ = ω₀² Φ″ c with constant matrices, and every derivative is a product with them.

Each limit is one constraint: a smooth upper bound of its largest use over the grid,
(1/ρ) log Σ_t exp(ρ u_t). A few dozen of these keep a solver fast where thousands of points would
not, and since the bound lies above the maximum it is on the safe side.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax

from deltaid.motion.excitation.criterion import Criterion
from deltaid.motion.excitation.graph import ExcitationGraph
from deltaid.motion.fourier import Series, Vector

States = Float[np.ndarray, "inputs samples"]
Entries = Float[np.ndarray, "entries samples"]
Speeds = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True)
class Weighting:
    """How the rows and columns of the regressor count.

    Attributes:
        rows: one weight for each drive, 1/torque².
        columns: the scale of each base column; G then has no units.
        prior: added to G, in the same scaling; zero for a criterion of the data alone.
    """

    rows: Float[np.ndarray, " dof"]
    columns: Float[np.ndarray, " base"]
    prior: Float[np.ndarray, "base base"]


@dataclass(frozen=True)
class Torques:
    """What torque limits need: base parameters, and the largest torque of drives that have one."""

    base: Float[np.ndarray, " base"]
    largest: dict[int, float]


@dataclass(frozen=True)
class Velocity:
    """The term −w ‖q̇‖ of (9): w and the speed that each drive's velocity is measured in."""

    weight: float
    speed: Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class Evaluation:
    """Objective and largest use of each limit, with derivatives; NaN with a pose out of reach."""

    value: float
    gradient: Vector
    use: Float[np.ndarray, " limits"]
    slopes: Float[np.ndarray, "limits unknowns"]


@dataclass(frozen=True)
class ExcitationProblem:
    """Problem (9)–(11) on a grid of one period."""

    graph: ExcitationGraph
    series: Series
    criterion: Criterion
    weighting: Weighting
    torques: Torques
    velocity: Velocity
    samples: int

    @property
    def limit_names(self) -> tuple[str, ...]:
        """Names of all limits, torques last."""
        drives = self.graph.dynamics.robot.drives
        torque = [f"{drives[i]} torque" for i in self.torques.largest]
        return (*(limit.name for limit in self.graph.limits), *torque)

    @property
    def two_sided(self) -> np.ndarray:
        """Which limits bound from both sides."""
        kinematic = [limit.two_sided for limit in self.graph.limits]
        return np.array([*kinematic, *(True for _ in self.torques.largest)])

    def grid(self, samples: int | None = None) -> Float[np.ndarray, "3 samples terms"]:
        """The series' basis on evenly spaced points of a period."""
        n = samples or self.samples
        return self.series.basis(np.arange(n) * (2 * np.pi / n))

    def evaluate(self, x: Vector, sharpness: float = 100.0) -> Evaluation:
        """Objective, limits and all derivatives; `sharpness` is ρ of the limits' maxima."""
        basis = self.grid()
        s = self.series.state(x, basis)
        entries, qd = self._outputs(s)
        if not np.all(np.isfinite(entries)):
            nothing = np.full((1 + len(self.two_sided), self.series.length), np.nan)
            return Evaluation(np.nan, nothing[0], nothing[1:, 0], nothing[1:])
        value, gradient = self._objective(s, entries, qd)
        u = self._limits(s, entries)
        use, weights = _smooth_maximum(u, self.two_sided, sharpness)
        gradients = np.concatenate([gradient[None], self._limit_gradients(s, weights)])
        slopes = self.series.chain(x, basis, gradients)
        return Evaluation(value, slopes[0], use, slopes[1:])

    def limits_of(self, s: States) -> Float[np.ndarray, "limits samples"]:
        """u of every limit for any states (z, ż, z̈), samples in columns."""
        return self._limits(s, self._outputs(s)[0])

    def use_of(self, s: States) -> Float[np.ndarray, "limits samples"]:
        """Use of every limit for any states (z, ż, z̈), samples in columns; ∞ out of reach."""
        u = self.limits_of(s)
        use = np.where(self.two_sided[:, None], np.abs(u), u)
        return np.where(np.isnan(use), np.inf, use)

    def information(self, x: Vector, samples: int) -> Float[np.ndarray, "base base"]:
        """G with the true signs of Coulomb friction, on a grid of its own."""
        s = self.series.state(x, self.grid(samples))
        return self._information(self._weighted(self.graph.dense(self.graph.exact_regressor(s))))

    def _outputs(self, s: States) -> tuple[Entries, Speeds]:
        """Regressor entries and drive speeds."""
        out = self.graph.regressor(s, threads=1)
        dof = self.series.dof
        return out[:-dof], out[-dof:]

    def _weighted(
        self, Y: Float[np.ndarray, "samples dof base"]
    ) -> Float[np.ndarray, "samples dof base"]:
        return Y * np.sqrt(self.weighting.rows)[None, :, None] * self.weighting.columns

    def _information(
        self, Y: Float[np.ndarray, "samples dof base"]
    ) -> Float[np.ndarray, "base base"]:
        flat = Y.reshape(-1, Y.shape[2])
        return flat.T @ flat / len(Y) + self.weighting.prior

    def _objective(self, s: States, entries: Entries, qd: Speeds) -> tuple[float, States]:
        """J − w‖q̇‖ and its gradient with respect to s, by one reverse sweep."""
        Y = self._weighted(self.graph.dense(entries))
        value, slope = self.criterion.evaluate(self._information(Y))
        n, pattern = s.shape[1], self.graph.regressor_pattern
        d_Y = self._weighted((2 / n) * (Y @ slope))
        relative = qd / self.velocity.speed[:, None]
        norm = max(float(np.sqrt(np.mean(np.sum(relative**2, axis=0)))), 1e-12)
        d_qd = -self.velocity.weight * relative / (self.velocity.speed[:, None] * n * norm)
        adjoint = np.vstack([d_Y[:, pattern.rows, pattern.columns].T, d_qd])
        gradient = self.graph.pullback(np.vstack([s, adjoint]), threads=1)
        return value - self.velocity.weight * norm, gradient

    def _limits(self, s: States, entries: Entries) -> Float[np.ndarray, "limits samples"]:
        pattern = self.graph.regressor_pattern
        rows = [self.graph.limit_values(s, threads=1)]
        for drive, largest in self.torques.largest.items():
            at = pattern.rows == drive
            torque = self.torques.base[pattern.columns[at]] @ entries[at]
            rows.append(torque[None] / largest)
        return np.vstack(rows)

    def _limit_gradients(
        self, s: States, weights: Float[np.ndarray, "limits samples"]
    ) -> Float[np.ndarray, "limits inputs samples"]:
        """Σ_t weights_t ∂u_t/∂s of every limit; torques by reverse sweeps, all in one call."""
        gradients = np.zeros((len(weights), *s.shape))
        pattern = self.graph.limit_pattern
        slopes = self.graph.limit_slopes(s, threads=1)
        gradients[pattern.rows, pattern.columns] = slopes * weights[pattern.rows]
        entry, n = self.graph.regressor_pattern, s.shape[1]
        if not self.torques.largest:
            return gradients
        adjoints = []
        for k, (drive, largest) in enumerate(self.torques.largest.items(), len(self.graph.limits)):
            share = np.where(entry.rows == drive, self.torques.base[entry.columns], 0.0) / largest
            speeds = np.zeros((self.series.dof, n))
            adjoints.append(np.vstack([s, np.outer(share, weights[k]), speeds]))
        swept = self.graph.pullback(np.hstack(adjoints), threads=1)
        torque = swept.reshape(len(s), len(adjoints), n).swapaxes(0, 1)
        gradients[len(self.graph.limits) :] = torque
        return gradients


def _smooth_maximum(
    u: Float[np.ndarray, "limits samples"], two_sided: np.ndarray, sharpness: float
) -> tuple[Float[np.ndarray, " limits"], Float[np.ndarray, "limits samples"]]:
    """(1/ρ) log Σ exp(ρ u), over u and −u where two-sided, and its derivative with respect to u."""
    below = np.where(two_sided[:, None], -u, -np.inf)
    both = sharpness * np.hstack([u, below])
    share = softmax(both, axis=1)
    n = u.shape[1]
    return logsumexp(both, axis=1) / sharpness, share[:, :n] - share[:, n:]
