"""What of a run speaks against model, recording or gripper's signal: sums over cycles.

While nothing is held, the model's filtered torque m and the measured one τ are the same but for
what the model has not, so τ = g m with g = 1, drive by drive. Stretches of a second are summed up,
and how they scatter says how sure g is.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from deltaid.online.cycle import Cycle
from deltaid.online.graph import Given, Part
from deltaid.online.layout import Field
from deltaid.online.online import OnlineEstimate
from deltaid.online.rows import EMPTY, HOLDS, Rows


def measured_of(cycle: Cycle) -> Part:
    """The part of a cycle that gives the filtered torque, and how much more than thought the model
    lacks."""
    s = cycle.signals
    torque = Field("torque", s.qd.numel(), "filtered torque, as measured")
    lacking = Field("lacking", s.qd.numel(), "size of torques that the model has not")
    return Part((), (Given(torque, s.torque), Given(lacking, cycle.estimates.lacking)))


@dataclass(frozen=True, eq=False)
class Seen:
    """All of a run.

    Attributes:
        gain: measured torque of each drive in units of the model's, with its
        deviation: standard deviations; NaN where nothing was empty.
        touched, untouched: seconds with and without a contact.
        touched_empty, empty: seconds with a contact, and all, while the gripper told of nothing.
        told: what the gripper ever told.
        stuck: for how long each drive's torque stayed the same at most while it moved [s], and
        stuck_at: when that began [s].
        lacking: size of torques that the model has not, drive by drive, the mean.
    """

    gain: Float[np.ndarray, " drives"]
    deviation: Float[np.ndarray, " drives"]
    touched: float
    untouched: float
    touched_empty: float
    empty: float
    told: frozenset[float]
    stuck: Float[np.ndarray, " drives"]
    stuck_at: Float[np.ndarray, " drives"]
    lacking: Float[np.ndarray, " drives"]


@dataclass
class Suspicion:
    """Running sums; `add` consecutive cycles, then read `seen`.

    Attributes:
        period: of a cycle [s].
        ends: of each drive's torque channel [N m or N], as it reports.
    """

    period: float
    ends: tuple[float, ...]
    drives: int = field(init=False)
    _sums: list[np.ndarray] = field(default_factory=list[np.ndarray])
    _seconds: Float[np.ndarray, " four"] = field(default_factory=lambda: np.zeros(4))
    _told: set[float] = field(default_factory=set[float])
    _lacking: np.ndarray | float = 0.0
    _cycles: int = 0

    def __post_init__(self) -> None:
        self.drives = len(self.ends)
        self._stuck, self._at = np.zeros(self.drives), np.zeros(self.drives)

    def add(self, rows: Rows, found: OnlineEstimate) -> None:
        """Some cycles more."""
        out = found.outputs
        live = found.good & (out["torque"] != 0).any(axis=1)
        empty = live & ~found.held & (rows.gripper < HOLDS)
        touched = live & (out["contact"][:, 0] > 0.5)
        told = live & (rows.gripper == EMPTY)
        parts = touched, live & ~touched, touched & told, told
        self._seconds += self.period * np.array([np.sum(one) for one in parts])
        self._told.update(np.unique(rows.gripper).tolist())
        self._lacking = self._lacking + out["lacking"].sum(axis=0)
        self._cycles += len(live)
        self._compare(out["torque"], found.residual, empty)
        self._look_for_stuck(rows)

    def _compare(
        self,
        torque: Float[np.ndarray, "rows drives"],
        residual: Float[np.ndarray, "rows drives"],
        empty: Bool[np.ndarray, " rows"],
    ) -> None:
        model = torque - residual
        products = np.hstack([model**2, model * torque]) * empty[:, None]
        starts = np.arange(0, len(products), max(1, round(1 / self.period)))
        self._sums.append(np.add.reduceat(products, starts, axis=0))

    def _look_for_stuck(self, rows: Rows) -> None:
        """The longest time for which a torque is the same, no end of its channel, while its drive
        moves in every cycle."""
        within = np.abs(rows.tau[1:]) < 0.999 * np.array(self.ends)
        same = (np.diff(rows.tau, axis=0) == 0) & (np.diff(rows.q, axis=0) != 0) & within
        for i, one in enumerate(same.T):
            ends = np.flatnonzero(np.diff(one.astype(int), prepend=0, append=0))
            if not ends.size:
                continue
            longest = np.diff(ends)[::2]
            k = int(longest.argmax())
            if longest[k] * self.period > self._stuck[i]:
                self._stuck[i] = longest[k] * self.period
                self._at[i] = rows.time[ends[2 * k]]

    @property
    def seen(self) -> Seen:
        """All of them."""
        parts = np.concatenate(self._sums) if self._sums else np.zeros((0, 2 * self.drives))
        power, both = parts[:, : self.drives], parts[:, self.drives :]
        total = power.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = both.sum(axis=0) / total
            deviation = np.sqrt(np.sum((both - gain * power) ** 2, axis=0)) / total
        touched, untouched, touched_empty, empty = self._seconds.tolist()
        return Seen(
            gain,
            deviation,
            touched,
            untouched,
            touched_empty,
            empty,
            frozenset(self._told),
            self._stuck,
            self._at,
            np.asarray(self._lacking / max(self._cycles, 1)),
        )
