"""What of a run speaks against model, recording or gripper's signal: sums over cycles.

While nothing is held, the model's filtered torque and the measured one τ are the same but for what
the model has not. With m what bodies take of it and f the drives' friction, which may change,
τ = g m + h f has g = 1, drive by drive. Stretches of a second are summed up, and how they scatter
says how sure g is.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float

from deltaid.online.cycle import Cycle
from deltaid.online.grip_timing import GripTiming, Offset
from deltaid.online.instant import EMPTY, HOLDS
from deltaid.online.online import OnlineEstimate
from deltaid.online.replay import Cycles

# No gain is known better than by so much, and filters remember a torque for so long [s].
_SURE, _REMEMBERED = 0.004, 0.05


def measured_of(cycle: Cycle) -> None:
    """The part of a cycle that gives filtered torques: measured, of friction, and of a load."""
    s, known = cycle.signals, cycle.known
    share = cycle.model.p[list(known.followed)] / np.array(known.friction_std)
    rubs = s.columns[:, s.at_friction] @ ca.DM(share)
    a_kilogram = s.columns[:, s.at_load][:, 0] / known.load_scales[0]
    for name, value, doc in (
        ("torque", s.torque, "filtered torque, as measured"),
        ("rubs", rubs, "filtered friction of the drives, as the model has it"),
        ("lifted", a_kilogram, "filtered torque of one kilogram"),
        ("dry_friction", s.dry, "filtered size of torques that no speed determines"),
    ):
        cycle.fields.give(name, ca.densify(value), doc)


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """What speaks against a whole run.

    Attributes:
        gain: measured torque of each drive in units of the model's, with its
        deviation: standard deviations; NaN where nothing was empty.
        touched, untouched: seconds with and without a contact.
        touched_empty, empty: seconds with a contact, and all, while the gripper told of nothing.
        told: what the gripper ever told.
        taken, left: by how much signals of the gripper come before the load.
        stuck: for how long each drive's torque stayed the same at most while it moved [s], and
        stuck_at: when that began [s].
    """

    gain: Float[np.ndarray, " drives"]
    deviation: Float[np.ndarray, " drives"]
    touched: float
    untouched: float
    touched_empty: float
    empty: float
    told: frozenset[float]
    taken: Offset
    left: Offset
    stuck: Float[np.ndarray, " drives"]
    stuck_at: Float[np.ndarray, " drives"]

    @property
    def common(self) -> tuple[float, float]:
        """What all drives' torques are of the model's, and its deviation; NaN where unknown."""
        weight = 1 / np.maximum(self.deviation, _SURE) ** 2
        return float(self.gain @ weight / weight.sum()), float(1 / np.sqrt(weight.sum()))


class Suspicion:
    """Running sums; `add` consecutive cycles, then read `seen`.

    Args:
        period: of a cycle [s].
        ends: of each drive's torque channel [N m or N], as it reports.
        lacking: what the model may lack of each drive's torque [N m or N].
    """

    def __init__(
        self, period: float, ends: tuple[float, ...], lacking: Float[np.ndarray, " drives"]
    ) -> None:
        self._period, self._ends, self._lacking = period, np.array(ends), lacking
        self._timing = GripTiming(period)
        self._sums = [np.zeros((0, len(ends), 4, 4))]
        self._seconds = np.zeros(4)
        self._told = set[float]()
        self._stuck, self._stuck_at = np.zeros(len(ends)), np.zeros(len(ends))

    def add(self, rows: Cycles, found: OnlineEstimate) -> None:
        """Take some more cycles."""
        out = found.outputs
        if rows.begins:
            self._timing.broken()
        lacking = np.hypot(self._lacking, out["dry_friction"])
        self._timing.add(rows.gripper, found.residual, out["lifted"], lacking)
        live = found.good & (out["torque"] != 0).any(axis=1)
        cut = np.any(np.abs(rows.tau) >= 0.999 * self._ends, axis=1)
        remembered = max(1, round(_REMEMBERED / self._period))
        cut = np.convolve(cut, np.ones(remembered))[: len(rows.time)] > 0.5
        empty = live & ~found.held & (rows.gripper < HOLDS) & ~cut
        touched = live & (out["contact"][:, 0] > 0.5)
        told = live & (rows.gripper == EMPTY)
        parts = touched, live & ~touched, touched & told, told
        self._seconds += self._period * np.array([np.sum(part) for part in parts])
        self._told.update(np.unique(rows.gripper).tolist())
        self._compare(out["torque"], found.residual, out["rubs"], empty)
        self._look_for_stuck(rows)

    def _compare(
        self,
        torque: Float[np.ndarray, "rows drives"],
        residual: Float[np.ndarray, "rows drives"],
        friction: Float[np.ndarray, "rows drives"],
        empty: Bool[np.ndarray, " rows"],
    ) -> None:
        m = torque - residual - friction
        model = m + friction
        rate = np.gradient(model, self._period, axis=0) if len(model) > 1 else np.zeros_like(model)
        columns = np.stack([m, friction, rate, torque], axis=2)
        columns *= empty[:, None, None]
        products = np.einsum("tdi,tdj->tdij", columns, columns)
        starts = np.arange(0, len(products), max(1, round(1 / self._period)))
        self._sums.append(np.add.reduceat(products, starts, axis=0))

    def _look_for_stuck(self, rows: Cycles) -> None:
        """The longest time for which a torque is the same, no end of its channel, while its drive
        moves in every cycle."""
        within = np.abs(rows.tau[1:]) < 0.999 * self._ends
        same = (np.diff(rows.tau, axis=0) == 0) & (np.diff(rows.q, axis=0) != 0) & within
        for i, drive in enumerate(same.T):
            ends = np.flatnonzero(np.diff(drive.astype(int), prepend=0, append=0))
            if not ends.size:
                continue
            longest = np.diff(ends)[::2]
            k = int(longest.argmax())
            if longest[k] * self._period > self._stuck[i]:
                self._stuck[i] = longest[k] * self._period
                self._stuck_at[i] = rows.time[ends[2 * k]]

    @property
    def seen(self) -> RunEvidence:
        """All that was summed up."""
        gain, deviation = _gain(np.concatenate(self._sums))
        touched, untouched, touched_empty, empty = self._seconds.tolist()
        self._timing.broken()
        return RunEvidence(
            gain,
            deviation,
            touched,
            untouched,
            touched_empty,
            empty,
            frozenset(self._told),
            self._timing.taken,
            self._timing.left,
            self._stuck,
            self._stuck_at,
        )


def _gain(
    parts: Float[np.ndarray, "parts drives 4 4"],
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """g of each drive, and how sure it is by what each part says; NaN where nothing shows it."""
    A, b = parts[..., :3, :3], parts[..., :3, 3]
    total = A.sum(axis=0)
    size = np.sqrt(np.einsum("dii->di", total))
    if not (size > 0).all():
        return np.full(len(size), np.nan), np.full(len(size), np.nan)
    inverse = np.linalg.pinv(total / size[:, :, None] / size[:, None, :], hermitian=True)
    inverse = inverse / size[:, :, None] / size[:, None, :]
    x = np.einsum("dij,dj->di", inverse, b.sum(axis=0))
    left = b - np.einsum("pdij,dj->pdi", A, x)
    return x[:, 0], np.sqrt(np.sum(np.einsum("dj,pdj->pd", inverse[:, 0], left) ** 2, axis=0))
