"""Evidence of a run against model, recording or gripper's signal, as sums over cycles.

While nothing is held, filtered model torques and measured torques τ agree up to unmodelled torques.
With m the part of the bodies and f the drives' friction, which may change, τ = g m + h f has g = 1
for each drive. The scatter between stretches of a second gives the uncertainty of g.

Offset d of a gripper's signal against the load: near a signal at θ the residual ρ of the empty
model is m ψ while the load is held, with ψ the filtered torque of a kilogram. For a load that is
taken at θ + d, with a free mass, this explains

    G(d) = (Σ ρᵀWψ)² / Σ ψᵀWψ,    sums over all cycles after θ + d near the signal,

of ρ's squares; for a released load, over cycles before. W weights by unmodelled torque, a tenth
of a second as one measurement, so G is twice a log likelihood. Signals of one kind are summed: the
largest G gives d, and its difference to G(0) the evidence.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.identification.widening import CLOSE
from deltaid.online.cycle import Cycle
from deltaid.online.instant import EMPTY, HOLDS
from deltaid.online.kalman import UNMODELLED
from deltaid.online.online import OnlineEstimate
from deltaid.online.replay import Cycles
from deltaid.online.settings import SOON
from deltaid.recording.masks.masks import runs_of

# Grid of a signal's offset, and time about it [s].
STEP, _AROUND = 0.005, SOON + UNMODELLED
# Largest contribution of one signal to G, twice a log likelihood ratio; number and share of signals
# whose difference must matter, and least sum of all.
_MOST, _FEWEST, _SHARE, _SURE = 12.0, 2, 0.2, 20.0
# Delay of the filters [s].
_FILTERED = 0.005
_GRID = STEP * np.arange(-round(SOON / STEP), round(SOON / STEP) + 1)


@dataclass(frozen=True)
class Offset:
    """Time from signals of one kind to their loads.

    Attributes:
        low, high: time from the signal until the load is held, or released [s], as a range: while a
            robot rests, friction hides it. Both 0 if undetermined.
        signals: number of signals.
        saying: number of signals that support it.
    """

    low: float
    high: float
    signals: int
    saying: int


class GripTiming:
    """Running sums: `add` consecutive cycles, call `broken` at gaps, then read `offset`.

    Args:
        period: of a cycle [s].
    """

    def __init__(self, period: float) -> None:
        self._period, self._rows, self._next = period, np.zeros((0, 3)), 0
        self._better: dict[bool, list[np.ndarray]] = {True: [], False: []}

    def broken(self) -> None:
        """End a stretch at a gap."""
        self._evaluate(last=True)
        self._rows, self._next = np.zeros((0, 3)), 0

    def add(
        self,
        gripper: Float[np.ndarray, " rows"],
        residual: Float[np.ndarray, "rows drives"],
        lifted: Float[np.ndarray, "rows drives"],
        lacking: Float[np.ndarray, "rows drives"],
    ) -> None:
        """Add consecutive cycles to the sums.

        Args:
            gripper: the gripper's signal.
            residual: ρ.
            lifted: ψ.
            lacking: size of unmodelled torques, undetermined friction included.
        """
        # Torques with the memory T are independent after 2 T.
        W = self._period / (2 * UNMODELLED) / lacking**2
        rows = np.column_stack([gripper, (residual * W * lifted).sum(1), (W * lifted**2).sum(1)])
        self._rows = np.concatenate([self._rows, rows])
        self._evaluate(last=False)

    def _evaluate(self, *, last: bool) -> None:
        around, rows = round(_AROUND / self._period), self._rows
        changes = (1 + np.flatnonzero(np.diff(rows[:, 0]))).tolist()
        ends = [*changes[1:], len(rows)]
        for start, change, end in zip([0, *changes], changes, ends, strict=False):
            if change < self._next or (not last and change + 2 * around > len(rows)):
                continue
            before, after = (min(around, span // 2) for span in (change - start, end - change))
            taken = bool(rows[change, 0] > rows[change - 1, 0])
            near = rows[change - before : change + after, 1:]
            both, power = np.cumsum(near[::-1] if taken else near, axis=0).T
            G = np.concatenate([[0.0], both**2 / (power + 1e-12)])
            offsets = before + np.round(_GRID / self._period).astype(int)
            places = np.clip([*offsets, before], 0, len(near))
            explained = G[len(near) - places if taken else places]
            better = explained[:-1] - explained[-1]  # G(d) − G(0)
            self._better[taken].append(better * min(1.0, _MOST / max(float(better.max()), 1e-12)))
            self._next = change + 1
        cut = max(0, len(rows) - 4 * around)
        self._rows, self._next = rows[cut:], max(self._next - cut, 0)

    def offset(self, *, taken: bool) -> Offset:
        """Offset of signals of a load that is taken, or released."""
        better = np.array(self._better[taken] or np.zeros((0, len(_GRID))))
        total = better.sum(axis=0)
        likely = np.flatnonzero(total > total.max() - CLOSE)
        saying = int(np.sum(better[:, int(total.argmax())] > CLOSE))
        if total.max() < _SURE or saying < max(_FEWEST, _SHARE * len(better)):
            return Offset(0.0, 0.0, len(better), saying)
        low, high = _GRID[likely[[0, -1]]] - _FILTERED
        return Offset(float(low), float(high), len(better), saying)


# Least deviation of a gain.
_KNOWN = 0.004


def measured_of(cycle: Cycle) -> None:
    """The part of a cycle that outputs filtered torques: measured, of friction, and of a load."""
    s, known = cycle.signals, cycle.known
    share = cycle.model.p[list(known.followed)] / np.array(known.friction_std)
    rubs = s.columns[:, s.at_friction] @ ca.DM(share)
    a_kilogram = s.columns[:, s.at_load][:, 0] / known.load_scales[0]
    cycle.fields.give(
        ("torque", s.torque, "filtered torque, as measured"),
        ("rubs", rubs, "filtered friction of the drives, as the model has it"),
        ("lifted", a_kilogram, "filtered torque of one kilogram"),
        ("dry_friction", s.dry, "filtered size of torques that no speed determines"),
    )


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """Evidence of a whole run.

    Attributes:
        gain: measured torque of each drive over the model's; NaN if the robot was never empty.
        deviation: standard deviation of it.
        touched, untouched: seconds with and without a contact.
        touched_empty, empty: seconds with a contact, and in total, while the gripper signalled
            empty.
        signals: all values of the gripper's signal.
        taken, released: lead of the gripper's signals when loads are taken and released.
        stuck: longest time of a constant torque of each moving drive [s].
        stuck_at: when that began [s].
    """

    gain: Float[np.ndarray, " drives"]
    deviation: Float[np.ndarray, " drives"]
    touched: float
    untouched: float
    touched_empty: float
    empty: float
    signals: frozenset[float]
    taken: Offset
    released: Offset
    stuck: Float[np.ndarray, " drives"]
    stuck_at: Float[np.ndarray, " drives"]

    @property
    def common(self) -> tuple[float, float]:
        """Common gain of all drives, and its deviation; NaN where unknown."""
        weight = 1 / np.maximum(self.deviation, _KNOWN) ** 2
        return float(self.gain @ weight / weight.sum()), float(1 / np.sqrt(weight.sum()))


class Suspicion:
    """Running sums: `add` consecutive cycles, then read `evidence`.

    Args:
        period: of a cycle [s].
        ends: of each drive's torque channel, as reported [N m or N].
        lacking: size of each drive's unmodelled torque [N m or N].
    """

    def __init__(
        self, period: float, ends: tuple[float, ...], lacking: Float[np.ndarray, " drives"]
    ) -> None:
        self._period, self._ends, self._lacking = period, np.array(ends), lacking
        self._timing, self._signals = GripTiming(period), set[float]()
        self._sums, self._seconds = [np.zeros((0, len(ends), 4, 4))], np.zeros(4)
        self._stuck, self._stuck_at = np.zeros((2, len(ends)))

    def add(self, rows: Cycles, estimate: OnlineEstimate) -> None:
        """Add consecutive cycles to the sums."""
        out = estimate.outputs
        if rows.begins:
            self._timing.broken()
        lacking = np.hypot(self._lacking, out["dry_friction"])
        self._timing.add(rows.gripper, estimate.residual, out["lifted"], lacking)
        live = estimate.good & (out["torque"] != 0).any(axis=1)
        cut = np.any(np.abs(rows.tau) >= 0.999 * self._ends, axis=1)
        memory = np.ones(max(1, round(UNMODELLED / self._period)))
        cut = np.convolve(cut, memory)[: len(rows.time)] > 0.5
        empty = live & ~estimate.held & (rows.gripper < HOLDS) & ~cut
        touched, free = live & (out["contact"][:, 0] > 0.5), live & (rows.gripper == EMPTY)
        parts = np.stack([touched, live & ~touched, touched & free, free])
        self._seconds += self._period * parts.sum(axis=1)
        self._signals.update(np.unique(rows.gripper).tolist())
        m = out["torque"] - estimate.residual - out["rubs"]
        model = m + out["rubs"]
        rate = np.gradient(model, self._period, axis=0) if len(model) > 1 else np.zeros_like(model)
        columns = np.stack([m, out["rubs"], rate, out["torque"]], axis=2) * empty[:, None, None]
        products = np.einsum("tdi,tdj->tdij", columns, columns)
        starts = np.arange(0, len(products), max(1, round(1 / self._period)))
        self._sums.append(np.add.reduceat(products, starts, axis=0))
        self._find_stuck(rows)

    def _find_stuck(self, rows: Cycles) -> None:
        """The longest time of a constant, unsaturated torque while its drive moves in every
        cycle."""
        within = np.abs(rows.tau[1:]) < 0.999 * self._ends
        same = (np.diff(rows.tau, axis=0) == 0) & (np.diff(rows.q, axis=0) != 0) & within
        for i, drive in enumerate(same.T):
            for first, last in runs_of(drive):
                if (last + 1 - first) * self._period > self._stuck[i]:
                    self._stuck[i] = (last + 1 - first) * self._period
                    self._stuck_at[i] = rows.time[first]

    @property
    def evidence(self) -> RunEvidence:
        """Evidence of all cycles."""
        self._timing.broken()
        taken, released = (self._timing.offset(taken=kind) for kind in (True, False))
        gain, deviation = _gain(np.concatenate(self._sums))
        touched, untouched, touched_empty, empty = self._seconds.tolist()
        return RunEvidence(
            gain, deviation, touched, untouched, touched_empty, empty, frozenset(self._signals),
            taken, released, self._stuck, self._stuck_at,
        )  # fmt: skip


def _gain(
    parts: Float[np.ndarray, "parts drives 4 4"],
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """g of each drive and its deviation from the scatter of parts; NaN where undetermined."""
    A, b, total = parts[..., :3, :3], parts[..., :3, 3], parts[..., :3, :3].sum(axis=0)
    size = np.sqrt(np.einsum("dii->di", total))
    if not (size > 0).all():
        return np.full(len(size), np.nan), np.full(len(size), np.nan)
    sizes = size[:, :, None] * size[:, None, :]
    inverse = np.linalg.pinv(total / sizes, hermitian=True) / sizes
    x = np.einsum("dij,dj->di", inverse, b.sum(axis=0))
    residual = b - np.einsum("pdij,dj->pdi", A, x)
    return x[:, 0], np.sqrt(np.sum(np.einsum("dj,pdj->pd", inverse[:, 0], residual) ** 2, axis=0))
