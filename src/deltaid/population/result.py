"""A type and its robots, as a fit leaves them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.model.record import Settings
from deltaid.population.belonging import LEAST
from deltaid.population.coordinates import Coordinates
from deltaid.population.spreads import ENOUGH, Spreads
from deltaid.robot.description import RobotDescription

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


def _few(names: Sequence[str]) -> str:
    """Some names, and how many there are beside."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
