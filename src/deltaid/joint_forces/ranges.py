"""Range of a force that is compatible with recorded torques.

A force is c·p. Recordings determine base parameters K p only, so they determine c·p as far as c
lies in the row space of K and noise allows; the prior and physical consistency bound the rest. The
range of c·p is its least and largest value over all consistent p with

    ‖(Y p − τ)/σ_c‖²_W + ‖u‖² ≤ m² + 1.96²,

where u are the unknowns in standard deviations of their prior (`joint_forces.unknowns`), m² is the
least value of the left side over consistent p, and σ_c is the noise level for this force, estimated
from the scatter of the recordings as for all intervals (`estimation.scatter`). Without active cones
this is the 95 % interval of a Gaussian posterior. In coordinates v = R u − b, with the triangular R
of data and prior, c·p is a linear function over a ball and cones (`ConsistentBall`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.errors import DescriptionError, IdentificationError, RecordingError
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.ranges import ConsistentBall
from deltaid.estimation.scatter import NORMAL, half_width
from deltaid.identification.gathering import gather_balanced
from deltaid.identification.geometric_rows import Geometry, geometry
from deltaid.identification.least_squares import BaseEstimate, estimate_base
from deltaid.identification.loads import as_identified
from deltaid.joint_forces.unknowns import ForceUnknowns, unknowns
from deltaid.levels import FAINT
from deltaid.model.model import Model, ModelLike, load
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import open_recordings

# Share of its prior spread below which torques determine a force: half of the digits.
_DETERMINED = np.sqrt(np.finfo(float).eps)
# Share of an open force's variance from which an unknown is named.
_NAMED = 0.05
Coefficients = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class Openness:
    """The part of a force that torques leave undetermined, however exact they are.

    Attributes:
        half_width: half the width of its 95 % interval by the prior alone, without consistency
            [N or N m]; 0 if base parameters determine the force.
        unknowns: entries that cause it, the most important first.
    """

    half_width: float
    unknowns: tuple[str, ...]


@dataclass(frozen=True)
class Range:
    """Least and largest value of a force that are compatible with the recordings [N or N m]."""

    low: float
    high: float


@dataclass(frozen=True)
class ForceEvidence:
    """Evidence of recordings: information, base parameters with their noise, and geometry."""

    information: Information
    estimate: BaseEstimate
    geometry: Geometry


class Determinacy:
    """The part of forces c·p that torques determine.

    Args:
        model: for its robot and prior spread.
        base: the combinations K p that torques determine.
    """

    def __init__(self, model: Model, base: BaseParameters) -> None:
        visible = ~np.isin(np.arange(len(base.layout.names)), list(base.invisible))
        self.unknowns: ForceUnknowns = unknowns(model.robot, visible, model.prior_spread)
        self.base, self.rows = base, base.combination() @ self.unknowns.A
        size = np.linalg.norm(self.rows, axis=1, keepdims=True)
        self._units = self.rows / np.where(size > 0, size, 1.0)

    def openness(self, c: Coefficients) -> Openness:
        """The undetermined part of c·p: the component of c·u outside the row space of K A."""
        c_u = self.unknowns.A.T @ c
        rest = c_u - self._units.T @ np.linalg.lstsq(self._units.T, c_u, rcond=None)[0]
        whole, left = float(np.linalg.norm(c_u)), float(np.linalg.norm(rest))
        if left <= _DETERMINED * whole or whole == 0:
            return Openness(0.0, ())
        share = (rest / left) ** 2
        order = [k for k in np.argsort(-share) if share[k] > _NAMED][:4]
        return Openness(NORMAL * left, tuple(self.unknowns.names[k] for k in order))


@threadpool_limits.wrap(limits=1, user_api="blas")  # threads only slow small matrices down
def evidence(
    model: ModelLike,
    logs: RecordingLike | Sequence[RecordingLike],
    *,
    columns: ColumnMappings = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[ForceEvidence, Determinacy]:
    """Evidence of recordings on a model's parameters, filtered as for its identification.

    Raises:
        DescriptionError: the model was not identified from recordings.
        RecordingError: a log is invalid, or the model was not identified from it.
        IdentificationError: the motion does not determine base parameters.
    """
    model = load(model)
    known, dynamics = model.identified, model.dynamics
    if known is None:
        raise DescriptionError(
            "is a robot at its prior, which comes from no recordings",
            where=model.source,
            cure="identify a model from them first, and give its file",
        )
    own, kept = {source.sha256 for source in known.sources}, known.settings
    recordings = open_recordings(
        logs, dynamics.kinematics, columns, kept.cutoff, progress, keep_all=kept.keep_all
    )
    for recording in recordings:  # a range from another robot's recording would be meaningless
        if recording.log.sha256 not in own:
            raise RecordingError(
                "is not a recording that the model was identified from",
                where=str(recording.path),
                cure="give those that the model names, unchanged: "
                + ", ".join(source.log for source in known.sources),
            )
    recordings = [as_identified(model, recording.log) for recording in recordings]
    predicted_by = model.p if model.robot.load_drives else None
    gathered = gather_balanced(dynamics, recordings, load=predicted_by, progress=progress)
    information = gathered.information
    base = base_parameters(information, dynamics.layout)
    estimate = estimate_base(base, information, groups=gathered)
    shape = geometry(dynamics, recordings, base, information, model.p)
    return ForceEvidence(information, estimate, shape), Determinacy(model, base)


class Ranges:
    """Ranges of forces c·p given recordings.

    A fit may weigh its prior slightly differently, so ranges are widened to include the identified
    value c·p.
    """

    def __init__(self, given: ForceEvidence, known: Determinacy, p: Parameters) -> None:
        self._noise, self._known, self._p = given.estimate.noise, known, p
        self._shifts, self._white = given.geometry.shifts, max(self._noise.sigma, FAINT)
        information, unknown, at = given.information, known.unknowns, given.information.columns
        problem = information.problem.substituted(unknown.A[at], unknown.p_0[at])
        self._data = triangle(np.column_stack([problem.A, problem.b]))

    @threadpool_limits.wrap(limits=1, user_api="blas")
    def force_range(self, c: Coefficients) -> Range:
        """The range of c·p.

        Raises:
            IdentificationError: the solver did not converge.
        """
        unknown, value = self._known.unknowns, float(c @ self._p)
        c_u, constant = unknown.A.T @ c, float(c @ unknown.p_0)
        rows = np.vstack([self._data / self._level(c_u), np.eye(len(c_u), len(c_u) + 1)])
        # over x = prior + size u, as the blocks are
        R = rows[:, :-1] / unknown.size
        b, c_x = rows[:, -1] + R @ unknown.prior, c_u / unknown.size
        ball = ConsistentBall(R, b, unknown.blocks, unknown.size)
        low, high = ball.ends(c_x, NORMAL) + constant - c_x @ unknown.prior
        if not np.isfinite(high - low):
            raise IdentificationError(
                "the range of a force was not found: the solver did not reach its optimum",
                where="--logs",
                cure="check that these are the recordings that the model was identified from",
            )
        return Range(min(float(low), value), max(float(high), value))

    def _level(self, c_u: Float[np.ndarray, " n"]) -> float:
        """σ_c: white noise of this level makes the force as uncertain as the recorded noise does.

        With the Hessian H of data and prior, noise changes c·u by c H⁻¹ (K A)ᵀ R_Bᵀ s, where s are
        the scores of the base parameters' least squares (`scatter`) and R_B its root. Errors of
        geometry act like scores R_B δp_B.
        """
        U = (self._scores @ c_u)[:, None]
        if (size := float(np.linalg.norm(U))) == 0:
            return self._white
        by_noise, nu = self._noise.deviations(U)
        std = np.hypot(by_noise, np.linalg.norm(U.T @ self._noise.root @ self._shifts, axis=1))
        return max(float(half_width(std, by_noise, nu)[0]) / (NORMAL * size), FAINT)

    @cached_property
    def _scores(self) -> Float[np.ndarray, "base n"]:
        """R_B K A H⁻¹, up to a constant factor."""
        n = len(self._known.unknowns.names)
        root = triangle(np.vstack([self._data[:, :n] / self._white, np.eye(n)]))
        half = solve_triangular(root, np.eye(n))
        return self._noise.root @ self._known.rows @ half @ half.T
