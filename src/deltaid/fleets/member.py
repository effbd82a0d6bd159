"""One robot's contribution to its type: rows of unit noise that condense its recordings.

Least squares gives base parameters y of a robot, y = K p + e. The covariance of e comes from the
scatter between groups of samples, as for intervals, and from tolerances of each machine's geometry.
With its Cholesky factor L, the rows L⁻¹K p = L⁻¹y have unit noise. Unknowns of the recordings, such
as loads, are eliminated.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from io import BytesIO
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.checksum import require_intact, sealed_archive
from deltaid.errors import RecordingError
from deltaid.estimation.information import triangle
from deltaid.estimation.scatter import inverse
from deltaid.fleets.place import MADE_AGAIN
from deltaid.fleets.robot_recordings import RobotRecordings, fitted
from deltaid.levels import NEGLIGIBLE
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.sensors.weighings import weighings

# Arrays of a member's file; everything else in it is JSON.
_ARRAYS = ("rows", "values", "shared")
# Words in the names of geometric quantities that differ between machines. Other lengths belong to
# several limbs: their errors are in the drawing, and common to all machines of a type.
_OWN = ("zero of", "tilt about", "torque constant", " of limb ")


@dataclass(frozen=True, eq=False)
class MeasuredFact:
    """A measured value of the robot: cᵀp = v ± σ.

    Attributes:
        key: equal for the same measurement in two descriptions.
        coefficients: c, over the member's parameters.
    """

    key: str
    coefficients: Float[np.ndarray, " parameters"]
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class TypeMember:
    """Rows and facts of one robot.

    Attributes:
        names: of its parameters p.
        rows, values: rows · p = values, with independent unit noise.
        shared: effect on the rows of geometric quantities common to all machines, for one standard
            deviation of each.
        quantities: names of these.
        freedom: degrees of freedom of the noise level.
        facts: measured values in its description.
        widened: entries whose prior its recordings contradict, with the factor of the spread.
    """

    name: str
    names: tuple[str, ...]
    rows: Float[np.ndarray, "rows parameters"]
    values: Float[np.ndarray, " rows"]
    shared: Float[np.ndarray, "rows quantities"]
    quantities: tuple[str, ...]
    freedom: float
    facts: tuple[MeasuredFact, ...] = ()
    widened: Mapping[str, float] | None = None

    @property
    def visible(self) -> set[str]:
        """Parameters that its rows or facts depend on."""
        every = np.vstack([self.rows, *(fact.coefficients for fact in self.facts)])
        return {self.names[k] for k in np.flatnonzero(np.any(every != 0, axis=0))}


def member(name: str, recordings: RobotRecordings, settings: Settings) -> TypeMember:
    """Build a member from recordings of one robot. Measured values in its description are of this
    robot, unless other robots have the same.

    Raises:
        IdentificationError: the fit cannot be posed or did not converge.
    """
    chosen = recordings.merging.dynamics.robot
    problem = fitted(recordings, unmeasured(chosen), settings)
    # The error of least squares is R⁻¹ s, with the deviations of s from intervals. For white noise
    # s is uncorrelated, and groups are too few to estimate correlations.
    estimate, count, shifts = problem.estimate, len(problem.p), problem.geometry.shifts
    noise = estimate.noise
    half = inverse(noise.root) * noise.deviations(np.eye(len(noise.root)))[0]
    names = problem.geometry.names
    common = np.array([not any(word in name for word in _OWN) for name in names], dtype=bool)
    covariance = half @ half.T + shifts[:, ~common] @ shifts[:, ~common].T
    size = np.sqrt(np.diag(covariance))
    L = np.linalg.cholesky(covariance / np.outer(size, size) + NEGLIGIBLE * np.eye(len(size)))
    K = problem.base.combination()
    wide = np.column_stack([K[:, count:], K[:, :count], shifts[:, common], estimate.values])
    rows = solve_triangular(L, wide / size[:, None], lower=True)
    rows = eliminated(rows, K.shape[1] - count)
    return TypeMember(
        name=name,
        names=problem.layout.names[:count],
        rows=rows[:, :count],
        values=rows[:, -1],
        shared=rows[:, count:-1],
        quantities=tuple(np.array(names, dtype=str)[common].tolist()),
        freedom=float(np.median(estimate.by_noise[1])),
        facts=tuple(
            MeasuredFact(
                f"{row.where} {row.name} {row.value:.9g} {row.std:.9g}",
                row.coefficients,
                row.value,
                row.std,
            )
            for row in weighings(chosen)
        ),
        widened=dict(problem.reduction.widened),
    )


def eliminated(
    rows: Float[np.ndarray, "rows columns"], count: int
) -> Float[np.ndarray, "left rest"]:
    """Rows with their first columns projected out."""
    if not count or not len(rows):
        return rows[:, count:]
    U, singular, _ = np.linalg.svd(rows[:, :count])
    rank = int(np.sum(singular > NEGLIGIBLE * max(singular[0], 1.0)))
    return triangle(U[:, rank:].T @ rows[:, count:])


def unmeasured(robot: RobotDescription) -> RobotDescription:
    return robot.changed(
        bodies={name: body.changed(measured=()) for name, body in robot.bodies.items()},
        measured=(),
    )


def member_bytes(member: TypeMember) -> bytes:
    known = asdict(member)
    arrays = {key: known.pop(key) for key in _ARRAYS}
    text = json.dumps(known, default=np.ndarray.tolist)
    return sealed_archive(known=np.array(text), **arrays)


def read_member(data: bytes, where: str) -> TypeMember:
    """The member of an archive.

    Raises:
        RecordingError: it is damaged.
    """
    require_intact(data, where, RecordingError, MADE_AGAIN)
    with np.load(BytesIO(data), allow_pickle=False) as file:
        known: dict[str, Any] = json.loads(str(file["known"]))
        arrays = {key: file[key] for key in _ARRAYS}
    known["facts"] = tuple(
        MeasuredFact(**fact | {"coefficients": np.array(fact["coefficients"])})
        for fact in known["facts"]
    )
    known |= {key: tuple(known[key]) for key in ("names", "quantities")}
    return TypeMember(**known, **arrays)
