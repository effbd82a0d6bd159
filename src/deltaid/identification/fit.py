"""A fit: posed from recordings, solved, and kept with its evidence for intervals and doubts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.errors import IdentificationError, UnsettledFrictionError
from deltaid.estimation.additions import Addition
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.conic import SOLVERS, minimise
from deltaid.estimation.information import Information
from deltaid.estimation.objective import Objective, Solution, noise_level, pose
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.identification.gathering import Gathered, gather_balanced
from deltaid.identification.geometric_rows import Geometry, geometry
from deltaid.identification.least_squares import BaseEstimate, estimate_base
from deltaid.levels import CERTAIN, ROUNDS
from deltaid.model.record import Settings
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription

# Change of load friction's share below which it has settled; where loads change sign from round to
# round, it never settles below some 1e-5.
_SETTLED = 1e-4
CURE = (
    "likeliest a column counts the other way: check the sign of these torques and positions, then "
    "the order of the columns; deltaid check finds which"
)


@dataclass(frozen=True)
class Negative:
    """A drive that contradicts itself: M_ii at home, f_i at unit speed (NaN without friction)."""

    drive: str
    inertia: float
    friction: float


def against_motion(dynamics: Dynamics, information: Information) -> tuple[Negative, ...]:
    """Drives whose torques work against their motion, by a wrong sign or order of columns.

    Least squares over the rows of drive i alone, without prior and consistency, give its inertia
    M_ii at home and its friction at unit speed, f_i(1), both linear in p. In every machine both are
    positive. A wrong sign of τ_i or q_i makes them negative, whatever the other drives do.
    """
    negatives = []
    for i, drive in enumerate(dynamics.robot.drives):
        e = np.eye(dynamics.dof)[i]
        at_rest, quick, forth, back = (
            row_at_home(dynamics, i, qd, qdd)
            for qd, qdd in ((0 * e, 0 * e), (0 * e, e), (e, 0 * e), (-e, 0 * e))
        )
        # Coriolis forces at q̇ and −q̇ are equal.
        probes = np.stack([quick - at_rest, 0.5 * (forth - back)])
        # Columns of additions come last and have no part in it.
        added = max(0, int(information.columns[-1]) + 1 - probes.shape[1])
        probes = np.pad(probes, ((0, 0), (0, added)))[:, information.columns]
        problem = information.problem_of(i)
        values = probes @ problem.x
        stds = problem.noise * np.linalg.norm(probes @ problem.inverse, axis=1)
        certain = values / np.maximum(stds, np.finfo(float).tiny)
        if certain[np.argmax(np.abs(certain))] < -CERTAIN:
            friction = float(values[1]) if np.any(probes[1]) else np.nan
            negatives.append(Negative(drive, float(values[0]), friction))
    return tuple(negatives)


def contradiction(negatives: tuple[Negative, ...], robot: RobotDescription) -> str:
    """A sentence on the contradiction between torques and motion of these drives."""
    first, names = negatives[0], ", ".join(negative.drive for negative in negatives)
    units = robot.units(first.drive)
    text = f"an inertia of {first.inertia:.2g} {units.inertia}"
    if np.isfinite(first.friction):
        text += f" and a friction of {first.friction:.2g} {units.force} at 1 {units.coordinate}/s"
    whose = f", for {first.drive}," if len(negatives) > 1 else ""
    return (
        f"torque and motion of {names} contradict each other: alone they give{whose} {text}, which "
        "no robot has"
    )


def row_at_home(
    dynamics: Dynamics, i: int, qd: Float[np.ndarray, " dof"], qdd: Float[np.ndarray, " dof"]
) -> Float[np.ndarray, " parameters"]:
    """The row c with c p = τ_i at home for q̇ and q̈, without friction that depends on load."""
    home = dynamics.kinematics.home[None]
    return dynamics.regressor_at(home, qd[None], qdd[None], np.zeros_like(home))[0, i]


@dataclass(frozen=True)
class FittedProblem:
    """A fit with the data and settings it was posed from.

    Attributes:
        gathered: the recordings' information, in total, in stretches of time and by place.
        base: combinations of parameters that the motion determines.
        least_squares: their weighted least-squares values, without prior and consistency.
        additions: fitted with the robot.
        geometry: changes of base parameters by the robot's tolerances; empty at first.
        moves: changes of parameters, by name, by errors of corrected causes.
        undetected: the same by a constant of friction that its laws lack.
    """

    dynamics: Dynamics
    settings: Settings
    gathered: Gathered
    objective: Objective
    solution: Solution
    base: BaseParameters
    least_squares: BaseEstimate
    geometry: Geometry
    additions: tuple[Addition, ...] = ()
    moves: tuple[Mapping[str, float], ...] = ()
    undetected: Mapping[str, float] = field(default_factory=dict[str, float])

    @cached_property
    def estimate(self) -> BaseEstimate:
        """`least_squares` with intervals that include errors of geometry and corrected causes."""
        return replace(self.least_squares, shifts=self.geometry.shifts)

    @property
    def with_own_friction(self) -> "FittedProblem":
        """The fit with intervals for the case that its friction laws lack no constant: only then do
        torques of other parameters agree with those of the recording."""
        if not self.undetected:
            return self
        names, shifts = self.geometry.names[:-1], self.geometry.shifts[:, :-1]
        return replace(self, undetected={}, geometry=Geometry(names, shifts))

    @property
    def information(self) -> Information:
        return self.gathered.information

    @property
    def used(self) -> tuple[int, ...]:
        """Number of filtered samples of each recording, as a mean over the drives."""
        return tuple(
            round(sum(block.mean_samples for block in part)) for part in self.gathered.parts
        )

    @property
    def reduction(self) -> Reduction:
        return self.objective.reduction

    @property
    def layout(self) -> ParameterLayout:
        return self.reduction.layout

    @cached_property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """All fitted parameters, in the order of the layout: p, then those of additions."""
        return self.reduction.parameters(self.solution.x)

    @property
    def p(self) -> Float[np.ndarray, " own"]:
        return self.values[: len(self.values) - self.layout.added]

    @cached_property
    def noise(self) -> float:
        return noise_level(self.information)


def fit(
    dynamics: Dynamics,
    recordings: Sequence[PreparedRecording],
    settings: Settings,
    progress: Progress = lambda _: None,
    additions: Sequence[Addition] = (),
) -> FittedProblem:
    """Fit the parameters of a robot and of additions to recordings.

    Raises:
        IdentificationError: the fit cannot be posed, or the solver failed; with the drives whose
            torques and motion contradict each other, if that is why.
    """

    def posed_with(load: Parameters | None) -> FittedProblem:
        return posed(dynamics, recordings, settings, additions, load, progress)

    robot = dynamics.robot
    try:
        load = prior_parameters(robot) if robot.load_drives else None
        problem, is_settled = settled(posed_with, load)
        if not is_settled:
            raise UnsettledFrictionError(
                "friction that depends on load does not settle: the recording cannot separate it "
                "from the rest",
                cure="leave the load term out of the friction law of "
                + ", ".join(robot.load_drives),
            )
    except IdentificationError as error:
        where = error.where or ", ".join(str(recording.path) for recording in recordings)
        raise type(error)(error.what, where=where, cure=error.cure) from error
    return problem


def with_geometry(problem: FittedProblem, recordings: Sequence[PreparedRecording]) -> FittedProblem:
    """The fit with intervals that include the tolerances of the robot's geometry."""
    base, information = problem.base, problem.information
    geometric = geometry(
        problem.dynamics, recordings, base, information, problem.values, problem.additions
    )
    causes = [*problem.moves, *filter(None, [problem.undetected])]
    return replace(problem, geometry=geometric.with_causes(base, causes))


def settled(
    posed_with: Callable[[Parameters | None], FittedProblem], load: Parameters | None
) -> tuple[FittedProblem, bool]:
    """Repeat a fit with the loads of the one before, until load friction's shares settle.

    Returns the fit and whether they do. With `load` None, no friction depends on load, and one fit
    is enough.
    """
    rounds, step = 0, np.zeros(1)
    while True:
        problem, rounds = posed_with(load), rounds + 1
        if load is None:
            return problem, True
        shares = np.flatnonzero([term.of_load for term in problem.dynamics.robot.friction_terms])
        shares = shares + problem.dynamics.layout.friction.start
        before, step = step, problem.p[shares] - load[shares]
        if np.all(np.abs(step) <= _SETTLED):
            return problem, True
        if rounds == ROUNDS:
            return problem, False
        # Half a step where steps change direction: |x| is not smooth, and whole ones may oscillate.
        load = 0.5 * (load + problem.p) if np.sum(step * before) < 0 else problem.p


def posed(
    dynamics: Dynamics,
    recordings: Sequence[PreparedRecording],
    settings: Settings,
    additions: Sequence[Addition],
    load: Parameters | None,
    progress: Progress = lambda _: None,
) -> FittedProblem:
    """One round of a fit, with the torques of gears by parameters `load`; errors as of `fit`."""
    gathered = gather_balanced(dynamics, recordings, additions, load, progress)
    progress("fitting")
    return fit_to(gathered, dynamics, settings, additions)


def fit_to(
    gathered: Gathered,
    dynamics: Dynamics,
    settings: Settings,
    additions: Sequence[Addition] = (),
) -> FittedProblem:
    """A fit to gathered information; errors as of `fit`."""
    information = gathered.information
    added = [(addition.parameters, addition.free) for addition in additions]
    reduction = build_reduction(dynamics.robot, information.columns, added, settings.prior_spread)
    objective = pose(information, reduction, settings)
    try:
        solution = minimise(objective, SOLVERS[settings.method])
        reduction.parameters(solution.x)  # raises where they are not consistent
    except IdentificationError as error:
        wrong = against_motion(dynamics, information)
        if not wrong:
            raise
        message = f"no consistent robot moves like this: {contradiction(wrong, dynamics.robot)}"
        raise IdentificationError(message, cure=CURE) from error
    base = base_parameters(information, reduction.layout)
    return FittedProblem(
        dynamics=dynamics,
        settings=settings,
        gathered=gathered,
        objective=objective,
        solution=solution,
        base=base,
        least_squares=estimate_base(base, information, groups=gathered),
        geometry=Geometry.exact(base),
        additions=tuple(additions),
    )
