"""Fit a type to its robots: mean, spreads, every robot given the type, and outliers."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import Objective, Quadratic, Regularizer
from deltaid.estimation.scatter import CHANCE, NORMAL, half_width
from deltaid.fleets.belonging import LEAST, AgainstOthers, Along, Sorted, fit_members, torques
from deltaid.fleets.coordinates import ANYTHING, Coordinates, Square, U
from deltaid.fleets.member import TypeMember
from deltaid.fleets.mixed_model import RobotRows, alone, mean, within
from deltaid.fleets.population import Estimates, MemberEstimate, Population
from deltaid.identification.widening import CLOSE
from deltaid.levels import ROUNDING
from deltaid.model.record import Settings
from deltaid.robot.load import RobotLike, load_robot

# Bodies that hold tools and loads.
_CARRIERS = ("P", "EE")


def fitted(
    members: Sequence[TypeMember],
    robot: RobotLike,
    settings: Settings | None = None,
) -> Population:
    """Fit a type to its robots.

    Args:
        members: results of `member`, in any order.
        robot: the type's description, with its priors.

    Raises:
        IdentificationError: no robot is given, or one twice.
    """
    members = sorted(members, key=lambda member: member.name)
    if not members:
        raise IdentificationError("no robot was given", where="members", cure="give one or more")
    name, times = Counter(member.name for member in members).most_common(1)[0]
    if times > 1:
        raise IdentificationError(
            f"robot '{name}' is given {times} times, and would count as so many robots",
            where="members",
            cure="give all recordings of a robot to one call of `member`",
        )
    coordinates = Coordinates.for_type(load_robot(robot), members, settings or Settings())
    first = _sorted(coordinates, members).mean
    coordinates = coordinates.resized(_consistent(coordinates, first.m, first.covariance))
    sorting, reasons = _reasons(_sorted(coordinates, members))
    return _population(sorting, members, reasons)


def _sorted(coordinates: Coordinates, members: Sequence[TypeMember]) -> Sorted:
    """Find the robots that belong. A measurement in the descriptions of several robots counts once,
    as a separate row."""
    times = Counter(fact.key for member in members for fact in member.facts)
    common = {fact.key: fact for member in members for fact in member.facts if times[fact.key] > 1}
    rows = [
        coordinates.rows(member, [fact for fact in member.facts if fact.key not in common])
        for member in members
    ]
    if common:
        first = members[0]
        nothing = replace(first, rows=first.rows[:0], values=first.values[:0],
                          shared=first.shared[:0])  # fmt: skip
        rows.append(coordinates.rows(nothing, list(common.values())))
    return fit_members(
        RobotRows.stacked(rows), coordinates, np.array([member.freedom for member in members])
    )


def _reasons(sorting: Sorted) -> tuple[Sorted, list[str]]:
    """Reasons why robots do not belong, and deviating friction of robots that do."""
    coordinates, rows, m = sorting.coordinates, sorting.rows, sorting.mean.m
    extra, reasons = rows.extra.copy(), list[str]()
    now, count = replace(sorting, rows=replace(rows, extra=extra)), len(sorting.freedom)
    for k in range(count):
        if not rows.counts[k]:
            robot = sorting.against_others(k, coordinates.free_friction)
            reasons.append(_reason(robot, coordinates, m))
            continue
        texts = list[str]()
        for _ in coordinates.robot.friction_joints if count >= LEAST else ():
            robot = now.against_others(k, np.zeros_like(m))
            places, text = _friction_reason(robot, coordinates, m)
            if not places or extra[k, places].any():
                break
            extra[k, places] = ANYTHING
            texts.append(text)
        reasons.append("; ".join(texts))
    return (sorting if np.array_equal(extra, rows.extra) else sorting.with_rows(now.rows)), reasons


def _population(
    sorting: Sorted, members: Sequence[TypeMember], reasons: Sequence[str]
) -> Population:
    coordinates, rows, count = sorting.coordinates, sorting.rows, len(members)
    T, precision, prior = coordinates.to_p, coordinates.precision, coordinates.prior
    logs, size = sorting.spreads.draws(), len(prior)
    every = [mean(rows, sorting.spreads.variance(log), precision, prior) for log in logs]
    values, variances = np.zeros((count, size)), np.zeros((count, size, size))
    for drawn in every:
        for robots, u, C in within(rows.only(slice(count)), drawn):
            values[robots] += u / len(logs)
            variances[robots] += (C + u[:, :, None] * u[:, None, :]) / len(logs)
    variances -= values[:, :, None] * values[:, None, :]
    means = np.array([drawn.m for drawn in every])
    centre = means.mean(axis=0)
    square = np.mean([drawn.covariance for drawn in every], axis=0) + np.cov(means.T, bias=True)
    p, std, is_moved = _parameters(coordinates, centre, square)
    adjusted, estimates = ["mean"] if is_moved else [], list[MemberEstimate]()
    for k, (robot, single) in enumerate(zip(members, alone(rows, precision, prior), strict=False)):
        belongs = bool(rows.counts[k])
        u, C = (values[k], variances[k]) if belongs else single
        value, deviation, is_moved = _parameters(coordinates, u, C)
        adjusted += [robot.name] if is_moved else []
        by_noise = np.linalg.norm(T @ C @ rows.H[k].T, axis=1)
        half = half_width(deviation, by_noise, np.full(len(deviation), robot.freedom))
        estimates.append(
            MemberEstimate(robot.name, Estimates(value, deviation, half), _std(T, single[1]),
                           belongs, reasons[k], float(sorting.chances[k]))
        )  # fmt: skip
    return Population(
        coordinates,
        Estimates(p, std, NORMAL * std),
        square,
        np.mean([drawn.variance for drawn in every], axis=0),
        members=tuple(estimates),
        spreads=sorting.spreads.of_unknown_sizes(square),
        moved=tuple(adjusted),
    )


def _std(T: np.ndarray, C: np.ndarray) -> Float[np.ndarray, " parameters"]:
    return np.sqrt(np.maximum(np.sum((T @ C) * T, axis=1), 0.0))


def _parameters(coordinates: Coordinates, u: U, C: Square) -> tuple[np.ndarray, np.ndarray, bool]:
    """p of u with its standard deviation, and whether consistency moved an entry by more than
    that."""
    p, std = _consistent(coordinates, u, C), _std(coordinates.to_p, C)
    off = np.abs(p - coordinates.to_p @ u - coordinates.reduction.p_0)
    return p, std, bool(np.any(off[std > 0] > std[std > 0]))


def _consistent(coordinates: Coordinates, u: U, C: Square) -> Float[np.ndarray, " parameters"]:
    """p of u, or of the most likely consistent u.

    Solves the conic program  min ‖W (x − x_u)‖²  over the cone, WᵀW the inverse covariance.

    Raises:
        IdentificationError: the solver did not converge.
    """
    reduction, n = coordinates.reduction, coordinates.size
    x = u[:n] * coordinates.sizes
    try:
        return reduction.parameters(x)
    except IdentificationError:
        values, vectors = np.linalg.eigh(C[:n, :n])
        values = np.maximum(values, ROUNDING * values[-1])
        R = triangle(vectors.T / np.sqrt(values)[:, None] / coordinates.sizes)
        none = Regularizer(Quadratic(np.zeros((1, n)), np.zeros(1)), None)
        objective = Objective(reduction, Quadratic(R, R @ x), none, 1.0)
        return reduction.parameters(Conic().solve(objective).x)


@dataclass(frozen=True, eq=False)
class _Cause:
    """A possible difference: the variables `at` of a body or joint, or a factor of all torques."""

    at: tuple[int, ...]
    owner: str
    part: Along

    @property
    def gain(self) -> float:
        """Reduction of the squared distance minus what chance gives each coefficient (95 %)."""
        return self.part.gain - NORMAL**2 * self.part.rank


def _reason(robot: AgainstOthers, coordinates: Coordinates, m: U) -> str:
    """Difference of a robot that does not belong.

    Args:
        robot: compared with the others.
        m: mean of the type.
    """
    causes = list(_causes(robot, coordinates, m))
    best = max(causes, key=lambda cause: cause.gain)
    close = [cause for cause in causes if cause.gain >= best.gain - CLOSE]
    chosen = close[-1] if best.at else best
    others = [cause for cause in close if cause.owner != chosen.owner]
    text = _described(chosen, coordinates)
    if others:
        text += f", or {_described(max(others, key=lambda cause: cause.gain), coordinates)}"
    distance = max(robot.distance - chosen.part.gain, 0.0)
    if robot.chance(distance, robot.rows - chosen.part.rank) < CHANCE:
        return f"it is unlike the others in more than one place, most of all {text}: another type?"
    if not chosen.at:
        return f"{text}: torque constants, gear ratio or unit of torques?"
    carried = chosen.owner in _CARRIERS
    return text + (": another tool, or a load that is not declared?" if carried else "")


def _causes(robot: AgainstOthers, coordinates: Coordinates, m: U) -> Iterator[_Cause]:
    """Yield causes: a factor of torques, single entries, and whole bodies; platform and tool
    last."""
    variables, rigid = coordinates.reduction.variables, ~coordinates.is_friction
    yield _Cause((), "", robot.along(torques(robot, coordinates, m)[:, None]))
    single = sorted(
        ((k,) for k in range(coordinates.size) if rigid[k]),
        key=lambda places: (
            variables[places[0]].owner in _CARRIERS,
            coordinates.kinds[places[0]] == "mass",
        ),
    )
    bodies = [
        tuple(places)
        for places in coordinates.owners().values()
        if len(places) > 1 and rigid[places[0]]
    ]
    for places in (*single, *bodies):
        yield _Cause(places, variables[places[0]].owner, robot.along(robot.H[:, places]))


def _described(cause: _Cause, coordinates: Coordinates) -> str:
    values, stds = cause.part.values, cause.part.stds
    if not cause.at:
        return f"its torques are {1 + values[0]:.3f} ± {stds[0]:.3f} times the type's"
    k = int(np.argmax(np.abs(values) / np.where(stds > 0, stds, np.inf)))
    variable, size = coordinates.reduction.variables[cause.at[k]], coordinates.sizes[cause.at[k]]
    off = f"{abs(values[k]) * size:.3g} ± {stds[k] * size:.2g} {variable.unit}"
    return f"{variable.name} is {off} {'more' if values[k] > 0 else 'less'} than in the type"


def _friction_reason(robot: AgainstOthers, coordinates: Coordinates, m: U) -> tuple[list[int], str]:
    """Variables and text of the joint whose friction deviates most; none if not significant."""
    owners, is_friction = coordinates.owners().values(), coordinates.is_friction
    joints = [places for places in owners if is_friction[places[0]]]
    candidates: list[tuple[float, list[int], str]] = []
    for places in joints:
        off = robot.along(robot.H[:, places])
        k = int(np.argmax(np.abs(off.values)))
        variable = coordinates.reduction.variables[places[k]]
        times = 1 + off.values[k] / m[places[k]]
        text = f"{variable.symbol} friction of {variable.owner} is {times:.2f} times the type's"
        candidates.append((len(joints) * robot.chance(off.gain, off.rank), places, text))
    chance, places, text = min(candidates, default=(1.0, [], ""), key=lambda entry: entry[0])
    return (places, text) if chance < CHANCE else ([], "")
