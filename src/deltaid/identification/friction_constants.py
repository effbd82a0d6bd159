"""Constants of friction laws, such as Stribeck's speed, fitted together with all coefficients.

Gauss–Newton: additional columns are the slopes of terms by the logarithms of their constants.
Bounded least squares keeps coefficients positive, logarithms have a prior, and steps are limited.
Rigid bodies and lags are free, and so projected out.

The fit's intervals of friction curves count constants, such as speeds and exponents, as unknown:
with the logarithms x of these constants,

    τ_friction ≈ Σ c_k h_k(v) + Σ c_j ∂h_j/∂x_j δx_j,

and the curve at a speed is a combination of all coefficients. The fit itself holds δx = 0, for a
hardly known constant would leave the linear range; intervals take δx as free (`freed`).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.effects.joint import ONE_WAY, joints_of, of_slope, of_term
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import pose
from deltaid.estimation.problem import Rows, lengths
from deltaid.estimation.reduction import build_reduction, free_coefficients
from deltaid.estimation.scatter import NORMAL, surprise
from deltaid.identification.doubts import constants, undetected_constants
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_rows import FORMS, FrictionRows
from deltaid.identification.uncertainty import uncertainty
from deltaid.levels import FAINT, ROUNDS, SETTLED
from deltaid.model.parameter_record import FrictionCurve
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.friction import EXPONENTS, Friction
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import PriorParameter

# Largest step of a logarithm.
_LARGEST = 0.4
# Least surprise of an unusual result, such as an exponent that is none of the usual ones [decades].
SELDOM = 3.5
# Prior standard deviation of a logarithm about the mean of alike drives; about its start it is 1.
_UNLIKE = 0.25
# Range of Stribeck's speed, as shares of the joint's largest.
_SPEEDS = (0.003, 3.0)
# Least speed of a curve as a share of the largest; least prior of a term as a share of Coulomb's.
_SMALL = 0.02

# Joint, kind of term, name of the constant.
_Constant = tuple[str, str, str]
Speeds = Float[np.ndarray, " speeds"]


@dataclass(frozen=True, eq=False)
class Refined:
    """Changed laws, with estimates as priors of added terms."""

    laws: dict[str, Friction]
    residual: Rows

    @property
    def squares(self) -> float:
        return float(self.residual @ self.residual)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def refined(rows: FrictionRows, laws: Mapping[str, Friction]) -> Refined:
    """Laws of some joints with the constants that fit best.

    All added Stribeck terms have the exponent of one of the two usual forms, unless others explain
    more than chance: the exponent is hardly identifiable, and a free one makes the rest of the
    curve less certain.
    """
    free, described = _refined(rows, laws, ()), rows.dynamics.robot.friction
    added = {
        joint: law.stribeck for joint, law in laws.items()
        if law.stribeck is not None and described[joint].stribeck is None
    }  # fmt: skip
    if not added:
        return free
    tried = list[Refined]()
    for form in FORMS:
        usual = {
            joint: laws[joint].changed(stribeck=term.changed(exponent=form))
            for joint, term in added.items()
        }
        tried.append(_refined(rows, dict(laws) | usual, added))
    best = min(tried, key=lambda trial: trial.squares)
    return best if surprise_of_more(rows, free, best, len(added)) < SELDOM else free


def surprise_of_more(rows: FrictionRows, more: Refined, less: Refined, freedom: int) -> float:
    """Surprise, for white noise, of what laws with more constants explain in addition [decades]."""
    level = more.squares / max(len(rows.tau) - rows.span.rank, 1)
    return surprise(max(less.squares - more.squares, 0.0) / level, freedom)


def _refined(rows: FrictionRows, laws: Mapping[str, Friction], usual: Collection[str]) -> Refined:
    """Laws with the constants that fit best; Stribeck's exponents of `usual` joints stay."""
    current, travel = dict(laws), dict[_Constant, float]()
    coefficients, steps, residual = _fit(rows, current, travel, usual)
    for _ in range(ROUNDS):
        if max((abs(step) for step in steps.values()), default=0.0) < SETTLED:
            break
        for constant, step in steps.items():
            joint, kind, name = constant
            limited = step
            if name == "speed":
                share = getattr(current[joint], kind).speed / rows.joints[joint].fastest
                limited = float(np.clip(step, *np.log(np.array(_SPEEDS) / share)))
            travel[constant] = travel.get(constant, 0.0) + limited
            current[joint] = moved(current[joint], kind, name, limited)
        coefficients, steps, residual = _fit(rows, current, travel, usual)
    for term, value in coefficients.items():
        law, described = current.get(term.joint), rows.dynamics.robot.friction[term.joint]
        if law is not None and getattr(described, term.kind) is None:
            units = {"load": 1.0, "power": term.size}  # about as large as Coulomb's friction
            least = ONE_WAY if term.parameter.signed else _SMALL
            size = max(abs(value), least * units.get(term.kind, law.coulomb))
            prior = {"offset": size} if term.parameter.signed else term.in_law(size)
            current[term.joint] = law.changed(**prior)
    return Refined(current, residual)


def _fit(
    rows: FrictionRows,
    laws: Mapping[str, Friction],
    travel: Mapping[_Constant, float],
    usual: Collection[str],
) -> tuple[dict[FrictionTerm, float], dict[_Constant, float], Rows]:
    """Coefficients of all terms, steps of the logarithms of constants, and the residual without
    steps. `travel` is how far logarithms have moved; Stribeck's exponents of `usual` joints stay.
    """
    described, joints = rows.dynamics.robot, rows.joints
    terms = described.changed(friction=dict(described.friction) | dict(laws)).friction_terms
    before = set(described.friction_terms)
    added = iter(rows.columns([(joints[t.joint], of_term(t)) for t in terms if t not in before]).T)
    columns = [rows.column_of(t.name) if t in before else next(added) for t in terms]
    columns, tau = rows.rigid.without(np.column_stack(columns)), rows.rigid.without(rows.tau)
    low, high = np.array([t.low for t in terms]), np.array([t.high for t in terms])
    priors = np.array([t.parameter.prior for t in terms])
    first = _bounded(columns, tau, low, high, priors)
    coefficients, residual = dict(zip(terms, first.tolist(), strict=True)), tau - columns @ first
    constants: dict[_Constant, FrictionTerm] = {
        (t.joint, t.kind, name): t for t in terms if t.joint in laws for name in t.constants
        if not (name == "exponent" and t.kind == "stribeck" and t.joint in usual)
    }  # fmt: skip
    if not constants:
        return coefficients, {}, residual
    shapes = [(joints[joint], of_slope(t, name)) for (joint, _, name), t in constants.items()]
    sizes, n = np.array([coefficients[t] for t in constants.values()]), len(constants)
    slopes = rows.rigid.without(rows.columns(shapes) * sizes)
    travelled = np.array([travel.get(constant, 0.0) for constant in constants])
    values = np.log([getattr(t, name) for (_, _, name), t in constants.items()])
    unlike = _unlike(list(constants), described.identical_drives)
    prior = np.vstack([np.eye(n), unlike / _UNLIKE])
    A = np.vstack([np.hstack([columns, slopes]), np.hstack([np.zeros((2 * n, len(terms))), prior])])
    b = np.concatenate([tau, -travelled, -unlike @ values / _UNLIKE])
    bounds = np.append(low, np.full(n, -_LARGEST)), np.append(high, np.full(n, _LARGEST))
    x = _bounded(A, b, *bounds, np.append(priors, np.zeros(n)))
    return coefficients, dict(zip(constants, x[len(terms) :].tolist(), strict=True)), residual


def _unlike(constants: Sequence[_Constant], drives: Collection[str]) -> Float[np.ndarray, "n n"]:
    """Rows for the difference of each constant from the mean of those of alike drives."""
    places = [(kind, name, joint if joint not in drives else "") for joint, kind, name in constants]
    same = np.array([[other == place for other in places] for place in places])
    return np.eye(len(places)) - same / same.sum(axis=1, keepdims=True)


def _bounded(
    A: Float[np.ndarray, "rows n"],
    b: Rows,
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """min ‖A x − b‖ over low ≤ x ≤ high; near the prior where columns are dependent, such as those
    of friction and gains."""
    from scipy.optimize import lsq_linear  # slow to load, and seldom needed

    norms = lengths(A)
    pulled = np.vstack([A / norms, FAINT * np.eye(A.shape[1])])
    R = triangle(np.column_stack([pulled, np.append(b, FAINT * norms * prior)]))
    return lsq_linear(R[:, :-1], R[:, -1], (low * norms, high * norms)).x / norms


def moved(law: Friction, kind: str, name: str, step: float) -> Friction:
    """A law with one constant of a term multiplied by e^step, exponents within their limits."""
    part = getattr(law, kind)
    value = float(getattr(part, name) * np.exp(step))
    if name == "exponent":
        value = float(np.clip(value, *EXPONENTS))
    return law.changed(**{kind: part.changed(**{name: value})})


@dataclass(frozen=True, eq=False)
class LawConstants(Addition):
    """Changes of a robot's friction with the logarithms of its laws' constants."""

    is_held = True

    @property
    def constants(self) -> tuple[tuple[FrictionTerm, str], ...]:
        terms = self.dynamics.robot.friction_terms
        return tuple((term, name) for term in terms for name in term.constants)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
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
        joints, values = {joint.name: joint for joint in joints_of(self.dynamics)}, [own[:0]]
        for term, name in self.constants:
            joint = joints[term.joint]
            values.append(term.size * term.slopes(joint.speed(own))[name] * own[joint.coulomb])
        return np.vstack(values)


def freed(problem: FittedProblem) -> FittedProblem:
    """The fit with held coefficients, such as constants of laws, counted as unknown."""
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
    """Friction over the speed of each moving joint, without load friction, with 95 % intervals.

    Args:
        fastest: largest speed of each drive in the recordings [rad/s or m/s].
    """
    problem = freed(problem)
    robot, curves = problem.dynamics.robot, list[FrictionCurve]()
    tops = dict(zip(robot.drives, fastest.tolist(), strict=True))
    missed = undetected_constants(problem)
    offsets = constants(problem)  # of friction, which may be those of what was measured
    for joint in robot.friction_joints:
        top = tops.get(joint, robot.platform_speed)
        if top <= 0:
            continue
        v = np.geomspace(_SMALL * top, top, num=15)
        v = np.concatenate([-v[::-1], v])
        rows = curve_rows(problem, joint, v)
        half = uncertainty(problem, rows).interval + abs(offsets.get(joint, 0.0))
        half += NORMAL * missed.get(joint, 0.0)
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
