"""What motions are compared by: information about base parameters, or what bodies are known to.

The search follows a criterion of the information matrix G = mean Y_BᵀWY_B, whose gradient is exact
and cheap. Which of the motions that it finds from its starts is best may be decided by all that
would be recorded along them: torques, sensors, measured values (`by_bodies`).

Columns are scaled beforehand, so G has no units. Each criterion is a function of the eigenvalues of
G, smaller is better, with the gradient ∂J/∂G = V diag(φ′) Vᵀ.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.motion.excitation.settings import CriterionName
from deltaid.motion.fourier import FourierMotion
from deltaid.sensors.planning.knowledge import Knowledge, unknowns
from deltaid.sensors.planning.rows import PlannedMotion, Scene, torque_rows, torques
from deltaid.sensors.planning.shopping import BODIES, goal
from deltaid.sensors.planning.uses import described_rows
from deltaid.sensors.weighings import weighings

Judge = Callable[[FourierMotion], float]

# A direction that a motion does not excite at all has eigenvalue zero; the logarithm then stops
# here instead of at minus infinity.
_SMALLEST = 1e-14


@dataclass(frozen=True)
class Criterion:
    """A criterion by name.

    cond:      log λ_max − log λ_min, that is log cond(Y_BᵀWY_B).
    logdet:    −(1/n) Σ log λ_i, D-optimality per parameter.
    a-optimal: log((1/n) Σ 1/λ_i), the mean variance.
    e-optimal: −log λ_min, the largest variance.
    """

    name: CriterionName

    def evaluate(self, G: Float[np.ndarray, "n n"]) -> tuple[float, Float[np.ndarray, "n n"]]:
        """Value and gradient ∂J/∂G."""
        lam, V = np.linalg.eigh(G)
        lam = np.maximum(lam, _SMALLEST)
        slope, n = np.zeros_like(lam), len(lam)
        match self.name:
            case "cond":
                value = np.log(lam[-1] / lam[0])
                slope[-1], slope[0] = 1 / lam[-1], -1 / lam[0]
            case "logdet":
                value, slope = -np.mean(np.log(lam)), -1 / (n * lam)
            case "a-optimal":
                total = np.sum(1 / lam)
                value, slope = np.log(total / n), -1 / (lam**2 * total)
            case "e-optimal":
                value = -np.log(lam[0])
                slope[0] = -1 / lam[0]
        return float(value), (V * slope) @ V.T


# Samples of a period, and the share of an entry that is known well enough with.
_SAMPLES, _ENOUGH = 1000, 1e-4


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
            cure="describe them under `sensors`, or leave out --for sensors",
        )
    p, entries = prior_parameters(dynamics.robot), unknowns(dynamics.robot)
    weighed = weighings(dynamics.robot)

    def judge(motion: FourierMotion) -> float:
        time = np.arange(_SAMPLES) * motion.period / _SAMPLES
        z, zd, zdd = motion.evaluate(time)
        _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
        planned = PlannedMotion("", motion.period, z, qd, qdd)
        scene = Scene(dynamics, p, planned, samples / _SAMPLES, noise)
        rows = torque_rows(scene, torques(dynamics, p, planned))
        known = Knowledge.before(len(entries.names)).and_rows(rows @ entries.W)
        known = known.and_rows(described_rows(scene, weighed)[0] @ entries.W)
        return goal(BODIES, entries, scene, _ENOUGH).left(known)

    return judge
