"""The optimisation problem (9)–(11) for Fourier coefficients and base frequency, with gradients.

The unknowns are the base frequency and, for each task coordinate, its centre and its sine and
cosine coefficients (`Series`). The phase ω₀ t of the grid points is fixed, so z = Φ c, ż = ω₀ Φ′ c,
z̈ = ω₀² Φ″ c with constant matrices, and every derivative is a product with them.

Each limit is one constraint: a smooth upper bound of its largest use over the grid,
(1/ρ) log Σ_t exp(ρ u_t). A few dozen of these keep a solver fast where thousands of points would
not, and since the bound lies above the maximum it is on the safe side.

Motions are compared by information about base parameters, or by what bodies are known to. The
search follows a criterion of the information matrix G = mean Y_BᵀWY_B, whose gradient is exact and
cheap. Which of the motions that it finds from its starts is best may be decided by all that would
be recorded along them: torques, sensors, measured values (`by_bodies`). Columns are scaled
beforehand, so G has no units. Each criterion is a function of the eigenvalues of G, smaller is
better, with the gradient ∂J/∂G = V diag(φ′) Vᵀ.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax

from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError
from deltaid.levels import EXACT
from deltaid.motion.excitation.graph import ExcitationGraph
from deltaid.motion.excitation.settings import CriterionName
from deltaid.motion.fourier import FourierMotion, Series, Vector
from deltaid.motion.random_motion import INSTANTS
from deltaid.sensors.planning.knowledge import unknowns
from deltaid.sensors.planning.rows import PlannedRecording, planned_along, torque_rows
from deltaid.sensors.planning.shopping import BODIES, goal
from deltaid.sensors.planning.uses import described_rows

Judge = Callable[[FourierMotion], float]

# A direction that a motion does not excite at all has eigenvalue zero; the logarithm then stops
# here instead of at minus infinity.
_SMALLEST = 1e-14


def criterion(
    name: CriterionName, G: Float[np.ndarray, "n n"]
) -> tuple[float, Float[np.ndarray, "n n"]]:
    """Value and gradient ∂J/∂G of a criterion by name.

    cond:      log λ_max − log λ_min, that is log cond(Y_BᵀWY_B).
    logdet:    −(1/n) Σ log λ_i, D-optimality per parameter.
    a-optimal: log((1/n) Σ 1/λ_i), the mean variance.
    e-optimal: −log λ_min, the largest variance.
    """
    lam, V = np.linalg.eigh(G)
    lam = np.maximum(lam, _SMALLEST)
    slope, n = np.zeros_like(lam), len(lam)
    match name:
        case "cond":
            value, slope[-1], slope[0] = np.log(lam[-1] / lam[0]), 1 / lam[-1], -1 / lam[0]
        case "logdet":
            value, slope = -np.mean(np.log(lam)), -1 / (n * lam)
        case "a-optimal":
            total = np.sum(1 / lam)
            value, slope = np.log(total / n), -1 / (lam**2 * total)
        case "e-optimal":
            value, slope[0] = -np.log(lam[0]), -1 / lam[0]
    return float(value), (V * slope) @ V.T


def by_bodies(dynamics: Dynamics, noise: Float[np.ndarray, " dof"], samples: float) -> Judge:
    """½ log det of the covariance of all bodies' entries [nats] after a recording of a motion.

    Args:
        noise: of torques [N m or N].
        samples: of the recording.

    Raises:
        DescriptionError: the robot's description has no sensors.
    """
    if not dynamics.robot.sensors:
        raise DescriptionError(
            "has no sensors to plan a motion for",
            where=dynamics.robot.name,
            cure="describe them under `sensors`, or omit --for sensors",
        )
    entries = unknowns(dynamics.robot)

    def judge(motion: FourierMotion) -> float:
        planned = planned_along(dynamics, motion, INSTANTS, "", motion.period)
        recorded = PlannedRecording(dynamics, planned, samples / INSTANTS, noise)
        known = entries.after(torque_rows(recorded), described_rows(recorded)[0])
        return goal(BODIES, entries, recorded, EXACT).uncertainty(known)

    return judge


States = Float[np.ndarray, "inputs samples"]
Entries = Float[np.ndarray, "entries samples"]
Speeds = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True)
class Evaluation:
    """Objective and largest use of each limit, with derivatives; NaN with a pose out of reach."""

    value: float
    gradient: Vector
    use: Float[np.ndarray, " limits"]
    slopes: Float[np.ndarray, "limits unknowns"]


@dataclass(frozen=True)
class ExcitationProblem:
    """Problem (9)–(11) on a grid of one period.

    Attributes:
        row_weights: of each drive, 1/torque².
        scales: of each base column; G then has no units.
        prior: added to G, in the same scaling; zero for a criterion of the data alone.
        base: base parameters, which torque limits need, with
        largest: the largest torque of drives that have one.
        velocity_weight: w of the term −w ‖q̇‖ of (9), with
        speed: what each drive's velocity is measured in.
    """

    graph: ExcitationGraph
    series: Series
    criterion: CriterionName
    row_weights: Float[np.ndarray, " dof"]
    scales: Float[np.ndarray, " base"]
    prior: Float[np.ndarray, "base base"]
    base: Float[np.ndarray, " base"]
    largest: dict[int, float]
    velocity_weight: float
    speed: Float[np.ndarray, " dof"]
    samples: int

    @property
    def limit_names(self) -> tuple[str, ...]:
        """Names of all limits, torques last."""
        drives = self.graph.dynamics.robot.drives
        torque = [f"{drives[i]} torque" for i in self.largest]
        return (*(limit.name for limit in self.graph.limits), *torque)

    @property
    def two_sided(self) -> np.ndarray:
        """Which limits bound from both sides."""
        return np.array([*(x.two_sided for x in self.graph.limits), *[True] * len(self.largest)])

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
        use, weights = _smooth_maximum(self._limits(s, entries), self.two_sided, sharpness)
        gradients = np.concatenate([gradient[None], self._limit_gradients(s, weights)])
        slopes = self.series.chain(x, basis, gradients)
        return Evaluation(value, slopes[0], use, slopes[1:])

    def use_of(self, s: States) -> Float[np.ndarray, "limits samples"]:
        """Use of every limit for any states (z, ż, z̈), samples in columns; ∞ out of reach."""
        u = self._limits(s, self._outputs(s)[0])
        use = np.where(self.two_sided[:, None], np.abs(u), u)
        return np.where(np.isnan(use), np.inf, use)

    def information(self, x: Vector, samples: int) -> Float[np.ndarray, "base base"]:
        """G with the true signs of Coulomb friction, on a grid of its own."""
        entries = self.graph.exact_regressor(self.series.state(x, self.grid(samples)))
        return self._information(self._weighted(self.graph.dense(entries)))

    def _outputs(self, s: States) -> tuple[Entries, Speeds]:
        out = self.graph.regressor(s, threads=1)
        return out[: -self.series.dof], out[-self.series.dof :]

    def _weighted(
        self, Y: Float[np.ndarray, "samples dof base"]
    ) -> Float[np.ndarray, "samples dof base"]:
        return Y * np.sqrt(self.row_weights)[None, :, None] * self.scales

    def _information(
        self, Y: Float[np.ndarray, "samples dof base"]
    ) -> Float[np.ndarray, "base base"]:
        flat = Y.reshape(-1, Y.shape[2])
        return flat.T @ flat / len(Y) + self.prior

    def _objective(self, s: States, entries: Entries, qd: Speeds) -> tuple[float, States]:
        """J − w‖q̇‖ and its gradient with respect to s, by one reverse sweep."""
        Y, n, speed = self._weighted(self.graph.dense(entries)), s.shape[1], self.speed[:, None]
        value, slope = criterion(self.criterion, self._information(Y))
        d_Y = self._weighted((2 / n) * (Y @ slope))
        norm = max(float(np.sqrt(np.mean(np.sum((qd / speed) ** 2, axis=0)))), 1e-12)
        d_qd = -self.velocity_weight * (qd / speed) / (speed * n * norm)
        adjoint = np.vstack([s, d_Y[:, *self.graph.regressor_pattern].T, d_qd])
        return value - self.velocity_weight * norm, self.graph.pullback(adjoint, threads=1)

    def _limits(self, s: States, entries: Entries) -> Float[np.ndarray, "limits samples"]:
        drives, columns = self.graph.regressor_pattern
        rows = [self.graph.limit_values(s, threads=1)]
        for drive, largest in self.largest.items():
            at = drives == drive
            rows.append((self.base[columns[at]] @ entries[at])[None] / largest)
        return np.vstack(rows)

    def _limit_gradients(
        self, s: States, weights: Float[np.ndarray, "limits samples"]
    ) -> Float[np.ndarray, "limits inputs samples"]:
        """Σ_t weights_t ∂u_t/∂s of every limit; torques by reverse sweeps, all in one call."""
        gradients = np.zeros((len(weights), *s.shape))
        limits, inputs = self.graph.limit_pattern
        gradients[limits, inputs] = self.graph.limit_slopes(s, threads=1) * weights[limits]
        (drives, columns), speeds = (
            self.graph.regressor_pattern,
            np.zeros((self.series.dof, s.shape[1])),
        )
        adjoints = []
        for k, (drive, largest) in enumerate(self.largest.items(), len(self.graph.limits)):
            share = np.where(drives == drive, self.base[columns], 0.0) / largest
            adjoints.append(np.vstack([s, np.outer(share, weights[k]), speeds]))
        if adjoints:
            swept = self.graph.pullback(np.hstack(adjoints), threads=1)
            split = swept.reshape(len(s), -1, s.shape[1]).swapaxes(0, 1)
            gradients[len(self.graph.limits) :] = split
        return gradients


def _smooth_maximum(
    u: Float[np.ndarray, "limits samples"], two_sided: np.ndarray, sharpness: float
) -> tuple[Float[np.ndarray, " limits"], Float[np.ndarray, "limits samples"]]:
    """(1/ρ) log Σ exp(ρ u), over u and −u where two-sided, and its derivative with respect to u."""
    both = sharpness * np.hstack([u, np.where(two_sided[:, None], -u, -np.inf)])
    share, n = softmax(both, axis=1), u.shape[1]
    return logsumexp(both, axis=1) / sharpness, share[:, :n] - share[:, n:]
