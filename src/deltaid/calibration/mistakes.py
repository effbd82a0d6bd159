"""Measuring mistakes, detected before the fit: units, mirrored frames, order, exchanged drives.

Each is a hypothesis under which the described robot fits the readings. A hypothesis that explains
them much better than the file as given is reported with its fix, and the file is refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from deltaid.calibration.fit import LITTLE, tool_slopes
from deltaid.calibration.loops import Loops
from deltaid.calibration.readings import (
    NAMED_UNITS,
    DistanceReadings,
    Instrument,
    PointReadings,
    ProbeReadings,
    Tools,
    aligned,
    lengths,
)
from deltaid.calibration.unknowns import TOLERANCE, Unknowns
from deltaid.errors import RecordingError, counted
from deltaid.levels import CERTAIN
from deltaid.model.verdict import listed

# Share of identical rows from which a file is a copy; chance makes fewer, even of coarse readings.
_COPIED = 0.8
# Most points whose order is searched: the search is cubic.
_ORDERED = 300

# Misfit, the hypothesis in words, and the fix.
Hypotheses = Iterator[tuple[float, str, str]]


def require_plausible(loops: Loops, known: Unknowns, instrument: Instrument) -> None:
    """Raise a RecordingError for readings that only a mistake explains: lengths in another unit, a
    mirrored frame, points in another order, exchanged drives."""
    count, own = len(instrument.values), len(instrument.unknowns)
    if count < own / instrument.values.shape[1] + 1:
        raise RecordingError(
            f"has {counted(count, 'row')}; too few to fix the {own} unknowns of the "
            "instrument itself",
            where=instrument.source,
            cure="measure more poses",
        )
    x = _described(loops, instrument.q)
    with np.errstate(over="ignore"):  # absurd numbers overflow
        _require_spread(instrument, x)
        _, slopes = tool_slopes(loops, known, instrument, np.zeros(known.G.shape[1]))
        explained = float(np.median(np.linalg.norm(slopes[:, :3], axis=(1, 2))))
        allowed = CERTAIN * (explained + instrument.noise)
        _require_one_unit(instrument, x, allowed)
        _require_unit(instrument, x)
    here = _misfit(instrument, x)
    if here <= allowed:
        return
    hypotheses = (
        *_reading_hypotheses(instrument, x, allowed),
        *_drive_hypotheses(loops, instrument, allowed),
    )
    better = [entry for entry in hypotheses if entry[0] < LITTLE * here]
    if better:
        least = min(misfit for misfit, _, _ in better)
        like = [entry for entry in better if entry[0] <= 1.5 * least]
        causes = [what for _, what, _ in like]
        exchanged = [what for what in causes if what.startswith("drives ")]
        if len(exchanged) > 1:  # limbs are equal
            rest = [what for what in causes if what not in exchanged]
            causes = [*rest, "two drives are exchanged"]
        raise RecordingError(
            f"{instrument.readings} misfit the described robot by {1e3 * here:.3g} mm, and by "
            f"{1e3 * least:.3g} mm if {' or '.join(causes)}",
            where=instrument.source,
            cure="; or ".join(dict.fromkeys(cure for _, _, cure in like)),
        )


def require_new_readings(instrument: Instrument, earlier: Sequence[Instrument]) -> None:
    """Raise a RecordingError for a file that repeats most rows of an earlier one, because readings
    would count twice."""
    for other in earlier:
        shorter, longer = sorted((instrument.numbers, other.numbers), key=len)
        rows = {row.tobytes() for row in longer}
        same = sum(row.tobytes() in rows for row in shorter)
        if other.kind == instrument.kind and same > _COPIED * len(shorter):
            raise RecordingError(
                f"{same} rows are the same as in {other.source}, and would count twice",
                where=instrument.source,
                cure="give each reading once",
            )


def _described(loops: Loops, q: Float[np.ndarray, "rows ends drives"]) -> Tools:
    """Tool points of the described robot; NaN where its loops do not close."""
    return loops.start(q.reshape(-1, q.shape[2]))[:, :3].reshape(*q.shape[:2], 3)


def _require_spread(instrument: Instrument, x: Tools) -> None:
    if isinstance(instrument, DistanceReadings):
        none = (lengths(x) < TOLERANCE) | (instrument.values[:, 0] <= 0)
        if none.any():
            raise RecordingError(
                "is a distance between equal poses, or not positive",
                where=f"{instrument.source}, row {instrument.rows[none.argmax()]}",
                cure="remove the row, or correct its poses and distance",
            )
        return
    probed = isinstance(instrument, ProbeReadings)
    parts = (x[:, 0, :2],) if probed else (x[:, 0], instrument.values)
    wide = [np.linalg.svd(part - part.mean(axis=0), compute_uv=False)[1] for part in parts]
    # readings may be in a unit that is too small
    least = np.array([1.0, 1 / max(NAMED_UNITS)])[: len(parts)] * TOLERANCE * np.sqrt(len(x))
    if np.any(wide < least):
        raise RecordingError(
            f"{instrument.readings} lie on a line, or in one place",
            where=instrument.source,
            cure="measure poses that spread over the workspace",
        )


def _require_one_unit(instrument: Instrument, x: Tools, allowed: float) -> None:
    """Refuse more rows in another unit than the fit excludes, where all fit in one unit."""
    if isinstance(instrument, ProbeReadings) or len(instrument.values) < 2:
        return
    sizes = np.linalg.norm(instrument.values, axis=1)
    steps = np.sort(np.maximum(sizes, np.finfo(float).tiny))
    large = sizes > steps[np.argmax(steps[1:] / steps[:-1])]
    if large.mean() <= LITTLE:
        return
    for factor, unit in NAMED_UNITS.items():
        values = np.where(large[:, None], instrument.values / factor, instrument.values)
        error = np.linalg.norm(_errors(replace(instrument, values=values), x), axis=1)
        if max(np.median(error[large]), np.median(error[~large])) <= allowed:
            raise RecordingError(
                f"rows {_first_rows(instrument, large)} are {factor:.4g} times too large, the "
                f"others are not; likely these are in {unit}",
                where=instrument.source,
                cure="write all rows in one unit",
            )


def _first_rows(instrument: Instrument, chosen: np.ndarray) -> str:
    rows = instrument.rows[chosen]
    return ", ".join(map(str, rows[:6])) + (", …" if len(rows) > 6 else "")


def _require_unit(instrument: Instrument, x: Tools) -> None:
    ratio, alike = _ratio(instrument, x)
    metre = np.sqrt(min(NAMED_UNITS))  # Within this factor the metre is the nearest unit.
    if 1 / metre < ratio < metre:
        return
    unit = min(NAMED_UNITS, key=lambda factor: abs(np.log(ratio / factor)))
    likely = f"; likely they are in {NAMED_UNITS[unit]}" if abs(ratio / unit - 1) < LITTLE else ""
    cure = f"say so: unit: {NAMED_UNITS[unit]} under {instrument.kind}, with --columns FILE.yaml"
    raise RecordingError(
        f"lengths are {ratio:.4g} times those of the robot's poses"
        + (likely if alike else ", but not in all directions"),
        where=instrument.source,
        cure=cure if likely and alike else "check units and columns",
    )


def _ratio(instrument: Instrument, x: Tools) -> tuple[float, bool]:
    """Ratio of the readings to those of the described robot, and whether it is about the same in
    all directions."""
    if isinstance(instrument, PointReadings):
        sizes = _sizes(instrument.values) / _sizes(x[:, 0])
        return float(np.sqrt(np.prod(sizes))), bool(sizes.max() < 2 * sizes.min())
    if isinstance(instrument, DistanceReadings):
        return float(np.median(instrument.values[:, 0] / lengths(x))), True
    slope = 0.0
    if np.ptp(instrument.values) > 0:
        A = np.column_stack([np.ones(len(x)), x[:, 0, :2], instrument.values])
        slope = np.linalg.lstsq(A, x[:, 0, 2], rcond=None)[0][3]
    return (1 / slope if slope > 0 else 1.0), True


def _sizes(points: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, " 2"]:
    """Extent of points along their two main directions, which a plane has too, without outliers."""
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    near = points[away <= CERTAIN * np.median(away)]
    return np.linalg.svd(near - near.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(near))


def _errors(instrument: Instrument, x: Tools, used: slice = slice(None)) -> np.ndarray:
    """Errors of all readings, with the instrument's unknowns from those used [m]."""
    return instrument.slopes(x, instrument.start(x, used))[0]


def _misfit(instrument: Instrument, x: Tools, mirrored: bool = False) -> float:
    """Median error of readings at tool points [m]."""
    state = aligned(x[:, 0], instrument.values, mirrored=True) if mirrored else instrument.start(x)
    error, _, _ = instrument.slopes(x, state)
    return float(np.median(np.linalg.norm(error, axis=1)))


def _reading_hypotheses(instrument: Instrument, x: Tools, allowed: float) -> Hypotheses:
    """Yield hypotheses on the readings. A few sorted numbers resemble any others, so blocks and
    distances in another order, and points in two frames, must also fit to `allowed`."""
    values, (ratio, _) = instrument.values, _ratio(instrument, x)
    left = _misfit(replace(instrument, values=values / ratio), x)
    if left <= allowed:
        what = f"lengths are {ratio:.3g} times what they should be"
        yield left, what, "check their unit, and what was measured"
    if isinstance(instrument, PointReadings):
        handed, turned = "the frame is left-handed", "change the sign of one axis of the points"
        yield _misfit(instrument, x, mirrored=True), handed, turned
        order = _matched_order(x[:, 0], values)
        wrong = order != np.arange(len(order))
        if wrong.any():
            rows = _first_rows(instrument, wrong)
            another, sort = f"points stand in another order (rows {rows})", "sort the points"
            yield _misfit(instrument, x[order]), another, sort
            yield (
                _misfit(instrument, x[order], mirrored=True),
                f"{another} and {handed}",
                f"{sort} and {turned}",
            )
        yield from _frame_hypotheses(instrument, x, allowed)
        return
    probed = isinstance(instrument, ProbeReadings)
    if probed and np.ptp(values):
        yield (
            _misfit(replace(instrument, values=-values), x),
            "blocks stand below the plane",
            "give heights above the lowest block",
        )
    what, sizes = ("blocks", x[:, 0, 2]) if probed else ("distances", lengths(x))
    ranks = np.argsort(np.argsort(sizes))
    left = _misfit(replace(instrument, values=np.sort(values, axis=0)[ranks]), x)
    if left <= allowed:
        yield left, f"{what} stand in another order", "write each beside its own pose"


def _frame_hypotheses(instrument: PointReadings, x: Tools, allowed: float) -> Hypotheses:
    """Yield the hypothesis that the frame jumps once, with rows for a frame on both sides."""
    count, fewest = len(x), len(instrument.unknowns)
    if not 2 * fewest <= count <= _ORDERED:
        return

    def errors(start: int) -> list[np.ndarray]:
        parts = (slice(None, start), slice(start, None))
        return [np.linalg.norm(_errors(instrument, x, part)[part], axis=1) for part in parts]

    starts = range(fewest, count - fewest + 1)
    start = min(starts, key=lambda start: sum(part.sum() for part in errors(start)))
    # both parts have to fit: a part with a point far away fits nothing
    if (left := max(float(np.median(part)) for part in errors(start))) <= allowed:
        last, first = instrument.rows[start - 1], instrument.rows[start]
        yield (
            left,
            f"points up to row {last} are in one frame and those from row {first} in another",
            "give both parts as files of their own, each with --points",
        )


def _drive_hypotheses(loops: Loops, instrument: Instrument, allowed: float) -> Hypotheses:
    n = instrument.q.shape[2]
    as_read, straight = tuple(range(n)), (1,) * n
    exchanged = [(order, straight) for order in permutations(as_read)][1:]
    reversed_ = [(as_read, signs) for signs in product((1, -1), repeat=n)][1:]
    for order, signs in (*exchanged, *reversed_):
        x = _described(loops, instrument.q[..., order] * signs)
        if not np.isfinite(x).all():
            continue
        other = listed([str(k + 1) for k in range(n) if order[k] != k or signs[k] < 0])
        what = f"the sign of drive {other} is reversed"
        cure = "change the sign of these columns of q"
        if signs == straight:
            what = f"drives {other} are exchanged"
            cure = "name the columns of q in the order of the description's limbs"
        if (left := _misfit(instrument, x)) <= allowed:
            yield left, what, cure


def _matched_order(x: Float[np.ndarray, "rows 3"], m: Float[np.ndarray, "rows 3"]) -> np.ndarray:
    """Index of each point's pose by its distances to all others, which no frame changes; in the
    given order where they are too many to search."""
    if len(m) > _ORDERED:
        return np.arange(len(m))
    own, others = (
        np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1) for points in (m, x)
    )
    return linear_sum_assignment(np.linalg.norm(own[:, None] - others[None], axis=2))[1]
