"""Torques over time: magnitudes in place of torques, and stretches whose torques have another sign,
unit, scale or order than the rest.

With another sign, unit or scale in a stretch, u ≈ g f there and u ≈ h f in the rest, where u(t) are
the torques and f(t) those of a fit to the larger part; the stretch with the least residual is
judged by g/h. If columns have other drives' torques in a stretch, f is in another order there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Int

from deltaid.checks.evidence import WRONG_SCALE, Evidence
from deltaid.checks.wiring.candidate import ALONG
from deltaid.checks.wiring.course import CLEARER, TINY, OfDrives, TorqueCourse, Torques, gains
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.joined import joined_verdicts
from deltaid.model.verdict import Grade, Verdict, listed

# Largest share of the residual that a change of scale leaves in the drives that it is of, and the
# least in the others.
_LEFT, _SAME = 0.05, 0.9
# Number of ends of stretches that are tried; least length of a stretch and of the rest [s].
_ENDS, _SHORTEST = 300, 1.0

Inside = Bool[np.ndarray, " samples"]


def over_time_verdicts(log: RemappedRecording, course: TorqueCourse) -> Iterator[Verdict]:
    """Verdicts on torques that were joined at another row, have no sign, or have another sign or
    unit for some time."""
    if not course.drives.size:
        return
    magnitudes = tuple(_magnitudes(log, course))
    yield from magnitudes or tuple(_stretch(log, course)) or joined_verdicts(log, course)


def _magnitudes(log: RemappedRecording, course: TorqueCourse) -> Iterator[Verdict]:
    known = np.where(course.fitted, course.recorded, 0.0)
    fits = course.fitted, course.unsigned, np.abs(course.unsigned)
    *signed, sizes = (1.0 - gains(f, known)[1] ** 2 for f in fits)
    # The fit to magnitudes has a sign too; torques that keep it are no magnitudes.
    is_clearer = sizes < CLEARER * np.minimum(*signed)
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


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a course from `first` to before `last`; `order` has the drive whose torque each
    column holds there."""

    course: TorqueCourse
    first: int
    last: int
    order: tuple[int, ...]

    @classmethod
    def best(cls, course: TorqueCourse, orders: Sequence[tuple[int, ...]]) -> "_Stretch":
        """The stretch and order with the least residual of scaled torques of the fit."""
        n, f = len(course.time), course.fitted
        u = np.where(f, course.recorded, 0.0)
        ends = np.linspace(0, n, min(n, _ENDS) + 1).astype(int)
        powers = np.maximum(np.sum(u**2, axis=1), TINY)[:, None, None]
        products = np.array([u[:, None] * f, np.broadcast_to(f**2, (len(u), *f.shape))])
        sums = np.cumsum(np.add.reduceat(products, ends[:-1], axis=3), axis=3)
        sums = np.pad(sums, ((0, 0), (0, 0), (0, 0), (1, 0)))
        first, last = np.triu_indices(len(ends), 2)
        inside = sums[..., last] - sums[..., first]
        of_stretch, of_rest = (
            fu**2 / np.maximum(ff, TINY) / powers for fu, ff in (inside, sums[..., -1:] - inside)
        )
        columns = np.arange(len(u))
        # A stretch and the rest change places at the ends: the shorter one is reported.
        rest = of_rest[columns, columns].sum(axis=0) - 1e-9 * (ends[last] - ends[first])
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
        _, along = gains(f[order][:, inner], u[:, inner])
        (_, in_order), (_, elsewhere) = (gains(f[:, part], u[:, part]) for part in (inner, outer))
        sure = (np.minimum(along, elsewhere) > ALONG) & (1 - along**2 < CLEARER * (1 - in_order**2))
        return moved[: len(moved) * bool(sure[moved].all())]

    @property
    def rescaled(self) -> Int[np.ndarray, " columns"]:
        """Columns whose torques have another scale in the stretch, if that explains them and the
        others have the same. A load changes several; what drifts does not change at a row."""
        f, u = self.course.fitted, np.where(self.course.fitted, self.course.recorded, 0.0)
        whole = np.any(self.parts, axis=0)
        before = _unexplained(f[:, whole], u[:, whole])
        after = sum(_unexplained(f[:, part], u[:, part]) for part in self.parts)
        changed = after < _LEFT * before
        is_sudden = not changed.all() and bool(np.all(changed | (after > _SAME * before)))
        return np.flatnonzero(changed & is_sudden)

    def rows(self, record: Evidence) -> str:
        """First and last row in words."""
        rows = np.searchsorted(record.rows.time, self.course.time[[self.first, self.last - 1]])
        start, end = (record.table.row_name(record.table.first_row + int(row)) for row in rows)
        start = f"about {start}" if self.course.fitted[:, : self.first].any() else "the first row"
        end = f"about {end}" if self.course.fitted[:, self.last :].any() else "the last row"
        return f"from {start} to {end}"


def _stretch(log: RemappedRecording, course: TorqueCourse) -> Iterator[Verdict]:
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
    (g, along), (h, elsewhere) = (gains(f[:, part], u[:, part]) for part in stretch.parts)
    times = g / np.where(h, h, TINY)
    other = (times < 1 / WRONG_SCALE) | (times > WRONG_SCALE)
    changed = np.flatnonzero(other & (np.minimum(np.abs(along), np.abs(elsewhere)) > ALONG))
    key, what = "torque-unit", "unit or sign"
    if not changed.size:
        changed, key, what = stretch.rescaled, "drive-gain", "scale"
    elif times[changed].max() < 0:
        key, what = "torque-sign", "sign"
    if not changed.size:
        return
    drives = course.drives[changed].tolist()
    size = listed(list(dict.fromkeys(f"{ratio:.2g}" for ratio in times[changed])))
    yield Verdict(
        key,
        Grade.WRONG,
        f"the torque of {log.all_or(drives)} has another {what} {stretch.rows(log.evidence)} "
        f"than in the rest of the recording: it is {size} times what it should be if the rest is "
        "right",
        log.whose(drives),
        cause=f"the {what} changed in drive or logger, or two recordings were joined",
        cure=f"correct column {listed([columns[i] for i in changed])} in these rows, {cure}",
        number=float(times[changed[0]]),
    )


def _unexplained(f: Torques, u: Torques) -> OfDrives:
    """Squares of torques u that torques f times a factor leave."""
    return np.sum(u**2, axis=1) * (1.0 - gains(f, u)[1] ** 2)
