"""Loads and contacts as events, from what every cycle says of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.estimation.scatter import NORMAL
from deltaid.online.online import Online, OnlineEstimate
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES, INERTIA_UNITS

# When a mass is looked at for the first time [s].
SOON = 0.2
# An entry is shown if half of its interval is below this share of what such a load may have.
_SHOWN = 0.25
# A release that nobody told is found so late [s]; what was known before that is the load.
_UNSEEN = 0.05
# What is held for less is a step on the way to another load [s].
_STEP = 0.06
# Contacts that are no farther apart are one [s].
_APART = 0.02

Times = Float[np.ndarray, " rows"]


@dataclass(frozen=True)
class LoadEntry:
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
class WeighedLoad:
    """A load, as it was known when it was left.

    Attributes:
        start, end: [s]; None where it is held still.
        soon: mass 0.2 s after it was taken, with its interval; None where it was left before.
        entries: the mass first.
    """

    start: float
    end: float | None
    soon: tuple[float, float, float] | None
    entries: tuple[LoadEntry, ...]

    @property
    def mass(self) -> LoadEntry:
        """Mass with its interval [kg]."""
        return self.entries[0]

    @property
    def centre(self) -> tuple[tuple[str, float], ...]:
        """Coordinates of its centre of mass that the motion showed [m]."""
        first = [entry for entry in self.entries if entry.name.startswith("mc") and entry.shown]
        return tuple((entry.name[2:], entry.value / self.mass.value) for entry in first)


@dataclass(frozen=True)
class Touch:
    """A contact of the robot with something.

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


@dataclass
class _Held:
    """A load that is held: time, entries and deviations as known now, and their last rows."""

    start: float
    soon: tuple[float, float, float] | None = None
    known: np.ndarray | None = None
    last: np.ndarray | None = None


class Loads:
    """Loads that were held, one after the other.

    Args:
        told: whether a gripper told when; else what is hardly a load, or a moment long, is none.
    """

    def __init__(self, online: Online, told: bool) -> None:
        self._told, self._least = told, online.known.least_mass
        self._scales, self._names = np.array(online.known.load_scales), online.known.entries.names
        self._units = [INERTIA_UNITS[INERTIA_NAMES.index(name)] for name in self._names]
        self._positive = np.isin(self._names, ("m", "Ixx", "Iyy", "Izz"))
        self._held: _Held | None = None
        self._found: list[WeighedLoad] = []

    def add(self, time: Times, found: OnlineEstimate) -> None:
        """Take some more cycles."""
        begin = 0
        for k in np.flatnonzero(found.changed).tolist():
            self._hold(time, found, slice(begin, k))
            begin, start = k, float(time[k])
            if self._held is not None and found.held[k] and start - self._held.start < _STEP:
                start, self._held = self._held.start, None  # the same load, better seen
            self.close(float(time[k]))
            self._held = _Held(start) if found.held[k] else None
        self._hold(time, found, slice(begin, len(time)))

    def _hold(self, time: Times, found: OnlineEstimate, rows: slice) -> None:
        time, held = time[rows], self._held
        if held is None or not len(time):
            return
        now = np.column_stack([time, found.load[rows], found.load_std[rows]])
        last = now if held.last is None else np.concatenate([held.last, now])
        held.last, since = last[last[:, 0] >= time[-1] - _UNSEEN], time - held.start
        held.known = held.last[-1 if self._told or since[-1] < 2 * _UNSEEN else 0]
        if held.soon is None and since[-1] >= SOON:
            k = rows.start + int(np.argmax(since >= SOON - 1e-9))
            held.soon = (float(found.mass[k]), *found.mass_interval[k].tolist())

    def close(self, end: float | None = None) -> None:
        """The load is left at a time [s]; None where that is not known, as at a hole."""
        load, self._held = self._held, None
        if load is None or load.known is None:
            return
        values, std = np.split(load.known[1:], 2)
        brief = end is not None and end - load.start < _STEP
        if not self._told and (brief or values[0] < self._least):
            return
        low, high = values - NORMAL * std, values + NORMAL * std
        shown = NORMAL * std < _SHOWN * self._scales * values[0] / self._scales[0]
        shown[0] = True
        low[self._positive] = np.maximum(low[self._positive], 0.0)
        columns = (part.tolist() for part in (values, low, high, shown))
        entries = tuple(map(LoadEntry, self._names, self._units, *columns))
        self._found.append(WeighedLoad(load.start, end, load.soon, entries))

    def finished(self) -> tuple[WeighedLoad, ...]:
        """All of them, the last one closed."""
        self.close()
        return tuple(self._found)


@dataclass
class _Touched:
    """A contact that lasts: its largest size with force and effort of then, votes for places."""

    start: float
    votes: np.ndarray
    end: float = 0.0
    size: float = 0.0
    force: np.ndarray | None = None
    effort: np.ndarray | None = None


class Touches:
    """Contacts, one after the other."""

    def __init__(self, robot: RobotDescription) -> None:
        self._drives = robot.drives
        self._now: _Touched | None = None
        self._found: list[Touch] = []

    def add(self, time: Times, found: OnlineEstimate) -> None:
        """Take some more cycles."""
        out = found.outputs
        for k in np.flatnonzero(out["contact"][:, 0] > 0.5):
            instant, size = float(time[k]), float(out["contact_size"][k, 0])
            if self._now is None or instant - self._now.end > _APART:
                self.close()
                self._now = _Touched(instant, np.zeros(len(self._drives) + 1))
            now = self._now
            now.end = instant
            now.votes[int(out["contact_limb"][k, 0])] += size**2
            if size > now.size:
                force, effort = out["contact_force"][k], out["contact_effort"][k]
                now.size, now.force, now.effort = size, force, effort

    def close(self) -> None:
        """The contact ends, as at a hole."""
        now, self._now = self._now, None
        if now is None or now.force is None or now.effort is None:
            return
        limb = int(now.votes.argmax())
        place, force, effort = "platform", tuple(now.force.tolist()), None
        if limb:
            place, force, effort = self._drives[limb - 1], None, float(now.effort[limb - 1])
        self._found.append(Touch(now.start, now.end, place, force, effort, now.size))

    def finished(self) -> tuple[Touch, ...]:
        """All of them, the last one closed."""
        self.close()
        return tuple(self._found)
