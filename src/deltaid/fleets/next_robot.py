"""A description of the next robot of a type: bodies' priors and how far robots are from them.

Variables are known with a precision Q and correlated: a sum may be known far better than its terms.
Priors of single entries r_jᵀx, of standard deviations 1/√w_j, are a precision Σ_j w_j r_j r_jᵀ. If
each of them were as narrow as Q's own entry, a sum that robots determine would count again with
every robot. So the narrowest are taken whose precision is no
more than Q in any direction: the w of the largest Σ log w_j with Q − Σ_j w_j r_j r_jᵀ ⪰ 0, by a
barrier and Newton's steps.
"""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.linalg import inv

from deltaid.dynamics.parameters import inertia_scale, with_prior
from deltaid.fleets.member import unmeasured
from deltaid.fleets.population import Population
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import save_yaml

# Digits of a spread: three.
_DIGITS = 3
# Weights of the barrier, one after the other; steps at each, and when they have settled.
_BARRIER, _STEPS, _SETTLED = np.geomspace(1.0, 1e-4, 9), 60, 1e-9
# Least eigenvalue of a precision whose diagonal is one: what is below is rounding.
_ROUNDING = 1e-12


def next_robot(population: Population, fleet: str) -> RobotDescription:
    """The type as a description whose priors are its mean, and whose bodies' spreads combine the
    uncertainty of the mean and the spread between robots.

    Spreads of entries are independent in a description, and as wide as that requires (`widest`).
    Measured values are in the mean alone. Friction has the type's mean and the fit's spread.

    Args:
        fleet: where the robots come from, for `sources`.
    """
    data = with_prior(unmeasured(population.robot), population.mean.value).model_dump()
    for name, spread in _spreads(population).items():
        if data["bodies"][name]["free"]:
            data["bodies"][name]["spread"] = spread
    text = f"mean of {population.count} robot{'s' if population.count > 1 else ''} of {fleet}"
    source = f"{text}; spreads are of the next robot; deltaid {version('deltaid')}"
    changed = ("bodies", "friction", "rotor_inertia", "measured")
    sources = population.robot.sources.items()
    data["sources"] = {key: origin for key, origin in sources if key.split(".")[0] not in changed}
    data["sources"] |= {f"bodies.{name}": source for name in population.layout.bodies}
    data["sources"] |= {key: text for key in ("friction", "rotor_inertia") if data[key]}
    return RobotDescription.model_validate(data)


def save_next(population: Population, fleet: str, path: Path) -> None:
    """Write that description, whole or not at all.

    Raises:
        DeltaidError: it cannot be written.
    """
    save_yaml(next_robot(population, fleet), path)


def summary(fleet: Population) -> Sequence[str]:
    """The type in a few lines: robots, spreads, those that do not belong."""
    lines, spreads = [f"{len(fleet.members)} robots, {fleet.count} of the type"], fleet.spreads
    lines += fleet.notes
    if spreads.known:
        reach = 1.96 * np.sqrt(np.diag(spreads.covariance))
        ends = zip(spreads.log - reach, spreads.log + reach, spreads.there, strict=True)
        for kind, log, (low, high, there) in zip(spreads.kinds, spreads.log, ends, strict=True):
            lines.append(
                f"{kind}: robots differ by {np.exp(log):.1%} "
                f"({np.exp(low) if there else 0.0:.1%} to {np.exp(high):.1%})"
            )
    return [*lines, *(f"{robot.name}: {robot.reason}" for robot in fleet.members if robot.reason)]


def _spreads(fleet: Population) -> dict[str, dict[str, float]]:
    """Of each body's entries, as shares of their sizes in the new description."""
    reduction, p = fleet.coordinates.reduction, fleet.mean.value
    at = [k for k, variable in enumerate(reduction.variables) if variable.kind == "inertia"]
    Q = inv((fleet.covariance + np.diag(fleet.variance))[np.ix_(at, at)], assume_a="pos")
    T = fleet.coordinates.to_p[:, at]
    changed = np.any(T != 0, axis=1)
    sizes, std = np.linalg.norm(T[changed], axis=1), np.zeros(len(T))
    std[changed] = sizes / np.sqrt(widest(Q, T[changed] / sizes[:, None]))
    result: dict[str, dict[str, float]] = {}
    for k in np.flatnonzero(changed).tolist():
        body, _, symbol = fleet.layout.names[k].partition(".")
        part = fleet.layout.body(body)
        # A body's prior as the fit will have it.
        prior = fleet.robot.bodies[body].changed(prior=ExplicitInertia.from_parameters(p[part]))
        share = std[k] / inertia_scale(prior.reduced_prior())[k - part.start]
        result.setdefault(body, {})[symbol] = _short(share)
    return result


def _short(value: float) -> float:
    """Rounded up, never narrower than known."""
    unit = 10.0 ** (np.floor(np.log10(value)) - _DIGITS + 1)
    return float(f"{np.ceil(value / unit) * unit:.{_DIGITS + 1}g}")


def widest(
    Q: Float[np.ndarray, "n n"], rows: Float[np.ndarray, "entries n"]
) -> Float[np.ndarray, " entries"]:
    """w of every entry."""
    size = np.sqrt(np.diag(Q))
    Q, rows = Q / np.outer(size, size), rows / size
    smallest = float(np.linalg.eigvalsh(Q)[0])
    Q = Q + max(_ROUNDING - smallest, 0.0) * np.eye(len(Q))
    L = np.linalg.cholesky(Q)
    of_rows = np.linalg.solve(L, rows.T)  # in which Q is 1
    log = np.log(0.5 / np.linalg.eigvalsh(of_rows @ of_rows.T)[-1]) * np.ones(len(rows))
    for t in _BARRIER.tolist():
        for _ in range(_STEPS):
            step, now = _newton(of_rows, log, t), _value(of_rows, log, t)
            size = max(float(np.abs(step).max()), 1e-12)
            shares = min(1.0, 3.0 / size) * 0.5 ** np.arange(40)
            gaining = (x for x in shares.tolist() if _value(of_rows, log + x * step, t) > now)
            share = next(gaining, 0.0)
            log = log + share * step
            if share * size < _SETTLED:
                break
    return np.exp(log)


def _newton(of_rows: np.ndarray, log: np.ndarray, t: float) -> Float[np.ndarray, " entries"]:
    """A step of log w upwards: Σ log w + t log det(1 − Σ w r rᵀ)."""
    w = np.exp(log)
    G = of_rows.T @ np.linalg.solve(_left(of_rows, log), of_rows)
    slope = 1.0 - t * w * np.diag(G)
    curved = t * (np.diag(w * np.diag(G)) + np.outer(w, w) * G**2)
    return np.linalg.solve(curved + 1e-9 * np.eye(len(w)), slope)


def _value(of_rows: np.ndarray, log: np.ndarray, t: float) -> float:
    values = np.linalg.eigvalsh(_left(of_rows, log))
    return float(log.sum() + t * np.log(values).sum()) if values[0] > 0 else -np.inf


def _left(of_rows: np.ndarray, log: np.ndarray) -> np.ndarray:
    return np.eye(len(of_rows)) - (of_rows * np.exp(log)) @ of_rows.T
