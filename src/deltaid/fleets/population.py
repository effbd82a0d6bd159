"""Result of a type's fit: tables, and a description of the next robot.

The description has priors of bodies and their spreads. Variables have the precision Q and are
correlated: a sum may be known far better than its terms. Independent priors of entries r_jᵀx with
standard deviations 1/√w_j have the precision Σ_j w_j r_j r_jᵀ. Marginal precisions of
entries exceed Q in uncertain directions. So the result is the narrowest set of priors whose
precision exceeds Q in no direction: the w with the largest Σ log w_j and
Q − Σ_j w_j r_j r_jᵀ ⪰ 0, a conic program.
"""

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
import polars as pl
from jaxtyping import Bool, Float
from scipy.linalg import inv

from deltaid.dynamics.parameters import ParameterLayout, inertia_scale, with_prior
from deltaid.errors import counted, few
from deltaid.estimation.conic import below_logarithm, definite, interior_point, svec
from deltaid.estimation.scatter import CHANCE
from deltaid.fleets.belonging import LEAST
from deltaid.fleets.coordinates import Coordinates
from deltaid.fleets.member import unmeasured
from deltaid.fleets.mixed_model import ENOUGH, Spreads
from deltaid.levels import NEGLIGIBLE, ROUNDING
from deltaid.model.verdict import FEW
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription

_NUMBER, _TEXT = pl.Float64, pl.String
TYPES = {
    **dict.fromkeys(("type", "parameter"), _TEXT),
    **dict.fromkeys(("mean", "std", "low", "high", "spread", "spread_low", "spread_high"), _NUMBER),
    **{"unit": _TEXT, "prior": _NUMBER, "robots": pl.Int64, "remarks": _TEXT},
}
MEMBERS = {
    **dict.fromkeys(("robot", "type", "parameter"), _TEXT),
    **dict.fromkeys(("value", "std", "low", "high", "alone_std", "deviation"), _NUMBER),
    **{"unit": _TEXT, "belongs": pl.Boolean, "reason": _TEXT, "chance": _NUMBER},
}
# Significant digits of a spread.
_DIGITS = 3


@dataclass(frozen=True, eq=False)
class Estimates:
    """Parameters in the order of the layout, their standard deviations, and half the widths of
    95 % intervals."""

    value: Float[np.ndarray, " parameters"]
    std: Float[np.ndarray, " parameters"]
    half: Float[np.ndarray, " parameters"]

    def entry(self, k: int, lowest: float) -> tuple[float, float, float, float]:
        """Value, deviation and interval of one parameter with a lower bound."""
        value, half = self.value[k], self.half[k]
        return value, self.std[k], max(value - half, lowest), value + half


@dataclass(frozen=True, eq=False)
class MemberEstimate:
    """One robot within its type.

    Attributes:
        within: its parameters given all robots; for an outlier, given itself and the description.
        alone_std: standard deviations from its own recordings and the description.
        reason: its difference from the others; empty without a significant one.
        chance: p-value of its distance from the others.
    """

    name: str
    within: Estimates
    alone_std: Float[np.ndarray, " parameters"]
    belongs: bool
    reason: str
    chance: float


@dataclass(frozen=True, eq=False)
class Population:
    """A type and its robots.

    Attributes:
        coordinates: the described type and its free variables.
        mean: of the type, consistent.
        covariance: of the free variables' mean.
        variance: of robots about it.
        members: all robots, sorted by name.
        spreads: by kind.
        moved: 'mean' and names of robots whose most likely values are inconsistent by more than a
            standard deviation; the nearest consistent values are given.
    """

    coordinates: Coordinates
    mean: Estimates
    covariance: Float[np.ndarray, "u u"]
    variance: Float[np.ndarray, " u"]
    members: tuple[MemberEstimate, ...]
    spreads: Spreads
    moved: tuple[str, ...]

    @property
    def robot(self) -> RobotDescription:
        return self.coordinates.robot

    @property
    def layout(self) -> ParameterLayout:
        return self.coordinates.reduction.layout

    @property
    def free(self) -> Bool[np.ndarray, " parameters"]:
        """Parameters that the fit may change."""
        return np.any(self.coordinates.to_p != 0, axis=1)

    @property
    def count(self) -> int:
        return sum(member.belongs for member in self.members)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the fit, in words."""
        moved = few(self.moved, FEW)
        notes = (
            ""
            if self.spreads.known
            else f"{counted(self.count, 'robot')} cannot show how much robots "
            f"differ: from {ENOUGH} on spreads are known; likely ones were assumed",
            f"fewer than {LEAST} robots cannot show which of them does not belong"
            if len(self.members) < LEAST
            else f"a robot that belongs is named with a chance of 1 in {round(1 / CHANCE)}",
            f"no bodies have the most likely values of {moved}; the nearest that "
            "some have are given: the description's prior does not fit these robots"
            if moved
            else "",
        )
        return tuple(filter(None, notes))


def types_table(name: str, population: Population) -> pl.DataFrame:
    """A row for each free parameter: the type's mean, and the spread between robots, null if
    undetermined."""
    spreads = np.stack(population.spreads.of_parameters(population.coordinates.to_p))
    free, notes = population.free, "; ".join(population.notes)
    rows = [
        (name, parameter.name, *population.mean.entry(k, parameter.low),
         *(float(value) if np.isfinite(value) else None for value in spreads[:, k]),
         parameter.unit, parameter.prior, population.count, notes)
        for k, parameter in enumerate(population.layout.parameters)
        if free[k]
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=TYPES, orient="row")


def members_table(name: str, population: Population) -> pl.DataFrame:
    """A row for each robot and parameter; values of outliers are from their recordings alone."""
    free = population.free
    rows = [
        (robot.name, name, parameter.name, *robot.within.entry(k, parameter.low),
         robot.alone_std[k], robot.within.value[k] - population.mean.value[k],
         parameter.unit, robot.belongs, robot.reason, robot.chance)
        for robot in population.members
        for k, parameter in enumerate(population.layout.parameters)
        if free[k]
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=MEMBERS, orient="row")


def next_robot(population: Population, fleet: str) -> RobotDescription:
    """The type as a description: priors are its mean, and bodies' spreads combine the uncertainty
    of the mean and the spread between robots.

    Spreads of entries are independent in a description, and as wide as that requires (`widest`).
    Measured values are part of the mean only. Friction has the type's mean and the fit's spread.

    Args:
        fleet: its name, for `sources`.
    """
    data = with_prior(unmeasured(population.robot), population.mean.value).model_dump()
    for name, spread in _spreads(population).items():
        if data["bodies"][name]["free"]:
            data["bodies"][name]["spread"] = spread
    text = f"mean of {counted(population.count, 'robot')} of {fleet}"
    source = f"{text}; spreads are of the next robot; deltaid {version('deltaid')}"
    changed = ("bodies", "friction", "rotor_inertia", "measured")
    sources = population.robot.sources.items()
    data["sources"] = {
        **{key: origin for key, origin in sources if key.split(".")[0] not in changed},
        **{f"bodies.{name}": source for name in population.layout.bodies},
        **{key: text for key in ("friction", "rotor_inertia") if data[key]},
    }
    return RobotDescription.model_validate(data)


def _spreads(fleet: Population) -> dict[str, dict[str, float]]:
    reduction, p = fleet.coordinates.reduction, fleet.mean.value
    inertial = [k for k, variable in enumerate(reduction.variables) if variable.kind == "inertia"]
    covariance = fleet.covariance + np.diag(fleet.variance)
    Q = inv(covariance[np.ix_(inertial, inertial)], assume_a="pos")
    T = fleet.coordinates.to_p[:, inertial]
    changed = np.any(T != 0, axis=1)
    sizes, std = np.linalg.norm(T[changed], axis=1), np.zeros(len(T))
    std[changed] = sizes / np.sqrt(widest(Q, T[changed] / sizes[:, None]))
    result: dict[str, dict[str, float]] = {}
    for k in np.flatnonzero(changed).tolist():
        body, _, symbol = fleet.layout.names[k].partition(".")
        part = fleet.layout.body(body)
        # The body's prior in the fit.
        prior = fleet.robot.bodies[body].changed(prior=ExplicitInertia.from_parameters(p[part]))
        share = std[k] / inertia_scale(prior.reduced_prior())[k - part.start]
        result.setdefault(body, {})[symbol] = _short(share)
    return result


def _short(value: float) -> float:
    """Round a spread up, so that it is never narrower."""
    unit = 10.0 ** (np.floor(np.log10(value)) - _DIGITS + 1)
    return float(f"{np.ceil(value / unit) * unit:.{_DIGITS + 1}g}")


def widest(
    Q: Float[np.ndarray, "n n"], rows: Float[np.ndarray, "entries n"]
) -> Float[np.ndarray, " entries"]:
    """Weights w of all entries, as in the module's docstring."""
    size = np.sqrt(np.diag(Q))
    Q, rows = Q / np.outer(size, size), rows / size
    Q = Q + max(ROUNDING - float(np.linalg.eigvalsh(Q)[0]), 0.0) * np.eye(len(Q))
    r = np.linalg.solve(np.linalg.cholesky(Q), rows.T).T  # of entries, where Q is 1
    length = np.linalg.norm(r, axis=1)
    r = r / length[:, None]
    # The variables are w_j |r_j|² and, of each, a number that is at most its logarithm.
    w, log = np.arange(2 * len(r)).reshape(2, -1)
    squares = svec(r[:, :, None] * r[:, None, :]).T
    logarithms, right, cones = below_logarithm(log, w, 2 * len(r))
    solution = interior_point(
        np.repeat([0.0, -1.0], len(r)),
        np.vstack([np.pad(squares, ((0, 0), (0, len(r)))), logarithms]),
        np.concatenate([svec(np.eye(len(Q))), right]),
        [definite(len(Q)), *cones],
        NEGLIGIBLE,
    )
    weights = np.array(solution.x)[w]
    # The solver's last digits must not make a prior too narrow.
    largest = float(np.linalg.eigvalsh((r.T * weights) @ r)[-1])
    return weights / max(largest, 1.0) / length**2
