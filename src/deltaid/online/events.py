"""Loads and contacts as events, from the outputs of all cycles."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.estimation.scatter import NORMAL
from deltaid.identification.events import LONGEST_GAP
from deltaid.online.online import Online, OnlineEstimate
from deltaid.online.settings import SOON
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES, INERTIA_UNITS

# An entry is identifiable if half of its interval is below this share of its size for such a mass.
_SHOWN = 0.25
# Delay of detection of a change without a gripper's signal [s]: a load is reported as estimated
# before it, and a load that is held for less is a step towards another load.
_DELAY = 0.05

Times = Float[np.ndarray, " rows"]


@dataclass(frozen=True)
class LoadEntry:
    """One entry of a load, such as its mass, with a 95 % interval.

    Attributes:
        name: m, mcx, …
        shown: whether the motion determined it: its interval is below half of the assumed one.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    shown: bool


@dataclass(frozen=True)
class WeighedLoad:
    """A load, as estimated when it was released.

    Attributes:
        start, end: [s]; None while it is still held.
        soon: mass 0.2 s after it was taken, with its interval; None if it was released before.
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
        """Coordinates of its centre of mass that the motion determined [m]."""
        first = [entry for entry in self.entries if entry.name.startswith("mc") and entry.shown]
        return tuple((entry.name[2:], entry.value / self.mass.value) for entry in first)


@dataclass(frozen=True)
class Touch:
    """A contact.

    Attributes:
        start, end: [s].
        place: 'platform', or the drive whose limb was touched.
        force: largest force on the platform [N], as a vector; None at a limb.
        effort: largest torque on the limb's drive [N m or N]; None at the platform.
        size: largest residual, in thresholds.
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


class Loads:
    """Collector of held loads, one after the other.

    Args:
        has_gripper: whether the gripper's signal is known; if not, loads that are too small or too
            brief are dropped.
    """

    def __init__(self, online: Online, has_gripper: bool) -> None:
        self._has_gripper, self._least = has_gripper, online.known.least_mass
        self._scales, self._names = np.array(online.known.load_scales), online.known.entries.names
        self._units = [INERTIA_UNITS[INERTIA_NAMES.index(name)] for name in self._names]
        self._positive = np.isin(self._names, ("m", "Ixx", "Iyy", "Izz"))
        self._finished: list[WeighedLoad] = []
        self._begin(None)

    def _begin(self, start: float | None) -> None:
        """Start a load at a time, or none; rows hold time, entries and deviations."""
        self._start, self._last = start, np.zeros((0, 1 + 2 * len(self._names)))
        self._soon: tuple[float, float, float] | None = None
        self._known = self._last

    def add(self, time: Times, estimate: OnlineEstimate) -> None:
        """Add the estimates of consecutive cycles."""
        begin = 0
        for k in np.flatnonzero(estimate.changed).tolist():
            self._hold(time, estimate, slice(begin, k))
            begin, start = k, float(time[k])
            if self._start is not None and estimate.held[k] and start - self._start < _DELAY:
                start = self._start  # the same load, better determined
                self._begin(None)
            self.close(float(time[k]))
            self._begin(start if estimate.held[k] else None)
        self._hold(time, estimate, slice(begin, len(time)))

    def _hold(self, time: Times, estimate: OnlineEstimate, rows: slice) -> None:
        time = time[rows]
        if self._start is None or not len(time):
            return
        now = np.column_stack([time, estimate.load[rows], estimate.load_std[rows]])
        last, since = np.concatenate([self._last, now]), time - self._start
        self._last = last[last[:, 0] >= time[-1] - _DELAY]
        self._known = self._last[-1 if self._has_gripper or since[-1] < 2 * _DELAY else 0]
        if self._soon is None and since[-1] >= SOON:
            k = rows.start + int(np.argmax(since >= SOON - 1e-9))
            self._soon = (float(estimate.mass[k]), *estimate.mass_interval[k].tolist())

    def close(self, end: float | None = None) -> None:
        """End the load at a time [s]; None if unknown, as at a gap."""
        start, soon, known = self._start, self._soon, self._known
        self._begin(None)
        if start is None or not known.size:
            return
        values, half = np.split(known[1:], 2) * np.array([[1.0], [NORMAL]])
        brief = end is not None and end - start < _DELAY
        if not self._has_gripper and (brief or values[0] < self._least):
            return
        low, shown = values - half, half < _SHOWN * self._scales * values[0] / self._scales[0]
        low[self._positive], shown[0] = np.maximum(low[self._positive], 0.0), True
        columns = (part.tolist() for part in (values, low, values + half, shown))
        entries = tuple(map(LoadEntry, self._names, self._units, *columns))
        self._finished.append(WeighedLoad(start, end, soon, entries))

    def finished(self) -> tuple[WeighedLoad, ...]:
        """End the last load, and return all of them."""
        self.close()
        return tuple(self._finished)


class Touches:
    """Collector of contacts, one after the other."""

    def __init__(self, robot: RobotDescription) -> None:
        self._drives, self._finished = robot.drives, list[Touch]()
        self._votes: np.ndarray | None = None  # for places; None without a contact
        self._start = self._end = 0.0
        self._most: tuple[float, np.ndarray, np.ndarray] | None = None

    def add(self, time: Times, estimate: OnlineEstimate) -> None:
        """Add the estimates of consecutive cycles."""
        out = estimate.outputs
        for k in np.flatnonzero(out["contact"][:, 0] > 0.5):
            instant, size = float(time[k]), float(out["contact_size"][k, 0])
            if self._votes is None or instant - self._end > LONGEST_GAP:
                self.close()
                self._start, self._votes = instant, np.zeros(len(self._drives) + 1)
            self._end = instant
            self._votes[int(out["contact_limb"][k, 0])] += size**2
            if self._most is None or size > self._most[0]:
                self._most = size, out["contact_force"][k], out["contact_effort"][k]

    def close(self) -> None:
        """End the contact, as at a gap."""
        if self._votes is not None and self._most is not None:
            limb, (size, force, effort) = int(self._votes.argmax()), self._most
            place = self._drives[limb - 1] if limb else "platform"
            pushed = None if limb else tuple(force.tolist())
            turned = float(effort[limb - 1]) if limb else None
            self._finished.append(Touch(self._start, self._end, place, pushed, turned, size))
        self._votes = self._most = None

    def finished(self) -> tuple[Touch, ...]:
        """End the last contact, and return all of them."""
        self.close()
        return tuple(self._finished)
