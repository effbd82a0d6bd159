"""Constants of friction laws, such as Stribeck's speed, fitted together with all coefficients.

Gauss–Newton: with a term's change by the logarithms of its constants as further columns, everything
is linear; coefficients stay positive by bounded least squares, logarithms of constants have a
prior, and each step is limited. Rigid bodies and lags are free, and so projected out.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.effects.contest import surprise
from deltaid.effects.joint import Joint, Shape, of_load, one_way, one_way_speed
from deltaid.estimation.information import triangle
from deltaid.estimation.span import Rows, lengths
from deltaid.identification.friction_options import FORMS, of_slope, of_term
from deltaid.identification.friction_rows import FrictionRows
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import EXPONENTS, Friction
from deltaid.robot.friction_terms import FrictionTerm

# Steps at most, the largest of a logarithm, and the one below which constants have settled.
_STEPS, _LARGEST, _SETTLED = 12, 0.4, 1e-3
# Decades by which chance must be unlikely before exponents are none of the usual ones.
_OTHER = 3.5
# Standard deviation of a logarithm about where the grid found it.
_SPREAD = 1.0
# Stribeck's speed stays within these shares of the joint's fastest.
_SPEEDS = (0.003, 3.0)
# How strongly the prior pulls at columns of unit length: only what is dependent feels it.
_PULL = 1e-6
# A term's prior is at least this share of Coulomb's.
_SMALL = 0.02

Laws = Mapping[str, Friction]


@dataclass(frozen=True, eq=False)
class Refined:
    """Laws with refined constants.

    Attributes:
        laws: of the joints that were touched; priors of what was added are what was found of it.
        left: of the rows.
    """

    laws: dict[str, Friction]
    left: Rows


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def refined(rows: FrictionRows, laws: Laws) -> Refined:
    """Laws with the constants that fit best.

    The exponents of Stribeck's terms that were added are those of one of its two usual forms, for
    all joints the same, unless other ones explain more than chance: how the term falls is seen
    worst of all, and what is left open makes the rest of the curve less certain.

    Args:
        rows: of a robot as it is described.
        laws: of the joints whose constants are to be fitted.
    """
    free = _refined(rows, laws, frozenset())
    described = rows.dynamics.robot.friction
    added = frozenset(
        joint for joint, law in laws.items()
        if law.stribeck is not None and described[joint].stribeck is None
    )  # fmt: skip
    if not added:
        return free
    tried = [_refined(rows, _of_form(laws, added, form), added) for form in FORMS]
    best = min(tried, key=lambda one: float(one.left @ one.left))
    level = float(free.left @ free.left) / max(len(free.left) - rows.span.rank, 1)
    more = float(best.left @ best.left - free.left @ free.left) / level
    return best if surprise(max(more, 0.0), len(added)) < _OTHER else free


def _of_form(laws: Laws, joints: Iterable[str], form: float) -> Laws:
    """Laws with Stribeck's terms of one form."""
    changed = dict(laws)
    for joint in joints:
        term = changed[joint].stribeck
        if term is not None:
            changed[joint] = changed[joint].changed(stribeck=term.changed(exponent=form))
    return changed


def _refined(rows: FrictionRows, laws: Laws, usual: frozenset[str]) -> Refined:
    """Laws with the constants that fit best; Stribeck's exponents of some joints stay."""
    described, gone = rows.dynamics.robot.friction, dict[_Constant, float]()
    fitted = _fit(rows, laws, gone, usual)
    for _ in range(_STEPS):
        if max((abs(step) for step in fitted.steps.values()), default=0.0) < _SETTLED:
            break
        now = dict(laws)
        for one, step in fitted.steps.items():
            joint, kind, name = one
            limited = _limited(rows, now[joint], one, step)
            gone[one] = gone.get(one, 0.0) + limited
            now[joint] = moved(now[joint], kind, name, limited)
        laws = now
        fitted = _fit(rows, laws, gone, usual)
    found = dict(laws)
    for term in fitted.terms:
        law = found.get(term.joint)
        if law is not None and getattr(described[term.joint], term.kind) is None:
            size = max(abs(fitted.values[term.name]), _SMALL * _unit(term, law))
            prior = {"offset": size} if term.signed else term.in_law(size)
            found[term.joint] = law.changed(**prior)
    return Refined(found, fitted.left)


# Joint, kind of term, name of the constant.
_Constant = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class _Fit:
    terms: tuple[FrictionTerm, ...]
    values: dict[str, float]
    steps: dict[_Constant, float]
    left: Rows


def _fit(
    rows: FrictionRows, laws: Laws, gone: Mapping[_Constant, float], usual: frozenset[str]
) -> _Fit:
    """Coefficients of all terms, and steps of the logarithms of constants.

    Args:
        gone: how far these have come.
        usual: joints whose Stribeck terms keep their exponents.
    """
    described = rows.dynamics.robot
    robot = described.changed(friction=dict(described.friction) | dict(laws))
    terms = robot.friction_terms
    curved = [t for t in terms if t.joint in laws and t.constants]
    open_ = [
        (t, name) for t in curved for name in t.constants
        if not (name == "exponent" and t.kind == "stribeck" and t.joint in usual)
    ]  # fmt: skip
    constants = [(t.joint, t.kind, name) for t, name in open_]
    columns = rows.rigid.without(_columns(rows, robot))
    tau = rows.rigid.without(rows.tau)
    low, high = np.array([t.low for t in terms]), np.array([t.high for t in terms])
    priors = np.array([t.parameter.prior for t in terms])
    first = _bounded(columns, tau, low, high, priors)
    values = dict(zip([term.name for term in terms], first.tolist(), strict=True))
    left = tau - columns @ first
    if not constants:
        return _Fit(terms, values, {}, left)
    joints = {joint.name: joint for joint in rows.joints}
    wanted = [(joints[t.joint], of_slope(t, name)) for t, name in open_]
    sizes = np.array([values[t.name] for t, _ in open_])
    slopes = rows.rigid.without(rows.columns(wanted) * sizes)
    prior = np.hstack([np.zeros((len(constants), len(terms))), np.eye(len(constants)) / _SPREAD])
    A = np.vstack([np.hstack([columns, slopes]), prior])
    b = np.concatenate([tau, [-gone.get(one, 0.0) / _SPREAD for one in constants]])
    limit = np.full(len(constants), _LARGEST)
    priors = np.append(priors, np.zeros(len(constants)))
    x = _bounded(A, b, np.append(low, -limit), np.append(high, limit), priors)
    steps = dict(zip(constants, x[len(terms) :].tolist(), strict=True))
    return _Fit(terms, values, steps, left)


def _columns(rows: FrictionRows, robot: RobotDescription) -> np.ndarray:
    """One column for each friction term of a robot, whose laws are those described but for some."""
    described = rows.dynamics.robot
    own = set(described.friction_terms)
    joints = {joint.name: joint for joint in rows.joints}
    made: list[tuple[Joint, Shape]] = []
    places: dict[str, int] = {}
    for term in robot.friction_terms:
        if term not in own and term.kind not in ("viscous", "coulomb"):
            places[term.name] = len(made)
            made.append((joints[term.joint], _shape(term)))
    further = rows.columns(made) if made else np.zeros((len(rows.tau), 0))
    columns = []
    for term in robot.friction_terms:
        if term in own:
            columns.append(rows.own(term.name))
        elif term.name in places and not term.kind.endswith("_back"):
            columns.append(further[:, places[term.name]])
        else:  # one direction of what is described of both
            both = term.kind.removesuffix("_back")
            way = further[:, places[f"{both}_back.{term.joint}"]]
            sign = -1 if term.kind.endswith("_back") else 1
            columns.append(0.5 * (rows.own(f"{both}.{term.joint}") + sign * way))
    return np.column_stack(columns)


def _shape(term: FrictionTerm) -> Shape:
    """The column of a term; for one direction's, what both directions have in common."""
    simple = {
        "offset": one_way,
        "coulomb_back": one_way,
        "viscous_back": one_way_speed,
        "load": of_load,
    }
    return simple.get(term.kind) or of_term(term)


def _bounded(
    A: Float[np.ndarray, "rows n"],
    b: Rows,
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """min ‖A x − b‖ over low ≤ x ≤ high, columns at unit length; near the prior where these are
    dependent, as all friction and gains beside it are."""
    from scipy.optimize import lsq_linear  # slow to load, and seldom needed

    norms = lengths(A)
    pulled = np.vstack([A / norms, _PULL * np.eye(A.shape[1])])
    R = triangle(np.column_stack([pulled, np.append(b, _PULL * norms * prior)]))
    return lsq_linear(R[:, :-1], R[:, -1], (low * norms, high * norms)).x / norms


def _limited(rows: FrictionRows, law: Friction, one: _Constant, step: float) -> float:
    """A step that leaves a speed within its limits."""
    joint, kind, name = one
    if name != "speed":
        return step
    fastest = next(j.fastest for j in rows.joints if j.name == joint)
    low, high = (float(np.log(x * fastest / getattr(law, kind).speed)) for x in _SPEEDS)
    return float(np.clip(step, low, high))


def _unit(term: FrictionTerm, law: Friction) -> float:
    """A coefficient that makes the term about as large as Coulomb's friction."""
    return 1.0 if term.kind == "load" else term.size if term.kind == "power" else law.coulomb


def moved(law: Friction, kind: str, name: str, step: float) -> Friction:
    """A law with one constant of a term multiplied by e^step, exponents within their limits."""
    part = getattr(law, kind)
    value = float(getattr(part, name) * np.exp(step))
    if name == "exponent":
        value = float(np.clip(value, *EXPONENTS))
    return law.changed(**{kind: part.changed(**{name: value})})
