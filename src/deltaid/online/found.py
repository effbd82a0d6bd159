"""What a robot that was watched showed: loads, contacts, friction, and what could be told."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Entry:
    """One entry of a load, such as its mass, with a 95 % interval.

    Attributes:
        name: m, mcx, …
        shown: whether the motion showed it: its interval is below half of what was assumed.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    shown: bool


@dataclass(frozen=True)
class HeldLoad:
    """A load, as it was known when it was left.

    Attributes:
        start, end: [s]; None where it is held still.
        soon: mass 0.2 s after it was taken, with its interval; None where it was left before.
        entries: the mass first.
    """

    start: float
    end: float | None
    soon: tuple[float, float, float] | None
    entries: tuple[Entry, ...]

    @property
    def mass(self) -> Entry:
        """[kg]."""
        return self.entries[0]

    @property
    def centre(self) -> tuple[tuple[str, float], ...]:
        """Coordinates of its centre of mass that the motion showed [m]."""
        first = [one for one in self.entries if one.name.startswith("mc") and one.shown]
        return tuple((one.name[2:], one.value / self.mass.value) for one in first)


@dataclass(frozen=True)
class Touch:
    """A contact.

    Attributes:
        start, end: [s].
        place: 'platform', or the drive whose limb was touched.
        force: largest force on the platform [N], as a vector; None at a limb.
        effort: largest torque on the limb's drive [N m or N]; None at the platform.
        size: of the residual at most, in thresholds.
    """

    start: float
    end: float
    place: str
    force: tuple[float, ...] | None
    effort: float | None
    size: float

    @property
    def strength(self) -> float:
        """Size of the force [N], or of the torque on the drive [N m or N]."""
        return float(np.linalg.norm(self.force)) if self.force else abs(self.effort or 0.0)


@dataclass(frozen=True)
class FollowedFriction:
    """A coefficient of friction that was followed.

    Attributes:
        name: of the parameter.
        before: in the model.
        value, std: at the end of the recording.
    """

    name: str
    unit: str
    before: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Series:
    """Some cycles, one a row, for figures and tables.

    Attributes:
        time: [s].
        mass, low, high: of what is held [kg]; 0 where nothing is.
        held: whether something is.
        size: of the residual, in thresholds; the largest since the row before.
        limb: as the cycle gives it.
        force: on the platform, while it is pushed [N].
        effort: from outside, on each drive [N m or N].
        best, worst: smallest force that is told [N].
    """

    time: Float[np.ndarray, " rows"]
    mass: Float[np.ndarray, " rows"]
    low: Float[np.ndarray, " rows"]
    high: Float[np.ndarray, " rows"]
    held: Float[np.ndarray, " rows"]
    size: Float[np.ndarray, " rows"]
    limb: Float[np.ndarray, " rows"]
    force: Float[np.ndarray, "rows moves"]
    effort: Float[np.ndarray, "rows dof"]
    best: Float[np.ndarray, " rows"]
    worst: Float[np.ndarray, " rows"]


@dataclass(frozen=True, eq=False)
class Watched:
    """A recording that was run through, cycle by cycle.

    Attributes:
        robot: its description.
        log: name of the recording.
        cycles: how many, of them
        bad: that could not be used.
        rate: [Hz].
        told: whether a gripper's signal said when something is held.
        false_alarms: accepted in an hour.
        loads, touches, friction: what was found.
        best, worst: smallest force on the platform that is told in 95 % of cases [N], the median
            over all cycles, along the best and along the worst direction; None without any cycle.
        seconds: processor time of a cycle, as run here [s].
        series: over time.
        doubts: what speaks against it, one cause each.
    """

    robot: RobotDescription
    log: str
    cycles: int
    bad: int
    rate: float
    told: bool
    false_alarms: float
    loads: tuple[HeldLoad, ...]
    touches: tuple[Touch, ...]
    friction: tuple[FollowedFriction, ...]
    best: float
    worst: float
    seconds: float
    series: Series
    doubts: tuple[Doubt, ...]
