"""Accuracy of identified parameters in the controller's terms (Sec. VII), the paper's claims, and
the dependence on the regularisation's weight γ_p/γ_τ."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.objective import Objective, Vector
from deltaid.identification.demo import mass_reference
from deltaid.motion.surrogate import Motion


@dataclass(frozen=True)
class DriveMotion:
    """Samples of a motion in drive coordinates; time in s."""

    time: Float[np.ndarray, " samples"]
    q: Float[np.ndarray, "samples dof"]
    qd: Float[np.ndarray, "samples dof"]
    qdd: Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class MotionTerms:
    """The terms of (1) along a motion.

    Attributes:
        M: mass matrix.
        coriolis, acceleration, friction: C q̇, M q̈ and f [N m].
    """

    M: Float[np.ndarray, "samples dof dof"]
    coriolis: Float[np.ndarray, "samples dof"]
    acceleration: Float[np.ndarray, "samples dof"]
    friction: Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class Accuracy:
    """Largest errors of identified terms at any time of a motion, as shares.

    Attributes:
        mass: of each entry of M, relative to its mean along the motion (Sec. VII), see
            `identification.demo.mass_reference`.
        coriolis, acceleration, friction: of each drive's torque C q̇, M q̈ and f, relative to the
            largest true one of the same kind and drive.
        coefficients: relative errors of the friction coefficients, with sign.
        definite: number of samples at which M is positive definite, so has a Cholesky factor.
        samples: number of all samples.
    """

    mass: Float[np.ndarray, "dof dof"]
    coriolis: Float[np.ndarray, " dof"]
    acceleration: Float[np.ndarray, " dof"]
    friction: Float[np.ndarray, " dof"]
    coefficients: Float[np.ndarray, " coefficients"]
    definite: int
    samples: int

    @property
    def mass_diagonal(self) -> float:
        """Largest relative error of an entry on M's diagonal."""
        return float(np.diag(self.mass).max())

    @property
    def mass_off_diagonal(self) -> float:
        """Largest relative error of an entry off M's diagonal."""
        return float(self.mass[~np.eye(len(self.mass), dtype=bool)].max())

    @property
    def friction_coefficients(self) -> float:
        """Largest relative error of a friction coefficient."""
        return float(np.abs(self.coefficients).max())


def drive_motion(
    dynamics: Dynamics, motion: Motion, time: Float[np.ndarray, " samples"]
) -> DriveMotion:
    """A motion sampled at some times.

    Raises:
        KinematicsError: the motion leaves the workspace.
    """
    return DriveMotion(time, *dynamics.kinematics.drive_motion(*motion.evaluate(time)))


def motion_terms(dynamics: Dynamics, along: DriveMotion, p: Parameters) -> MotionTerms:
    """The terms of (1) with parameters p along a motion."""
    terms = dynamics.terms(along.q, along.qd, p)
    return MotionTerms(
        M=terms.M,
        coriolis=np.einsum("nij,nj->ni", terms.C, along.qd),
        acceleration=np.einsum("nij,nj->ni", terms.M, along.qdd),
        friction=terms.f,
    )


def accuracy(dynamics: Dynamics, along: DriveMotion, truth: Parameters, p: Parameters) -> Accuracy:
    """Errors of parameters p along a motion, relative to the truth."""
    true, own = motion_terms(dynamics, along, truth), motion_terms(dynamics, along, p)
    layout = dynamics.layout
    return Accuracy(
        mass=np.abs(own.M - true.M).max(axis=0) / mass_reference(true.M),
        coriolis=_share(own.coriolis, true.coriolis),
        acceleration=_share(own.acceleration, true.acceleration),
        friction=_share(own.friction, true.friction),
        coefficients=p[layout.friction] / truth[layout.friction] - 1,
        definite=int(np.sum(np.linalg.eigvalsh(own.M)[:, 0] > 0)),
        samples=len(along.time),
    )


def _share(
    values: Float[np.ndarray, "samples dof"], true: Float[np.ndarray, "samples dof"]
) -> Float[np.ndarray, " dof"]:
    return np.abs(values - true).max(axis=0) / np.abs(true).max(axis=0)


@dataclass(frozen=True)
class Claim:
    """An error that the paper states.

    Attributes:
        quantity: in words.
        measure: attribute of `Accuracy`.
        share: as a number.
        words: as the paper writes it.
        place: in Sec. VII.
    """

    quantity: str
    measure: str
    share: float
    words: str
    place: str

    def value_of(self, accuracy: Accuracy) -> float:
        """The same quantity of a result of this package, the largest over all drives."""
        return float(np.max(getattr(accuracy, self.measure)))


CLAIMS = (
    Claim("M on the diagonal", "mass_diagonal", 0.01, "below 1 %", "at Fig. 4"),
    Claim("M off the diagonal", "mass_off_diagonal", 0.02, "about 2 %", "at Fig. 4"),
    Claim("Coriolis C q̇", "coriolis", 0.01, "less than 1 %", "at Figs. 5 and 6"),
    Claim("acceleration M q̈", "acceleration", 0.01, "less than 1 %", "at Figs. 5 and 6"),
    Claim("friction coefficients", "friction_coefficients", 0.022, "under 2.2 %", "at Fig. 3"),
)


@dataclass(frozen=True)
class SweepPoint:
    """Accuracy of the global optimum at one γ."""

    gamma: float
    objective: float
    accuracy: Accuracy


def sweep(
    objective: Objective, judge: Callable[[Vector], Accuracy], gammas: Iterable[float]
) -> tuple[SweepPoint, ...]:
    """Fits of the same data and prior with each γ; those without a certified optimum are dropped.

    Args:
        judge: accuracy of free variables x.
    """
    points = []
    for gamma in gammas:
        with suppress(IdentificationError):
            solution = Conic().solve(replace(objective, gamma=gamma))
            points.append(SweepPoint(gamma, solution.objective, judge(solution.x)))
    return tuple(points)
