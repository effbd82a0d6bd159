"""A type from its robots: mean, spreads, every robot within it, and those that do not belong."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.errors import IdentificationError
from deltaid.estimation.scatter import half_width
from deltaid.population.belonging import ANYTHING, LEAST, Sorted, left_out, sorted_out
from deltaid.population.consistent import consistent
from deltaid.population.coordinates import Coordinates
from deltaid.population.member import Fact, Member
from deltaid.population.mixed import Rows, mean
from deltaid.population.reasons import friction_reason, reason
from deltaid.population.result import (
    Estimates,
    MemberEstimate,
    Population,
    PopulationSettings,
)
from deltaid.population.within import (
    NORMAL,
    alone,
    draws,
    members_within,
    spread_between,
    std_of,
)
from deltaid.robot.load import RobotLike, described


def fitted(
    members: Sequence[Member], robot: RobotLike, settings: PopulationSettings | None = None
) -> Population:
    """A type from its robots.

    Args:
        members: of `member`, in any order.
        robot: the type's description; parameters of robots are about its priors.
        settings: as of `PopulationSettings`.

    Raises:
        IdentificationError: there is no robot, or one twice.
    """
    settings, type_ = settings or PopulationSettings(), described(robot)
    members = sorted(members, key=lambda one: one.name)
    _require_some(members)
    common, own = _facts(members)
    coordinates = Coordinates.of(type_, members, settings.fit)
    freedom = np.array([one.freedom for one in members])
    found = _sorted(coordinates, members, common, own, freedom, settings.naming)
    coordinates = coordinates.resized(consistent(coordinates, found.mean.m, found.mean.covariance))
    found = _sorted(coordinates, members, common, own, freedom, settings.naming)
    found, reasons = _reasons(found, coordinates, members, freedom, settings.naming)
    return _population(found, coordinates, members, reasons, settings.naming)


def _require_some(members: Sequence[Member]) -> None:
    if not members:
        raise IdentificationError("no robot was given", where="members", cure="give one or more")
    name, times = Counter(one.name for one in members).most_common(1)[0]
    if times > 1:
        raise IdentificationError(
            f"robot '{name}' is given {times} times, and would count as so many robots",
            where="members",
            cure="give all recordings of a robot to one call of `member`",
        )


def _facts(members: Sequence[Member]) -> tuple[list[Fact], list[list[Fact]]]:
    """Measurements that several robots' descriptions have, which are one, and each robot's own."""
    count = Counter(fact.key for one in members for fact in one.facts)
    several = {key for key, times in count.items() if times > 1}
    common = {fact.key: fact for one in members for fact in one.facts if fact.key in several}
    own = [[fact for fact in one.facts if fact.key not in several] for one in members]
    return list(common.values()), own


def _sorted(
    coordinates: Coordinates,
    members: Sequence[Member],
    common: Sequence[Fact],
    own: Sequence[Sequence[Fact]],
    freedom: np.ndarray,
    naming: float,
) -> Sorted:
    """Those that belong; measurements in common are of one robot more."""
    each = [coordinates.rows(one, facts) for one, facts in zip(members, own, strict=True)]
    if common:
        first = members[0]
        nothing = replace(first, rows=first.rows[:0], values=first.values[:0],
                          shared=first.shared[:0])  # fmt: skip
        each.append(coordinates.rows(nothing, common))
        freedom = np.append(freedom, np.inf)
    return sorted_out(Rows.of(each), coordinates, freedom, naming, len(members))


def _reasons(
    found: Sorted,
    coordinates: Coordinates,
    members: Sequence[Member],
    freedom: np.ndarray,
    naming: float,
) -> tuple[Sorted, list[str]]:
    """Why robots do not belong; and friction of those that do, where it is unlike the others'."""
    rows, m, of_spreads = found.rows, found.mean.m, found.spreads.freedom
    friction = np.where(coordinates.is_friction, ANYTHING, 0.0)
    extra, reasons = rows.extra.copy(), list[str]()
    for k in range(len(members)):
        if not rows.counts[k]:
            one = left_out(rows, k, found.mean, (float(freedom[k]), of_spreads), friction)
            reasons.append(reason(one, coordinates, m, naming))
            continue
        texts = list[str]()
        for _ in coordinates.robot.friction_joints if len(members) >= LEAST else ():
            now = rows.with_extra(extra)
            one = left_out(
                now, k, found.mean, (float(freedom[k]), of_spreads), np.zeros_like(friction)
            )
            at, text = friction_reason(one, coordinates, m, naming)
            if not at or extra[k, at].any():
                break
            extra[k, at] = ANYTHING
            texts.append(text)
        reasons.append("; ".join(texts))
    if not np.array_equal(extra, rows.extra):
        again = rows.with_extra(extra)
        found = found.fitted_to(again, coordinates)
    return found, reasons


def _population(
    found: Sorted,
    coordinates: Coordinates,
    members: Sequence[Member],
    reasons: Sequence[str],
    naming: float,
) -> Population:
    """Results, averaged over what is open of the spreads."""
    T, p_0 = coordinates.to_p, coordinates.reduction.p_0
    count, rows = len(members), found.rows
    logs = draws(found.spreads)
    between = np.zeros(T.shape[1])
    means, covariances = list[np.ndarray](), list[np.ndarray]()
    for log in logs:
        s = found.spreads.variance(coordinates, log)
        one = mean(rows, s, coordinates.precision, coordinates.prior)
        means.append(one.m)
        covariances.append(one.covariance)
        between += s / len(logs)
    mean_ = np.mean(means, axis=0)
    square = np.mean(covariances, axis=0) + np.cov(np.array(means).T, bias=True)
    values, variances = members_within(found, coordinates, logs, count)
    moved = list[str]()
    p = consistent(coordinates, mean_, square)
    if _far(p, T @ mean_ + p_0, std_of(T, square)):
        moved.append("mean")
    own_alone = alone(rows, coordinates)
    estimates = list[MemberEstimate]()
    for k, one in enumerate(members):
        belongs = bool(rows.counts[k])
        u, C = (values[k], variances[k]) if belongs else own_alone[k]
        own, std = consistent(coordinates, u, C), std_of(T, C)
        if _far(own, T @ u + p_0, std):
            moved.append(one.name)
        by_noise = np.linalg.norm(T @ C @ rows.H[k].T, axis=1)
        freedom = np.full(len(std), one.freedom)
        within = Estimates(own, std, half_width(std, by_noise, freedom))
        estimates.append(MemberEstimate(one.name, within, std_of(T, own_alone[k][1]), belongs,
                                        reasons[k], float(found.chances[k])))  # fmt: skip
    spreads = found.spreads.of_unknown_sizes(coordinates, square)
    spread, low, high = spread_between(T, spreads, coordinates)
    return Population(
        coordinates=coordinates,
        mean=Estimates(p, std_of(T, square), NORMAL * std_of(T, square)),
        covariance=square,
        variance=between,
        spread=spread,
        spread_low=low,
        spread_high=high,
        members=tuple(estimates),
        spreads=spreads,
        moved=tuple(moved),
        naming=naming,
    )


def _far(p: np.ndarray, by: np.ndarray, std: np.ndarray) -> bool:
    """Whether some entry was moved by more than its standard deviation."""
    return bool(np.any(np.abs(p - by)[std > 0] > std[std > 0]))
