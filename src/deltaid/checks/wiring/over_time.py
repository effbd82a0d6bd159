"""Torques over time: columns that were joined at another row, magnitudes in place of torques, and
stretches whose torques have another sign, unit or order than the rest.

Torques u(t) that were joined at another row correlate with those of the prior at a lag. With
another sign or unit in a stretch, u ≈ g f there and u ≈ h f in the rest, where f(t) are the torques
of a fit to the larger part; the stretch with the least residual is judged by g/h. If columns have
other drives' torques in a stretch, f is in another order there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.checks.evidence import WRONG_SCALE, Evidence
from deltaid.checks.wiring.candidate import ALONG, SENSIBLE
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.residual import LEAST, Map, MapResidual, motion, residual
from deltaid.estimation.problem import lengths
from deltaid.levels import NEGLIGIBLE
from deltaid.model.verdict import Grade, Verdict, listed

# Most rows that are compared; of a longer recording, rows are skipped.
_MOST = 20_000
# Least lag [s], larger than that of any drive; residual share of the best columns below which no
# lag is searched; largest share of the residual that may remain with a lag or another order.
_DELAY, _EXPLAINED, _CLEARER = 0.15, 0.1, 0.5
# Number of ends of stretches that are tried; least length of a stretch and of the rest [s]; rounds
# of the fit.
_ENDS, _SHORTEST, _ROUNDS = 300, 1.0, 10
_TINY = np.finfo(float).tiny

Torques = Float[np.ndarray, "moving samples"]
OfDrives = Float[np.ndarray, " moving"]
Inside = Bool[np.ndarray, " samples"]


@dataclass(frozen=True, eq=False)
class _Course:
    """Torques of moving drives over time: recorded, and by the prior, a fit, and a fit to recorded
    magnitudes; the last three are zero where unknown."""

    drives: Int[np.ndarray, " moving"]
    time: Float[np.ndarray, " samples"]
    prior: Torques
    fitted: Torques
    unsigned: Torques
    recorded: Torques
    one_sided: Bool[np.ndarray, " moving"]  # whether all recorded torques have the same sign
    blurred: int  # samples on either side that the filter mixes with one

    @property
    def step(self) -> float:
        return float(self.time[1] - self.time[0])

    def correlations(self, late: int, shift: int) -> OfDrives:
        """Correlations with the prior's torques, shifted by so many samples, of those torques whose
        positions are in the recording if torques come `late`."""
        first, last = max(0, late), len(self.time) + min(0, late)
        prior = self.prior[:, first - shift : last - shift]
        return _gain(prior, self.recorded[:, first:last])[1]


def over_time_verdicts(log: RemappedRecording) -> Iterator[Verdict]:
    """Verdicts on torques that were joined at another row, have no sign, or have another sign or
    unit for some time."""
    course = _course(log) if log.good else None
    if course is None or not course.drives.size:
        return
    magnitudes = tuple(_magnitudes(log, course))
    yield from magnitudes or tuple(_stretch(log, course)) or _joined(log, course)


def _course(log: RemappedRecording) -> _Course | None:
    """The whole recording, as it is mapped; None where its loops do not close."""
    rows, moved, dynamics = log.evidence.rows, log.motion, log.evidence.dynamics
    every, whole = -(-len(rows.time) // _MOST), float(np.ptp(rows.time))
    if moved.time[-1] - moved.time[0] < 0.9 * whole:
        fewer = {name: values[::every] for name, values in vars(rows).items()}
        moved = motion(replace(rows, **fewer), longest=whole) or moved
    under = residual(dynamics, moved, Map.identity(dynamics.dof))
    if under is None:
        return None
    one_sided = np.all(rows.tau >= 0, axis=0) | np.all(rows.tau <= 0, axis=0)
    fit = _of_most_rows(under, np.zeros_like(one_sided))
    known = under.prior, fit, _of_most_rows(under, one_sided) if one_sided.any() else fit
    torques, drives = np.zeros((len(known), *moved.tau.T.shape)), np.flatnonzero(~under.still)
    torques[:, :, under.keep] = [under.rows.of_drives(under.Y @ p) for p in known]
    blurred = moved.low_pass.half // (2 * moved.low_pass.decimation)
    prior, fitted, unsigned = torques[:, drives]
    return _Course(
        drives=drives,
        time=moved.time,
        prior=prior,
        fitted=fitted,
        unsigned=unsigned,
        recorded=moved.tau.T[drives],
        one_sided=one_sided[drives],
        blurred=blurred,
    )


def _of_most_rows(
    under: MapResidual, unsigned: Bool[np.ndarray, " drives"]
) -> Float[np.ndarray, " columns"]:
    """Parameters that fit the larger part of the rows: for errors with a Cauchy distribution scaled
    by their median, starting at the prior. Torques of `unsigned` drives get the model's sign."""
    tau, p, scale = under.rows.stack(under.tau.T), under.prior, lengths(under.Y)
    turned = np.repeat(unsigned, len(tau) // len(unsigned))
    for _ in range(_ROUNDS):
        predicted = under.Y @ p
        tau = np.where(turned, np.copysign(tau, predicted), tau)
        errors = np.abs(tau - predicted)
        weights = 1.0 / np.hypot(1.0, errors / max(float(np.median(errors)), LEAST))
        A = weights[:, None] * under.Y / scale
        p = np.linalg.lstsq(A, weights * tau, rcond=NEGLIGIBLE)[0] / scale
    return p


def _magnitudes(log: RemappedRecording, course: _Course) -> Iterator[Verdict]:
    known = np.where(course.fitted, course.recorded, 0.0)
    fits = course.fitted, course.unsigned, np.abs(course.unsigned)
    *signed, sizes = (1.0 - _gain(f, known)[1] ** 2 for f in fits)
    # The fit to magnitudes has a sign too; torques that keep it are no magnitudes.
    is_clearer = sizes < _CLEARER * np.minimum(*signed)
    drives = course.drives[course.one_sided & is_clearer].tolist()
    if drives:
        yield Verdict(
            "torque-sign",
            Grade.WRONG,
            f"the torque of {log.all_or(drives)} never changes its sign, where the motion asks "
            "for both",
            log.whose(drives),
            "the column holds magnitudes, such as those of an rms current",
            "record the torque or current with its sign",
        )


def _joined(log: RemappedRecording, course: _Course) -> Iterator[Verdict]:
    """Torques of all drives, or of single ones, that correlate with the prior's at a lag."""
    if log.best.unexplained < _EXPLAINED:
        return
    half = len(course.time) // 2
    along = np.array([course.correlations(lag, lag) for lag in range(-half, half + 1)])
    apart = along[half] <= ALONG
    # One drive has a lag where most go with the motion as they are.
    groups = np.flatnonzero(apart)[:, None] if apart.mean() < 0.5 else [np.arange(len(apart))]
    for group in groups:
        if (lag := _lag_of(course, along[:, group], group)) is None:
            continue
        late, peak, without = lag
        count = round(late / log.evidence.rows.step)
        drives = course.drives[group].tolist()
        columns = listed([log.evidence.columns.torque[i].column for i in drives])
        columns = columns if log.whose(drives) else "the torque columns"
        yield Verdict(
            "torque-lag",
            Grade.WRONG,
            f"the torque of {log.all_or(drives)} comes {abs(late):.2f} s "
            f"{'late' if late > 0 else 'early'} against positions, some {abs(count)} rows, more "
            f"than any drive delays it: {peak:.2g} is then its correlation with the prior's, and "
            f"{without:.2g} as recorded",
            log.whose(drives),
            cause="positions and torques were recorded apart and joined at another row, or by "
            "clocks that differ",
            cure=f"join them by stamps of one clock, which shifts {columns} by some {-count:+d} "
            "rows, or record both at once",
            number=1e3 * late,
            unit="ms",
        )


def _lag_of(
    course: _Course, along: Float[np.ndarray, "lags drives"], drives: Int[np.ndarray, " drives"]
) -> tuple[float, float, float] | None:
    """Lag [s] at which torques of some drives correlate most with the prior's, this correlation,
    and the largest without a lag; None where no lag is clear."""
    half, mean = len(along) // 2, along.mean(axis=1)
    k = int(np.argmax(mean[1:-1])) + 1
    before, peak, after = mean[k - 1 : k + 2].tolist()
    place = k - half + 0.5 * (before - after) / min(before - 2 * peak + after, -_TINY)  # a parabola
    late, least = place * course.step, along[k].min()
    # In undisturbed rows, torques of a repeated motion also correlate a period later.
    without = max(float(course.correlations(k - half, 0)[drives].mean()), float(mean[half]))
    clear = 1 - peak**2 <= _CLEARER * (1 - without**2) and least >= SENSIBLE[0]
    return (late, peak, without) if without <= ALONG and abs(late) >= _DELAY and clear else None


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a course from `first` to before `last`; `order` has the drive whose torque each
    column holds there."""

    course: _Course
    first: int
    last: int
    order: tuple[int, ...]

    @classmethod
    def best(cls, course: _Course, orders: Sequence[tuple[int, ...]]) -> "_Stretch":
        """The stretch and order with the least residual of scaled torques of the fit."""
        n, f = len(course.time), course.fitted
        u = np.where(f, course.recorded, 0.0)
        ends = np.linspace(0, n, min(n, _ENDS) + 1).astype(int)
        powers = np.maximum(np.sum(u**2, axis=1), _TINY)[:, None, None]
        products = np.array([u[:, None] * f, np.broadcast_to(f**2, (len(u), *f.shape))])
        sums = np.cumsum(np.add.reduceat(products, ends[:-1], axis=3), axis=3)
        sums = np.pad(sums, ((0, 0), (0, 0), (0, 0), (1, 0)))
        first, last = np.triu_indices(len(ends), 2)
        inside = sums[..., last] - sums[..., first]
        of_stretch, of_rest = (
            fu**2 / np.maximum(ff, _TINY) / powers for fu, ff in (inside, sums[..., -1:] - inside)
        )
        columns = np.arange(len(u))
        # A stretch and the rest change places at the ends: the shorter one is reported.
        rest = of_rest[columns, columns].sum(axis=0) - 1e-6 * (ends[last] - ends[first])
        explained = [of_stretch[columns, order].sum(axis=0) + rest for order in orders]
        order, k = np.unravel_index(np.argmax(explained), np.shape(explained))
        return cls(course, int(ends[first[k]]), int(ends[last[k]]), orders[int(order)])

    @property
    def is_long(self) -> bool:
        """Whether both parts are long enough to be judged."""
        length, whole = self.last - self.first, len(self.course.time)
        enough = min(length, whole - length) * self.course.step >= _SHORTEST
        return enough and all(part.any() for part in self.parts)

    @property
    def parts(self) -> tuple[Inside, Inside]:
        """Samples of the stretch and of the rest that the filter does not mix."""
        n = len(self.course.time)
        blurred, place = self.course.blurred + n // _ENDS, np.arange(n)
        inner = (place >= self.first + blurred) & (place < self.last - blurred)
        outer = (place < self.first - blurred) | (place >= self.last + blurred)
        return inner, outer

    @property
    def moved(self) -> Int[np.ndarray, " columns"]:
        """Columns that hold another drive's torque, if they clearly correlate with that."""
        f, u, order = self.course.fitted, self.course.recorded, np.array(self.order)
        inner, outer = self.parts
        moved = np.flatnonzero(order != np.arange(len(order)))
        _, along = _gain(f[order][:, inner], u[:, inner])
        (_, in_order), (_, elsewhere) = (_gain(f[:, part], u[:, part]) for part in (inner, outer))
        sure = (np.minimum(along, elsewhere) > ALONG) & (
            1 - along**2 < _CLEARER * (1 - in_order**2)
        )
        return moved[: len(moved) * bool(sure[moved].all())]

    def rows(self, record: Evidence) -> str:
        """First and last row in words."""
        rows = np.searchsorted(record.rows.time, self.course.time[[self.first, self.last - 1]])
        start, end = (record.table.row_name(record.table.first_row + int(row)) for row in rows)
        start = f"about {start}" if self.course.fitted[:, : self.first].any() else "the first row"
        end = f"about {end}" if self.course.fitted[:, self.last :].any() else "the last row"
        return f"from {start} to {end}"


def _stretch(log: RemappedRecording, course: _Course) -> Iterator[Verdict]:
    columns = [log.evidence.columns.torque[i].column for i in course.drives]
    cure = "or give the parts as recordings with a mapping each"
    orders = list(permutations(range(len(columns))))
    stretch = _Stretch.best(course, orders)
    if stretch.is_long and (moved := stretch.moved).size:
        pairs = [
            f"{columns[i]} has that of {log.names[course.drives[stretch.order[i]]]}" for i in moved
        ]
        yield Verdict(
            "drive-order",
            Grade.WRONG,
            f"torques are in another order {stretch.rows(log.evidence)} than in the rest of the "
            f"recording: {listed(pairs)} if the rest is right",
            log.whose(course.drives[moved].tolist()),
            cause="two recordings with columns in different orders were joined",
            cure=f"put columns {listed([columns[i] for i in moved])} in order in these rows, "
            f"{cure}",
        )
        return
    stretch = _Stretch.best(course, orders[:1])
    if not stretch.is_long:
        return
    f, u = course.fitted, course.recorded
    (g, along), (h, elsewhere) = (_gain(f[:, part], u[:, part]) for part in stretch.parts)
    times = g / np.where(h, h, _TINY)
    other = (times < 1 / WRONG_SCALE) | (times > WRONG_SCALE)
    changed = np.flatnonzero(other & (np.minimum(np.abs(along), np.abs(elsewhere)) > ALONG))
    if not changed.size:
        return
    drives, turned = course.drives[changed].tolist(), bool(times[changed].max() < 0)
    what = "sign" if turned else "unit or sign"
    size = listed(list(dict.fromkeys(f"{ratio:.2g}" for ratio in times[changed])))
    yield Verdict(
        "torque-sign" if turned else "torque-unit",
        Grade.WRONG,
        f"the torque of {log.all_or(drives)} has another {what} {stretch.rows(log.evidence)} "
        f"than in the rest of the recording: it is {size} times what it should be if the rest is "
        "right",
        log.whose(drives),
        cause=f"the {what} changed in drive or logger, or two recordings were joined",
        cure=f"correct column {listed([columns[i] for i in changed])} in these rows, {cure}",
        number=float(times[changed[0]]),
    )


def _gain(f: Torques, u: Torques) -> tuple[OfDrives, OfDrives]:
    """Factors of torques f that fit u best, and their correlations."""
    fu, ff, uu = (np.sum(product, axis=1) for product in (f * u, f**2, u**2))
    return fu / np.maximum(ff, _TINY), fu / np.sqrt(np.maximum(ff * uu, _TINY))
