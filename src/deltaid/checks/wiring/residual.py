"""A stretch of a recording under one map of its positions: least squares of torques, and the
evidence of each order and sign of the torque columns.

A stretch is filtered once for many hypotheses about its columns. All of them are affine maps and
permutations of columns, and filters are linear, so positions are differentiated once and mapped
afterwards. Poses and regressors are evaluated at a rate far above the cut-off; regressor and
torques then pass the same low-pass and are thinned.

Torques of a robot near its prior are normal: with p ~ N(p₀, α² S²), offsets o of the drives and
white noise, E u = Y p + X o + e, so every assignment u of torque columns to drives has an evidence
in closed form. E_ij is the torque column j in the rows of drive i.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.signal import detrend

from deltaid.checks.evidence import RawRows
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.drive_rows import ColumnsOfDrives, DriveRows, of_own_drives
from deltaid.estimation.information import entries_at
from deltaid.estimation.problem import Span
from deltaid.identification.study import HIGHEST_CUTOFF
from deltaid.mechanism.regularity import SINGULAR_CONDITION
from deltaid.recording.filter import LowPass, design_low_pass, samples_needed
from deltaid.recording.masks.masks import RESTS, runs_of
from deltaid.recording.spectrum import (
    HIGHEST,
    LOWEST_CUTOFF,
    NEARLY_ALL,
    SpectrumEstimate,
    apply,
    spectrum_of,
)
from deltaid.recording.survey_checks import off_course
from deltaid.recording.time.clock import HIGHEST_RATE
from deltaid.robot.parameter import PRIOR_SPREAD

# Largest cut-off, and lowest frequency of lines in a residual, over the frequency below which
# nearly all of the speeds' power lies: below it, model errors have lines too.
ABOVE = 3.0
# Least cut-off for the grid of regressors [Hz]: steps of friction need a fine one.
_SLOWEST = 20.0
# Time after which a slow drive stands still [s]; fewest samples that decide between hypotheses.
_REST, FEWEST = 0.1, 40
# Most consecutive missing rows that are interpolated; more end a stretch.
_BRIDGED = 10
# Weight of a drive at rest, whose torque static friction makes arbitrary.
AT_REST = 1e-3
# Least residual share of a machine's torques under any model, and usual offset of a drive's torque
# as a share of its torques.
LEAST, OFFSET = 0.003, 0.1
# Factor from which numbers are in another unit.
UNIT = 2.5
# Grid of α²/σ², the squared deviation of parameters from their prior over that of noise; the usual
# deviation is known to a factor of e.
_RATIOS = np.geomspace(1e-2, 1e8, 41)

Values = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class FilteredMotion:
    """Filtered positions with derivatives and filtered torques of one stretch."""

    time: Float[np.ndarray, " kept"]
    q: Float[np.ndarray, "samples drives"]  # as mapped, evenly spaced
    qd: Float[np.ndarray, "samples drives"]
    qdd: Float[np.ndarray, "samples drives"]
    load: Values  # τ at these samples, in place of the gears' loads
    tau: Values  # low-passed and thinned
    # Where no drive rests that moves at other times, because static friction makes torques
    # arbitrary; all samples if too few would remain.
    awake: Bool[np.ndarray, " kept"]
    low_pass: LowPass  # from samples to kept ones
    recorded: Values  # recorded q̇ at the samples, if any

    def filtered(self, signals: Float[np.ndarray, "channels samples"]) -> Values:
        """Low-passed and thinned signals: (channels, kept)."""
        return apply(self.low_pass.smooth, signals, self.low_pass.decimation)[:, : len(self.tau)]

    def few(self, most: int) -> "FilteredMotion":
        """The motion with at most so many used samples, spread over it."""
        places = np.flatnonzero(self.awake)
        chosen = places[np.linspace(0, len(places) - 1, min(most, len(places))).astype(int)]
        return replace(self, awake=np.isin(np.arange(len(self.awake)), chosen))

    @cached_property
    def moves(self) -> Bool[np.ndarray, " drives"]:
        spread = np.ptp(self.q, axis=0)
        return spread > np.maximum(1e-9 * (1 + np.abs(self.q).max(axis=0)), 1e-4 * spread.max())


def motion(
    rows: RawRows, *, longest: float = 20.0, oversampled: float = 25.0
) -> FilteredMotion | None:
    """The liveliest stretch of a recording; None if it is too short, or without torque.

    Args:
        longest: largest duration [s].
        oversampled: sampling rate of regressors as a multiple of the cut-off, so that friction's
            steps fall on a fine grid.
    """
    if (even := _even(rows, longest)) is None:
        return None
    time, recorded = even
    parts = np.cumsum([rows.q.shape[1], rows.tau.shape[1]])
    q, tau, _ = np.split(recorded, parts, axis=1)
    rate = (len(time) - 1) / (time[-1] - time[0])
    cutoff = _cutoff(q, rate)
    if not tau.any() or len(time) < samples_needed(cutoff, rate):
        return None
    full = design_low_pass(cutoff, rate, single=True)
    stride = max(1, int(rate / (oversampled * max(cutoff, _SLOWEST))))
    thinning = design_low_pass(cutoff, rate / stride, single=True)
    edge = full.margin - full.half
    smoothed = apply(full.smooth, recorded.T[:, edge : len(time) - edge], stride).T
    samples, load, speeds = np.split(smoothed, parts, axis=1)
    qd = apply(full.first, q.T, stride).T
    # Torques pass once, by a filter centred on the samples that the second one keeps.
    begin, every = edge + thinning.half * stride, stride * thinning.decimation
    wide = tau.T[:, begin : len(tau) - edge]
    count = -(-(len(samples) - len(thinning.smooth) + 1) // thinning.decimation)
    return FilteredMotion(
        time=time[begin + full.half :: every][:count],
        q=samples,
        qd=qd,
        qdd=apply(full.second, q.T, stride).T,
        load=load,
        tau=apply(full.smooth, wide, every).T[:count],
        awake=_awake(qd, rate / stride, thinning, count),
        low_pass=thinning,
        recorded=speeds,
    )


def _awake(qd: Values, rate: float, low_pass: LowPass, count: int) -> Bool[np.ndarray, " kept"]:
    """Kept samples whose filter window contains no rest of any drive."""
    asleep = np.zeros(len(qd))
    for speed in np.abs(qd).T:
        for first, last in runs_of(speed < RESTS * speed.max()):
            if last + 1 - first > _REST * rate:
                asleep[first : last + 1] = 1.0
    awake = apply(np.ones(len(low_pass.smooth)), asleep[None], low_pass.decimation)[0, :count] < 0.5
    return awake if awake.sum() >= FEWEST else np.ones(count, bool)


def _cutoff(q: Values, rate: float) -> float:
    """The usual cut-off, or less: three times the frequency below which 99.9 % of the speeds' power
    lies. Noise of coarse encoders is not white and makes the usual one too high."""
    general = spectrum_of(q).cutoff(rate) or HIGHEST_CUTOFF
    level = detrend(q, axis=0) * np.hanning(len(q))[:, None]
    frequency = np.fft.rfftfreq(len(q), 1 / rate)
    power = np.cumsum(np.abs(np.fft.rfft(level, axis=0) * frequency[:, None]) ** 2, axis=0)
    fastest = frequency[np.argmax(power >= NEARLY_ALL * power[-1], axis=0)]
    # A resting drive has only noise, with its speeds at high frequencies.
    moving = max(fastest[fastest < HIGHEST_CUTOFF], default=HIGHEST_CUTOFF)
    highest = min(HIGHEST * rate, HIGHEST_CUTOFF, ABOVE * moving)
    return float(min(max(LOWEST_CUTOFF, min(general, highest)), HIGHEST * rate))


def _even(rows: RawRows, longest: float) -> tuple[Float[np.ndarray, " samples"], Values] | None:
    """Time and [q τ q̇] of the liveliest stretch without a gap, evenly spaced."""
    data = np.hstack([rows.q, rows.tau, rows.qd])
    for row, _, lost in off_course(np.diff(data, axis=0, prepend=data[:1])):
        data[row : row + lost] = np.nan
    keep = np.flatnonzero(np.isfinite(np.column_stack([rows.time, data])).all(axis=1))
    keep = keep[np.diff(np.maximum.accumulate(rows.time[keep]), prepend=-np.inf) > 0]
    time = rows.time[keep]
    if len(keep) < SpectrumEstimate.SHORTEST or not rows.q.shape[1]:
        return None
    step = float(np.median(np.diff(time)))
    if step < 1 / HIGHEST_RATE:  # the survey refuses it, whatever its columns are
        return None
    # Rows that stand behind in time are left out, and so many of them are no late packets.
    ends = np.flatnonzero((np.diff(time) > _BRIDGED * step) | (np.diff(keep) > _BRIDGED))
    starts, stops = np.append(0, ends + 1), np.append(ends + 1, len(time))
    part = keep[_liveliest(rows.q[keep], starts, stops, int(longest / step))]
    time, data = rows.time[part], data[part]
    if len(part) < SpectrumEstimate.SHORTEST:
        return None
    if np.diff(time).max() < 1.5 * step:
        return time, data
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
    return grid, np.stack([np.interp(grid, time, column) for column in data.T], axis=1)


def _liveliest(q: Values, starts: np.ndarray, stops: np.ndarray, longest: int) -> slice:
    spread = np.ptp(q, axis=0)
    steps = np.abs(np.diff(q, axis=0, prepend=q[:1])) / np.where(spread > 0, spread, 1.0)
    travel = np.append(0.0, np.cumsum(steps.sum(axis=1)))
    ends = zip(starts, np.maximum(starts + 1, stops - longest + 1), strict=True)
    first = np.concatenate([np.arange(start, stop, max(1, longest // 20)) for start, stop in ends])
    last = np.minimum(first + longest, stops[np.searchsorted(starts, first, side="right") - 1])
    k = int(np.argmax(travel[last] - travel[first]))
    return slice(int(first[k]), int(last[k]))


@dataclass(frozen=True)
class Map:
    """Map from position columns to joint values: q_i = scale_i · column order_i + shift_i."""

    scale: tuple[float, ...]
    order: tuple[int, ...]
    shift: tuple[float, ...]

    @classmethod
    def identity(cls, dof: int) -> "Map":
        return cls((1.0,) * dof, tuple(range(dof)), (0.0,) * dof)

    def values(self, q: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        return self.rates(q) + self.shift

    def rates(self, qd: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        """q̇ or q̈ of columns."""
        return qd[:, list(self.order)] * self.scale

    def times(self, factor: float, drives: Iterable[int]) -> "Map":
        """The map with the scale of some drives multiplied by a factor."""
        scale = (f * factor if i in drives else f for i, f in enumerate(self.scale))
        return replace(self, scale=tuple(scale))

    @property
    def scaled(self) -> list[int]:
        """Drives whose positions are in another unit or those of the motor."""
        return [i for i, factor in enumerate(self.scale) if abs(factor) != 1]


@lru_cache
def patterns(
    dof: int,
) -> tuple[Int[np.ndarray, "patterns drives"], Float[np.ndarray, "patterns drives"]]:
    """Orders and signs of torque columns: n! orders with 2ⁿ signs each, the first one as mapped."""
    pairs = list(product(permutations(range(dof)), product((1.0, -1.0), repeat=dof)))
    return np.array([order for order, _ in pairs]), np.array([signs for _, signs in pairs])


@dataclass(frozen=True, eq=False)
class MapResidual:
    """Least squares under one map of the positions."""

    dynamics: Dynamics
    map: Map
    z: Float[np.ndarray, "samples dof"]  # poses
    share: float  # of samples where loops close, regular and on the most frequent branch
    rows: DriveRows  # order of drives' samples in the rows of Y
    tau: Float[np.ndarray, "used dof"]  # recorded torques, in the order of the mapping
    Y: Float[np.ndarray, "rows columns"]
    columns: Int[np.ndarray, " columns"]  # indices of the parameters
    prior: Float[np.ndarray, " columns"]
    still: Bool[np.ndarray, " dof"]  # drives at rest, whose torques determine no sign
    keep: Bool[np.ndarray, " kept"]  # the kept samples that are used

    @cached_property
    def span(self) -> Span:
        return Span.of_columns(self.Y)

    @cached_property
    def correlations(self) -> Float[np.ndarray, "dof dof"]:
        """Correlation of drive i's torque at the prior with column j."""
        expected = self.rows.of_drives(self.Y @ self.prior)
        sizes = np.outer(np.linalg.norm(expected, axis=1), np.linalg.norm(self.tau, axis=0))
        return expected @ self.tau / np.maximum(sizes, np.finfo(float).tiny)

    @property
    def regressor(self) -> ColumnsOfDrives:
        """Y of each drive at all kept samples; zero where it is not used."""
        Y = np.zeros((self.dynamics.dof, len(self.keep), len(self.columns)))
        Y[:, self.keep] = self.Y.reshape(len(Y), -1, Y.shape[2]) * self.rows.scale[:, None, None]
        return Y

    @property
    def scale(self) -> Float[np.ndarray, " columns"]:
        return np.array([self.dynamics.layout.parameters[k].scale for k in self.columns])

    @cached_property
    def evidences(self) -> Float[np.ndarray, " patterns"]:
        """Log evidence of each of `patterns`."""
        dof, rows = len(self.still), len(self.Y)
        E = self.rows.stack(of_own_drives(np.broadcast_to(self.tau, (dof, *self.tau.shape))))
        offsets = np.diag(np.where(self.still, AT_REST, 1.0)).repeat(self.rows.samples, axis=0)
        orders, signs = patterns(dof)
        # Weights of columns of E, by drive and torque column.
        weights = (np.eye(dof)[orders] * signs[:, :, None]).reshape(len(orders), -1).T
        expected = self.Y @ self.prior
        size = np.sqrt(np.sum(weights * (E.T @ E @ weights), axis=0))
        usual = float(np.linalg.norm(expected))
        by = np.where(np.abs(np.log(usual / size)) < np.log(UNIT), 1.0, usual / size)
        columns = np.hstack([self.Y * self.scale, OFFSET * offsets])
        U, s, _ = np.linalg.svd(columns, full_matrices=False)
        along = (U.T @ E @ weights) * by - (U.T @ expected)[:, None]
        total = (size * by) ** 2 - 2 * by * (expected @ E @ weights) + usual**2
        across = np.maximum(total - np.sum(along**2, axis=0), 0.0)
        spread = 1 + _RATIOS[:, None] * s**2
        share = (across + (1 / spread) @ along**2) / (size * by) ** 2 + LEAST**2
        wide = _RATIOS[:, None] * (share * (size * by) ** 2 / rows) / PRIOR_SPREAD**2
        level = np.log(share * size**2 / rows)
        values = -0.5 * rows * level - 0.5 * np.log(spread).sum(axis=1)[:, None]
        values = np.max(values - 0.5 * (0.5 * np.log(wide)) ** 2, axis=0)
        # Likelihood of torques relative to their size, independent of row weights under this map.
        sizes = rms_torques(self.tau.T)
        return values + self.rows.samples * float(np.log(sizes / self.rows.scale).sum())


def rms_torques(tau: Float[np.ndarray, "drives samples"]) -> Float[np.ndarray, " drives"]:
    """Root mean squares, none of them zero."""
    sizes = np.sqrt(np.mean(tau**2, axis=1))
    return np.maximum(sizes, 1e-6 * sizes.max(initial=np.finfo(float).tiny))


def poses(
    dynamics: Dynamics, q: Float[np.ndarray, "motions samples dof"]
) -> tuple[Float[np.ndarray, "motions samples dof"], Bool[np.ndarray, "motions samples"]]:
    """Poses z, and where loops close, regular and on the most frequent branch of a motion."""
    z, closed = dynamics.kinematics.forward_unchecked(q.reshape(-1, q.shape[2]))
    z = np.where(closed[:, None], z, dynamics.kinematics.home)
    regular = dynamics.kinematics.regularity(z)
    good = (closed & (regular.worst < SINGULAR_CONDITION)).reshape(q.shape[:2])
    sign = np.sign(regular.determinant).reshape(good.shape)
    branch = np.where(np.sum(sign * good, axis=1, keepdims=True) >= 0, 1, -1)
    return z.reshape(q.shape), good & (sign == branch)


def residual(dynamics: Dynamics, motion: FilteredMotion, map: Map) -> MapResidual | None:
    """None where too few samples have poses."""
    (z,), (good,) = poses(dynamics, map.values(motion.q)[None])
    keep, share = motion.awake, float(good.mean())
    if not good.all():
        keep = keep & (motion.filtered(good[None].astype(float))[0] > 1 - 1e-6)
    if keep.sum() < FEWEST:
        return None
    qd, qdd = map.rates(motion.qd), map.rates(motion.qdd)
    values = np.where(good, entries_at(dynamics, z, qd, qdd, motion.load), 0.0)
    tau, (drives, entries) = motion.tau[keep], dynamics.regressor_pattern
    columns, place = np.unique(entries, return_inverse=True)
    Y = np.zeros((dynamics.dof, len(tau), len(columns)))
    Y[drives, :, place] = motion.filtered(values)[:, keep]
    prior, still = prior_parameters(dynamics.robot)[columns], ~motion.moves[list(map.order)]
    expected = np.sqrt(np.mean((Y @ prior) ** 2, axis=1))
    scale = np.maximum(expected, 1e-3 * expected.max()) / np.where(still, AT_REST, 1.0)
    rows = DriveRows(scale, len(tau))
    Y = rows.stack(Y)
    return MapResidual(dynamics, map, z, share, rows, tau, Y, columns, prior, still, keep)
