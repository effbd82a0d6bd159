"""Whole friction curves with their intervals, constants of the laws counted as unknown.

A law's speeds and exponents are not linear, so what a fit finds of coefficients alone is too sure
of the curve. Its changes with the logarithms x of these constants are further columns of the fit,

    τ_friction ≈ Σ c_k h_k(v) + Σ c_j ∂h_j/∂x_j δx_j,

and the curve at a speed is one combination of all of them. In the fit itself constants stay what
they were refined to (δx = 0), for a constant that is hardly known would run off far beyond what is
linear; whoever judges the fit takes δx as free (`freed`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import entry_speeds
from deltaid.estimation.additions import Addition, Values
from deltaid.estimation.free_body import free_coefficients
from deltaid.estimation.objective import data_term
from deltaid.estimation.posing import METRICS
from deltaid.estimation.reduction import build_reduction
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.friction_record import FrictionCurve
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import Parameter

# Speeds of a curve each way: so many, from this share of the fastest.
_POINTS, _SLOWEST = 15, 0.02

Further = Float[np.ndarray, "further samples"]
Speeds = Float[np.ndarray, " speeds"]


@dataclass(frozen=True, eq=False)
class LawConstants(Addition):
    """Changes of a robot's friction with the constants of its laws, in logarithms.

    Attributes:
        dynamics: of the robot.
    """

    dynamics: Dynamics

    @property
    def constants(self) -> tuple[tuple[FrictionTerm, str], ...]:
        """Each term that has constants, with the name of one."""
        terms = self.dynamics.robot.friction_terms
        return tuple((term, name) for term in terms for name in term.constants)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One logarithm each, whose prior is what the law says."""
        return tuple(
            Parameter("constant", t.joint, f"{t.kind}_{name}", "1", -np.inf, np.inf, 0.0, 1.0)
            for t, name in self.constants
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the joints' Coulomb friction acts."""
        rows, _ = self.dynamics.regressor_pattern
        places = [self._coulomb(term.joint) for term, _ in self.constants]
        columns = [np.full(len(at), k) for k, at in enumerate(places)]
        return rows[np.concatenate(places)], np.concatenate(columns)

    def entries(self, w: Samples, own: Values, recording: Recording) -> Further:
        """size ∂φ/∂x times the Coulomb column, with the described size of the term."""
        found = []
        for term, name in self.constants:
            steps = own[self._coulomb(term.joint)]
            v = entry_speeds(own[self._entries(f"viscous.{term.joint}")], steps)
            found.append(term.size * term.slopes(v)[name] * steps)
        return np.vstack(found)

    def on(self, dynamics: Dynamics) -> "LawConstants":
        return LawConstants(dynamics)

    @property
    def is_held(self) -> bool:
        return True  # the constants are those of the law

    def _coulomb(self, joint: str) -> np.ndarray:
        return self._entries(f"coulomb.{joint}")

    def _entries(self, name: str) -> np.ndarray:
        _, columns = self.dynamics.regressor_pattern
        return np.flatnonzero(columns == self.dynamics.layout.names.index(name))


def law_constants(additions: Sequence[Addition]) -> LawConstants | None:
    """Those among additions."""
    found = [one for one in additions if isinstance(one, LawConstants)]
    return found[0] if found else None


def freed(problem: FittedProblem) -> FittedProblem:
    """A fit to be judged: its result, with what it holds unknown, such as constants of laws."""
    if not any(one.is_held for one in problem.additions):
        return problem
    free = [
        free_coefficients(one.parameters) if one.is_held else one.free for one in problem.additions
    ]
    added = [(one.parameters, own) for one, own in zip(problem.additions, free, strict=True)]
    information = problem.information
    reduction = replace(
        build_reduction(
            problem.dynamics.robot, information.columns, added, problem.settings.prior_spread
        ),
        widened=problem.reduction.widened,
    )
    objective = replace(
        problem.objective,
        reduction=reduction,
        data=data_term(information, reduction),
        regularizer=METRICS[problem.settings.regularizer].regularizer(reduction),
    )
    known = dict(zip(problem.reduction.names, problem.solution.x.tolist(), strict=True))
    x = np.array([known.get(name, 0.0) for name in reduction.names])
    return replace(problem, objective=objective, solution=replace(problem.solution, x=x))


def friction_curves(
    problem: FittedProblem, fastest: Float[np.ndarray, " dof"]
) -> tuple[FrictionCurve, ...]:
    """The friction of each joint that moves over its speed, with 95 % intervals.

    Without what depends on load.

    Args:
        fastest: largest speed of each drive in the recordings [rad/s or m/s].
    """
    problem = freed(problem)
    robot, curves = problem.dynamics.robot, list[tuple[str, Speeds]]()
    for joint in robot.friction_joints:
        top = robot.platform_speed
        if joint in robot.drives:
            top = float(fastest[robot.drives.index(joint)])
        if top > 0:
            v = np.geomspace(_SLOWEST * top, top, _POINTS)
            curves.append((joint, np.concatenate([-v[::-1], v])))
    rows = [curve_rows(problem, joint, v) for joint, v in curves]
    if not rows:
        return ()
    half = uncertainty(problem, np.vstack(rows)).interval
    ends = np.cumsum([0, *(len(v) for _, v in curves)])
    return tuple(
        FrictionCurve(
            joint=joint,
            speed=tuple(v.tolist()),
            friction=tuple((part @ problem.values).tolist()),
            half_width=tuple(half[start:stop].tolist()),
        )
        for (joint, v), part, (start, stop) in zip(curves, rows, pairwise(ends), strict=True)
    )


def curve_rows(
    problem: FittedProblem, joint: str, v: Speeds
) -> Float[np.ndarray, "speeds parameters"]:
    """The combinations of a fit's parameters that are the friction of a joint at some speeds."""
    names = problem.layout.names
    rows = np.zeros((len(v), len(names)))
    for term in problem.dynamics.robot.friction_terms:
        if term.joint == joint and not term.of_load:
            rows[:, names.index(term.name)] = term.values(v)
    one = law_constants(problem.additions)
    if one is None:
        return rows
    for (term, name), parameter in zip(one.constants, one.parameters, strict=True):
        if term.joint == joint:
            at = names.index(parameter.name)
            rows[:, at] = term.size * term.slopes(v)[name]
    return rows
