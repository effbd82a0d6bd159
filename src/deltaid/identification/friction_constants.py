"""Constants of friction laws, such as Stribeck's speed, fitted together with all coefficients.

Gauss–Newton: with a term's change by the logarithms of its constants as further columns, everything
is linear; coefficients stay positive by bounded least squares, logarithms of constants have a
prior, and each step is limited. Rigid bodies and lags are free, and so projected out.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.effects.joint import of_slope, of_term
from deltaid.estimation.information import triangle
from deltaid.estimation.problem import Rows, lengths
from deltaid.estimation.scatter import surprise
from deltaid.identification.friction_rows import FORMS, FrictionRows
from deltaid.robot.friction import EXPONENTS, Friction
from deltaid.robot.friction_terms import FrictionTerm

# Steps at most, the largest of a logarithm, and the one below which constants have settled.
_STEPS, _LARGEST, _SETTLED = 12, 0.4, 1e-3
# Decades by which chance must be unlikely before exponents are none of the usual ones.
_OTHER = 3.5
# Standard deviation of a logarithm about its value by the grid.
_SPREAD = 1.0
# Stribeck's speed stays within these shares of the joint's fastest.
_SPEEDS = (0.003, 3.0)
# Weight of the prior at columns of unit length: it only affects dependent ones.
_PULL = 1e-6
# A term's prior is at least this share of Coulomb's.
_SMALL = 0.02

# Joint, kind of term, name of the constant.
_Constant = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class Refined:
    """Laws of the joints that were changed, priors of added terms their estimates."""

    laws: dict[str, Friction]
    residual: Rows

    @property
    def squares(self) -> float:
        return float(self.residual @ self.residual)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def refined(rows: FrictionRows, laws: Mapping[str, Friction]) -> Refined:
    """Laws of some joints, beside rows of the robot as it is described, with the constants that fit
    best.

    The exponents of Stribeck's terms that were added are those of one of its two usual forms, for
    all joints the same, unless other ones explain more than chance: how the term falls is
    least identifiable, and a free exponent makes the rest of the curve less certain.
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
    level = free.squares / max(len(rows.tau) - rows.span.rank, 1)
    more = max(best.squares - free.squares, 0.0) / level
    return best if surprise(more, len(added)) < _OTHER else free


def _refined(rows: FrictionRows, laws: Mapping[str, Friction], usual: Collection[str]) -> Refined:
    """Laws with the constants that fit best; Stribeck's exponents of `usual` joints stay."""
    current, travel = dict(laws), dict[_Constant, float]()
    coefficients, steps, residual = _fit(rows, current, travel, usual)
    for _ in range(_STEPS):
        if max((abs(step) for step in steps.values()), default=0.0) < _SETTLED:
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
            size = max(abs(value), _SMALL * units.get(term.kind, law.coulomb))
            prior = {"offset": size} if term.signed else term.in_law(size)
            current[term.joint] = law.changed(**prior)
    return Refined(current, residual)


def _fit(
    rows: FrictionRows,
    laws: Mapping[str, Friction],
    travel: Mapping[_Constant, float],
    usual: Collection[str],
) -> tuple[dict[FrictionTerm, float], dict[_Constant, float], Rows]:
    """Coefficients of all terms, steps of the logarithms of constants that have made some `travel`,
    and what is left without steps; Stribeck's exponents of `usual` joints stay."""
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
    constants = {
        (t.joint, t.kind, name): t for t in terms if t.joint in laws for name in t.constants
        if not (name == "exponent" and t.kind == "stribeck" and t.joint in usual)
    }  # fmt: skip
    if not constants:
        return coefficients, {}, residual
    shapes = [(joints[joint], of_slope(t, name)) for (joint, _, name), t in constants.items()]
    sizes, n = np.array([coefficients[t] for t in constants.values()]), len(constants)
    slopes = rows.rigid.without(rows.columns(shapes) * sizes)
    prior = np.hstack([np.zeros((n, len(terms))), np.eye(n) / _SPREAD])
    A = np.vstack([np.hstack([columns, slopes]), prior])
    b = np.append(tau, [-travel.get(constant, 0.0) / _SPREAD for constant in constants])
    bounds = np.append(low, np.full(n, -_LARGEST)), np.append(high, np.full(n, _LARGEST))
    x = _bounded(A, b, *bounds, np.append(priors, np.zeros(n)))
    return coefficients, dict(zip(constants, x[len(terms) :].tolist(), strict=True)), residual


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


def moved(law: Friction, kind: str, name: str, step: float) -> Friction:
    """A law with one constant of a term multiplied by e^step, exponents within their limits."""
    part = getattr(law, kind)
    value = float(getattr(part, name) * np.exp(step))
    if name == "exponent":
        value = float(np.clip(value, *EXPONENTS))
    return law.changed(**{kind: part.changed(**{name: value})})
