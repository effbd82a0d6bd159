"""A type and its robots, as a fit leaves them, and as tidy tables."""

from dataclasses import dataclass, field

import numpy as np
import polars as pl
from jaxtyping import Bool, Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.fleets.belonging import LEAST
from deltaid.fleets.coordinates import Coordinates
from deltaid.fleets.mixed_model import ENOUGH, Spreads
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription

# So many names are shown at most.
_SHOWN = 5
_NUMBER, _TEXT = pl.Float64, pl.String
TYPES = {
    **dict.fromkeys(("type", "parameter"), _TEXT),
    **dict.fromkeys(("mean", "std", "low", "high", "spread", "spread_low", "spread_high"), _NUMBER),
    **{"unit": _TEXT, "prior": _NUMBER, "robots": pl.Int64, "told": _TEXT},
}
MEMBERS = {
    **dict.fromkeys(("robot", "type", "parameter"), _TEXT),
    **dict.fromkeys(("value", "std", "low", "high", "alone_std", "deviation"), _NUMBER),
    **{"unit": _TEXT, "belongs": pl.Boolean, "reason": _TEXT, "chance": _NUMBER},
}


@dataclass(frozen=True)
class PopulationSettings:
    """Share of belonging robots that are named nevertheless, and settings of the members' fit."""

    naming: float = 1e-3
    fit: Settings = field(default_factory=Settings)


@dataclass(frozen=True, eq=False)
class Estimates:
    """Parameters in the order of the layout, their standard deviations, and half the widths of
    95 % intervals."""

    value: Float[np.ndarray, " parameters"]
    std: Float[np.ndarray, " parameters"]
    half: Float[np.ndarray, " parameters"]

    def entry(self, k: int, lowest: float) -> tuple[float, float, float, float]:
        """Value, deviation and interval of one parameter that is `lowest` or more."""
        value, half = self.value[k], self.half[k]
        return value, self.std[k], max(value - half, lowest), value + half


@dataclass(frozen=True, eq=False)
class MemberEstimate:
    """One robot within its type.

    Attributes:
        within: its parameters, given all robots; of one that does not belong, by itself.
        alone_std: standard deviations by its own recordings and the description.
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
        """Layout of the parameters p."""
        return self.coordinates.reduction.layout

    @property
    def free(self) -> Bool[np.ndarray, " parameters"]:
        """Which parameters the fit may change."""
        return np.any(self.coordinates.to_p != 0, axis=1)

    @property
    def count(self) -> int:
        """Number of robots of the type."""
        return sum(member.belongs for member in self.members)

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of it, in words."""
        notes, moved = [], ", ".join(self.moved[:_SHOWN])
        if not self.spreads.known:
            notes.append(
                f"{self.count} robot{'s' if self.count > 1 else ''} cannot show how much robots "
                f"differ: from {ENOUGH} on spreads are known; likely ones were assumed"
            )
        notes.append(
            f"fewer than {LEAST} robots cannot show which of them does not belong"
            if len(self.members) < LEAST
            else f"a robot that belongs is named with a chance of 1 in {round(1 / self.naming)}"
        )
        if len(self.moved) > _SHOWN:
            moved += f" and {len(self.moved) - _SHOWN} more"
        if moved:
            notes.append(
                f"no bodies have the most likely values of {moved}; the nearest that "
                "some have are given: the description's prior does not fit these robots"
            )
        return tuple(notes)


def types_table(name: str, population: Population) -> pl.DataFrame:
    """A row a parameter that the fit may change: the type's mean, and the spread between robots,
    null where it cannot be known."""
    rows, notes = [], "; ".join(population.notes)
    for k in np.flatnonzero(population.free).tolist():
        own = population.layout.parameters[k]
        spread = (population.spread[k], population.spread_low[k], population.spread_high[k])
        ends = (float(value) if np.isfinite(value) else None for value in spread)
        mean = population.mean.entry(k, own.low)
        rows.append((name, own.name, *mean, *ends, own.unit, own.prior, population.count, notes))
    return pl.DataFrame(rows, schema=TYPES, orient="row")


def members_table(name: str, population: Population) -> pl.DataFrame:
    """A row a robot and parameter; of robots that do not belong by themselves alone."""
    rows, free = [], np.flatnonzero(population.free).tolist()
    for robot in population.members:
        for k in free:
            own = population.layout.parameters[k]
            deviation = robot.within.value[k] - population.mean.value[k]
            rows.append(
                (robot.name, name, own.name, *robot.within.entry(k, own.low), robot.alone_std[k],
                 deviation, own.unit, robot.belongs, robot.reason, robot.chance)
            )  # fmt: skip
    return pl.DataFrame(rows, schema=MEMBERS, orient="row")
