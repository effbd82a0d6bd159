"""A type from its robots: mean, spreads, every robot within it, and those that do not belong."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import IdentificationError
from deltaid.identification.scatter import half_width
from deltaid.model.record import Settings
from deltaid.population.belonging import LEAST, Sorted, left_out, sorted_out
from deltaid.population.consistent import consistent
from deltaid.population.coordinates import Coordinates
from deltaid.population.member import Fact, Member
from deltaid.population.mixed import Rows, mean
from deltaid.population.reasons import friction_reason, reason
from deltaid.population.spreads import ENOUGH, Spreads
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, described

# Draws of the spreads that results are averaged over, in pairs.
_DRAWS = 16
_ANYTHING = 1e4
_NORMAL = 1.959964
# So many names are shown at most.
_SHOWN = 5


@dataclass(frozen=True)
class PopulationSettings:
    """What is asked for.

    Attributes:
        naming: share of the robots that do belong that are named all the same.
        fit: settings of the fit that members were made with.
    """

    naming: float = 1e-3
    fit: Settings = field(default_factory=Settings)


@dataclass(frozen=True, eq=False)
class Estimates:
    """Parameters in the order of the layout.

    Attributes:
        value, std: with standard deviations.
        half: half the widths of 95 % intervals.
    """

    value: Float[np.ndarray, " parameters"]
    std: Float[np.ndarray, " parameters"]
    half: Float[np.ndarray, " parameters"]


@dataclass(frozen=True, eq=False)
class MemberEstimate:
    """One robot within its type.

    Attributes:
        name: of the robot.
        within: its parameters, given all robots; of one that does not belong, by itself.
        alone_std: standard deviations by its own recordings and the description.
        belongs: whether it is of the type.
        reason: what is different in it; empty if nothing is.
        chance: how often a robot that belongs is as far from the others.
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
        coordinates: the type as described, and the variables that are free.
        mean: of the type, inside the cone of what can be.
        covariance: of the free variables' mean.
        variance: of robots about it.
        spread: of each parameter between robots; `spread_low` and `spread_high` its 95 % interval.
        members: all robots, in the order of their names.
        spreads: by kind.
        moved: 'mean' and names of robots whose most likely values no bodies have: the nearest ones
            that some have are given, and are more than a standard deviation away.
        naming: as of the settings.
    """

    coordinates: Coordinates
    mean: Estimates
    covariance: Float[np.ndarray, "u u"]
    variance: Float[np.ndarray, " u"]
    spread: Float[np.ndarray, " parameters"]
    spread_low: Float[np.ndarray, " parameters"]
    spread_high: Float[np.ndarray, " parameters"]
    members: tuple[MemberEstimate, ...]
    spreads: Spreads
    moved: tuple[str, ...]
    naming: float

    @property
    def robot(self) -> RobotDescription:
        """The type, as described."""
        return self.coordinates.robot

    @property
    def layout(self) -> ParameterLayout:
        """Of p."""
        return self.coordinates.reduction.layout

    @property
    def free(self) -> Bool[np.ndarray, " parameters"]:
        """Which parameters the fit may change."""
        return np.any(self.coordinates.to_p != 0, axis=1)

    @property
    def told(self) -> tuple[str, ...]:
        """What to know of it, in words."""
        n = sum(one.belongs for one in self.members)
        found = []
        if not self.spreads.known:
            found.append(
                f"{n} robot{'s' if n > 1 else ''} cannot tell how much robots differ: from "
                f"{ENOUGH} on spreads are known; likely ones were assumed"
            )
        if len(self.members) < LEAST:
            found.append(f"fewer than {LEAST} robots cannot tell which of them does not belong")
        else:
            found.append(
                f"a robot that belongs is named with a chance of 1 in {round(1 / self.naming)}"
            )
        if self.moved:
            found.append(
                f"no bodies have the most likely values of {_few(self.moved)}; the nearest that "
                "some have are given: the description's prior does not fit these robots"
            )
        return tuple(found)


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
    coordinates = coordinates.resized(found.mean.m)
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
    rows, m = found.rows, found.mean.m
    friction = np.where(coordinates.is_friction, _ANYTHING, 0.0)
    extra, reasons = rows.extra.copy(), list[str]()
    for k in range(len(members)):
        if not rows.counts[k]:
            one = left_out(rows, k, found.mean, float(freedom[k]), friction)
            reasons.append(reason(one, coordinates, m, naming))
            continue
        texts = list[str]()
        for _ in coordinates.robot.friction_joints if len(members) >= LEAST else ():
            now = rows.with_extra(extra)
            one = left_out(now, k, found.mean, float(freedom[k]), np.zeros_like(friction))
            at, text = friction_reason(one, coordinates, m, naming)
            if not at or extra[k, at].any():
                break
            extra[k, at] = _ANYTHING
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
    logs = _draws(found.spreads)
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
    values, variances = _members(found, coordinates, logs, count)
    moved = list[str]()
    p = consistent(coordinates, mean_, square)
    if _far(p, T @ mean_ + p_0, _std(T, square)):
        moved.append("mean")
    alone = _alone(rows, coordinates)
    estimates = list[MemberEstimate]()
    for k, one in enumerate(members):
        belongs = bool(rows.counts[k])
        u, C = (values[k], variances[k]) if belongs else alone[k]
        own, std = consistent(coordinates, u, C), _std(T, C)
        if _far(own, T @ u + p_0, std):
            moved.append(one.name)
        by_noise = np.linalg.norm(T @ C @ rows.H[k].T, axis=1)
        freedom = np.full(len(std), one.freedom)
        within = Estimates(own, std, half_width(std, by_noise, freedom))
        estimates.append(MemberEstimate(one.name, within, _std(T, alone[k][1]), belongs,
                                        reasons[k], float(found.chances[k])))  # fmt: skip
    spread, low, high = _spread(T, found.spreads, coordinates)
    return Population(
        coordinates=coordinates,
        mean=Estimates(p, _std(T, square), _NORMAL * _std(T, square)),
        covariance=square,
        variance=between,
        spread=spread,
        spread_low=low,
        spread_high=high,
        members=tuple(estimates),
        spreads=found.spreads,
        moved=tuple(moved),
        naming=naming,
    )


def _far(p: np.ndarray, by: np.ndarray, std: np.ndarray) -> bool:
    """Whether some entry was moved by more than its standard deviation."""
    return bool(np.any(np.abs(p - by)[std > 0] > std[std > 0]))


def _few(names: Sequence[str]) -> str:
    """Some names, and how many there are beside."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _draws(spreads: Spreads) -> list[np.ndarray]:
    """Logarithms of spreads as likely as not, in pairs about the most likely."""
    z = np.random.default_rng(0).standard_normal((_DRAWS // 2, len(spreads.log)))
    away = z @ np.linalg.cholesky(spreads.covariance).T
    return [spreads.log + sign * one for one in away for sign in (1.0, -1.0)]


def _std(T: np.ndarray, C: np.ndarray) -> Float[np.ndarray, " parameters"]:
    """Standard deviations of p for a covariance of u."""
    return np.sqrt(np.maximum(np.einsum("pu,uv,pv->p", T, C, T), 0.0))


def _members(
    found: Sorted, coordinates: Coordinates, logs: Sequence[np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """u of every robot and its covariance, averaged over spreads.

    Given the mean u is normal about m + S AᵀL⁻¹(b − H m); see `mixed`.
    """
    size = coordinates.precision.shape[0]
    first, second = np.zeros((count, size)), np.zeros((count, size, size))
    for log in logs:
        s = found.spreads.variance(coordinates, log)
        one = mean(found.rows, s, coordinates.precision, coordinates.prior)
        m, covariance = one.m, one.covariance
        for at, part in found.rows.parts():
            own = s + part.extra
            A, c, _ = part.whitened(s)
            u = m + own * np.einsum("rnu,rn->ru", A, c - A @ m)
            SA = own[:, :, None] * np.swapaxes(A, 1, 2)
            B = np.eye(size) - SA @ A
            C = -SA @ np.swapaxes(SA, 1, 2) + B @ covariance @ np.swapaxes(B, 1, 2)
            C[:, np.arange(size), np.arange(size)] += own
            n = len(first[at])
            first[at] += u[:n]
            second[at] += (C + u[:, :, None] * u[:, None, :])[:n]
    first, second = first / len(logs), second / len(logs)
    return first, second - first[:, :, None] * first[:, None, :]


def _alone(rows: Rows, coordinates: Coordinates) -> list[tuple[np.ndarray, np.ndarray]]:
    """u of each robot and its covariance by its own rows and the description."""
    found = list[tuple[np.ndarray, np.ndarray]]()
    for H, b in zip(rows.H, rows.b, strict=True):
        C = np.linalg.inv(coordinates.precision + H.T @ H)
        found.append((C @ (coordinates.precision @ coordinates.prior + H.T @ b), C))
    return found


def _spread(
    T: np.ndarray, spreads: Spreads, coordinates: Coordinates
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each parameter between robots, with its interval; NaN where it cannot be known.

    The lower end is zero where robots do not show that they differ.
    """
    nothing = np.full(len(T), np.nan)
    if not spreads.known:
        return nothing, nothing, nothing
    at, s = coordinates.kind_of(), spreads.variance(coordinates)
    parts = np.stack([(T[:, at == k] ** 2) @ s[at == k] for k in range(len(spreads.kinds))], axis=1)
    total = parts.sum(axis=1)
    shares = parts / np.where(total > 0, total, 1.0)[:, None]
    deviation = np.sqrt(np.einsum("pk,kl,pl->p", shares, spreads.covariance, shares))
    spread = np.sqrt(total)
    low = spread * np.exp(-_NORMAL * deviation) * (shares @ spreads.there > 0.5)
    return spread, low, spread * np.exp(_NORMAL * deviation)
