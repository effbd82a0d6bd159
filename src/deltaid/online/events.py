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
    start: float
    soon: tuple[float, float, float] | None = None
    entries: np.ndarray | None = None
    std: np.ndarray | None = None
    last: np.ndarray | None = None  # rows of time, load and std


class Loads:
    """Loads that were held, one after the other.

    Args:
        told: whether a gripper told when; else what is hardly a load, or a moment long, is none.
    """

    def __init__(self, online: Online, told: bool) -> None:
        self._told, self._least = told, online.known.least_mass
        self._scales = np.array(online.known.load_scales)
        names = online.entries.names
        self._names = [(name, INERTIA_UNITS[INERTIA_NAMES.index(name)]) for name in names]
        self._held: _Held | None = None
        self._found: list[WeighedLoad] = []

    def add(self, time: Times, found: OnlineEstimate) -> None:
        """Take some more cycles."""
        begin = 0
        for k in np.flatnonzero(found.changed):
            self._hold(time[begin:k], found, slice(begin, int(k)))
            start = float(time[k])
            if self._held is not None and found.held[k] and start - self._held.start < _STEP:
                start = self._held.start  # the same load, better seen
                self._held = None
            self.close(float(time[k]))
            if found.held[k]:
                self._held = _Held(start)
            begin = int(k)
        self._hold(time[begin:], found, slice(begin, len(time)))

    def _hold(self, time: Times, found: OnlineEstimate, rows: slice) -> None:
        if self._held is None or not len(time):
            return
        now = np.column_stack([time, found.load[rows], found.load_std[rows]])
        last = now if self._held.last is None else np.concatenate([self._held.last, now])
        last = last[last[:, 0] >= time[-1] - _UNSEEN]
        since = time - self._held.start
        known = last[-1] if self._told or since[-1] < 2 * _UNSEEN else last[0]
        self._held.last, (self._held.entries, self._held.std) = last, np.split(known[1:], 2)
        if self._held.soon is None and since[-1] >= SOON:
            k = int(np.argmax(since >= SOON - 1e-9))
            low, high = found.mass_interval[rows][k]
            self._held.soon = float(found.mass[rows][k]), float(low), float(high)

    def close(self, end: float | None = None) -> None:
        """The load is left at a time [s]; None where that is not known, as at a hole."""
        load, self._held = self._held, None
        if load is None or load.entries is None or load.std is None:
            return
        brief = end is not None and end - load.start < _STEP
        if not self._told and (brief or load.entries[0] < self._least):
            return
        largest = self._scales * load.entries[0] / self._scales[0]
        entries = []
        for i, (name, unit) in enumerate(self._names):
            value, half = float(load.entries[i]), NORMAL * float(load.std[i])
            low = max(value - half, 0.0) if name in ("m", "Ixx", "Iyy", "Izz") else value - half
            shown = i == 0 or half < _SHOWN * float(largest[i])
            entries.append(LoadEntry(name, unit, value, low, value + half, shown))
        self._found.append(WeighedLoad(load.start, end, load.soon, tuple(entries)))

    def finished(self) -> tuple[WeighedLoad, ...]:
        """All of them, the last one closed."""
        self.close()
        return tuple(self._found)


@dataclass
class _Touched:
    start: float
    end: float
    size: float
    force: np.ndarray
    effort: np.ndarray
    votes: np.ndarray


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
            now = self._now
            if now is None or instant - now.end > _APART:
                self.close()
                none = np.zeros(len(self._drives) + 1)
                now = self._now = _Touched(instant, instant, 0.0, none[:0], none[:0], none)
            now.end = instant
            now.votes[int(out["contact_limb"][k, 0])] += size**2
            if size > now.size:
                now.size = size
                now.force, now.effort = out["contact_force"][k], out["contact_effort"][k]

    def close(self) -> None:
        """The contact ends, as at a hole."""
        touch, self._now = self._now, None
        if touch is None:
            return
        limb = int(touch.votes.argmax())
        force = None if limb else tuple(touch.force.tolist())
        effort = float(touch.effort[limb - 1]) if limb else None
        place = self._drives[limb - 1] if limb else "platform"
        self._found.append(Touch(touch.start, touch.end, place, force, effort, touch.size))

    def finished(self) -> tuple[Touch, ...]:
        """All of them, the last one closed."""
        self.close()
        return tuple(self._found)
