"""Whole friction curves with their intervals, constants of the laws counted as unknown.

A law's speeds and exponents are not linear, so what a fit finds of coefficients alone is too sure
of the curve. Its changes with the logarithms x of these constants are further columns of the fit,

    τ_friction ≈ Σ c_k h_k(v) + Σ c_j ∂h_j/∂x_j δx_j,

and the curve at a speed is one combination of all of them. In the fit itself constants stay what
they were refined to (δx = 0), for a hardly known constant would leave the linear
range; whoever judges the fit takes δx as free (`freed`).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import joints_of
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.posing import pose
from deltaid.estimation.reduction import build_reduction, free_coefficients
from deltaid.identification.doubts import constants
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.parameter_record import FrictionCurve
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import PriorParameter

# Speeds of a curve each way: so many, from this share of the fastest.
_POINTS, _SLOWEST = 15, 0.02

Speeds = Float[np.ndarray, " speeds"]


@dataclass(frozen=True, eq=False)
class LawConstants(Addition):
    """Changes of a robot's friction with the constants of its laws, in logarithms."""

    dynamics: Dynamics
    is_held = True  # the constants are those of the law

    @property
    def constants(self) -> tuple[tuple[FrictionTerm, str], ...]:
        """Each term that has constants, with the name of one."""
        terms = self.dynamics.robot.friction_terms
        return tuple((term, name) for term in terms for name in term.constants)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """One logarithm each, whose prior is that of the law."""
        return tuple(
            PriorParameter("constant", t.joint, f"{t.kind}_{name}", "1", -np.inf, np.inf, 0.0, 1.0)
            for t, name in self.constants
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the joints' Coulomb friction acts."""
        joints = {joint.name: joint for joint in joints_of(self.dynamics)}
        drives = [joints[term.joint].drives for term, _ in self.constants]
        columns = np.repeat(np.arange(len(drives)), [len(entries) for entries in drives])
        return np.concatenate([np.zeros(0, dtype=int), *drives]), columns

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        """size ∂φ/∂x times the Coulomb column, with the described size of the term."""
        joints, values = {joint.name: joint for joint in joints_of(self.dynamics)}, [own[:0]]
        for term, name in self.constants:
            joint = joints[term.joint]
            values.append(term.size * term.slopes(joint.speed(own))[name] * own[joint.coulomb])
        return np.vstack(values)

    def on(self, dynamics: Dynamics) -> "LawConstants":
        return LawConstants(dynamics)


def freed(problem: FittedProblem) -> FittedProblem:
    """A fit to be judged: its result, with what it holds unknown, such as constants of laws."""
    if not any(addition.is_held for addition in problem.additions):
        return problem
    added = [
        (extra.parameters, free_coefficients(extra.parameters) if extra.is_held else extra.free)
        for extra in problem.additions
    ]
    robot, information, settings = problem.dynamics.robot, problem.information, problem.settings
    reduction = build_reduction(robot, information.columns, added, settings.prior_spread)
    reduction = replace(reduction, widened=problem.reduction.widened)
    known = dict(zip(problem.reduction.names, problem.solution.x.tolist(), strict=True))
    x = np.array([known.get(name, 0.0) for name in reduction.names])
    objective = pose(information, reduction, settings)
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
    robot, curves = problem.dynamics.robot, list[FrictionCurve]()
    tops = dict(zip(robot.drives, fastest.tolist(), strict=True))
    offsets = constants(problem)  # of friction, which may be those of what was measured
    for joint in robot.friction_joints:
        top = tops.get(joint, robot.platform_speed)
        if top <= 0:
            continue
        v = np.geomspace(_SLOWEST * top, top, _POINTS)
        v = np.concatenate([-v[::-1], v])
        rows = curve_rows(problem, joint, v)
        half = uncertainty(problem, rows).interval + abs(offsets.get(joint, 0.0))
        curves.append(
            FrictionCurve(
                joint=joint,
                speed=tuple(v.tolist()),
                friction=tuple((rows @ problem.values).tolist()),
                half_width=tuple(half.tolist()),
            )
        )
    return tuple(curves)


def curve_rows(
    problem: FittedProblem, joint: str, v: Speeds
) -> Float[np.ndarray, "speeds parameters"]:
    """The combinations of a fit's parameters that are the friction of a joint at some speeds."""
    names = problem.layout.names
    rows = np.zeros((len(v), len(names)))
    for term in problem.dynamics.robot.friction_terms:
        if term.joint == joint and not term.of_load:
            rows[:, names.index(term.name)] = term.values(v)
    for extra in problem.additions:
        if isinstance(extra, LawConstants):
            for (term, name), parameter in zip(extra.constants, extra.parameters, strict=True):
                if term.joint == joint:
                    rows[:, names.index(parameter.name)] = term.size * term.slopes(v)[name]
    return rows
