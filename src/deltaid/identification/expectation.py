"""Expected torques of a recording, by a robust fit that pushes do not bias.

Means over short blocks of time replace the filter. Iteratively reweighted least squares fits them
by the robot's columns and nuisance columns (`expectation_source.py`): Tukey's biweight gives no
weight to outliers. Residuals are scaled by their leverage, r / √(1 − h), for rows of high leverage
pull the fit towards themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.estimation.scatter import ROBUST
from deltaid.identification.expectation_source import (
    SHARE,
    ExplainedRecording,
    Nuisance,
    Torques,
    joint_rates,
    of_torques,
)
from deltaid.levels import HARDLY, SETTLED, STRONG
from deltaid.recording.log import MOST_WINDOWS
from deltaid.recording.windows import SampleBlock

# Time over which torques are averaged [s], and number of blocks that are fitted at most.
_MEAN, _BLOCKS = 0.009, 1500
# Scatter above this multiple of noise is misfit.
NOISE = 1.5
# Sweeps with Huber's weights, whose fit is convex, and all sweeps at most; tuning constant of
# Huber's weights (95 % efficient), in standard deviations.
_CONVEX, _SWEEPS, _HUBER = 6, 20, 1.345
# Weight of the prior in the first sweep, where the usual torque counts as noise; least 1 − h.
_START, _LEAST = 0.1, 0.05
# Quantile of the torques and speeds of a drive that is its usual one.
_LARGE = 0.9
# Width of a robot's priors, in their standard deviations.
_PRIOR = 4.0
# Number of ranges of speed with separate scatter, and fewest blocks in one.
_SPEEDS, _FEWEST = 8, 4

OfBlocks = Float[np.ndarray, "dof blocks"]


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected torques of a motion, and the scatter of recorded ones about them."""

    source: ExplainedRecording
    p: Float[np.ndarray, " active"]  # parameters of the source's active columns
    nuisance: Nuisance
    x: Float[np.ndarray, " columns"]  # coefficients of the nuisance columns
    # for each drive the ends of ranges of its speed [rad/s or m/s], ascending, and the standard
    # deviation of the residual's mean over `_MEAN` in each range [N m or N]
    speeds: Float[np.ndarray, "dof ends"]
    scale: Float[np.ndarray, "dof ranges"]
    noise: Float[np.ndarray, " dof"]  # the same of single samples, from one to the next

    @property
    def rate(self) -> float:
        return self.source.recording.log.rate

    @property
    def length(self) -> int:
        return _length(self.rate)

    @property
    def lags(self) -> Float[np.ndarray, " dof"]:
        """How late torques are, to first order [s]."""
        return self.nuisance.lags(self.x)

    @property
    def coulomb(self) -> Float[np.ndarray, " dof"]:
        """Coulomb friction of each drive [N m or N]; zero without."""
        pairs = zip(self.source.parameters, self.p.tolist(), strict=True)
        coulomb = {entry.owner: value for entry, value in pairs if entry.symbol == "coulomb"}
        return np.array([coulomb.get(drive, 0.0) for drive in self.source.dynamics.robot.drives])

    @property
    def misfit(self) -> Float[np.ndarray, " dof"]:
        """Scatter of the residual's mean as a multiple of that by noise alone."""
        return self.scale.min(axis=1) * np.sqrt(self.length) / self.noise

    @property
    def fits(self) -> bool:
        return bool(np.all(self.misfit <= NOISE))

    def compared(self, w: SampleBlock) -> tuple[Torques, Torques]:
        """Recorded less expected torques at consecutive samples, NaN where they do not count; and
        expected torques without the friction and rotors of motors, which gears carry."""
        values, motors = self.source.entries(w), ("friction", "rotor")
        tau = self.nuisance.added(w, self.source.torques(values, self.p), self.rate, self.x)
        of_motors = [entry.kind in motors for entry in self.source.parameters]
        gear = self.source.torques(values, np.where(of_motors, 0.0, self.p))
        return np.where(self.source.counts(w), w.tau.T - tau, np.nan), gear

    def scales(self, w: SampleBlock) -> Float[np.ndarray, "dof samples"]:
        ranges = zip(self.speeds, np.abs(w.qd.T), self.scale, strict=True)
        return np.stack([scale[np.searchsorted(ends, size)] for ends, size, scale in ranges])


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def expect(source: ExplainedRecording) -> Expectation | None:
    """Fit a recording, or the excerpt of a long one; None without enough data."""
    recording, size = source.recording, _length(source.recording.log.rate)
    parts = [w.inner for w in recording.brief.spread(source.dynamics.kinematics, MOST_WINDOWS)]
    parts = [w for w in parts if len(w.time) >= size]
    blocks = _Blocks.cut(source, parts, size) if parts else None
    if blocks is None or not np.any(blocks.counts.sum(axis=1) >= _FEWEST * _SPEEDS):
        return None
    p, x, scale = _fitted(blocks, source)
    speeds, scale = _by_speed(
        blocks, blocks.tau - blocks.Y @ p - blocks.nuisance_columns(p) @ x, scale
    )
    fit = Expectation(source, p, blocks.nuisance, x, speeds, scale, np.zeros(len(scale)))
    steps = [np.diff(fit.compared(w)[0], axis=1) for w in parts]
    noise = deviation(np.concatenate(steps, axis=1)) / np.sqrt(2)
    return replace(fit, noise=np.maximum(noise, HARDLY * np.sqrt(size) * blocks.nuisance.torque))


def deviation(values: Float[np.ndarray, "drives samples"]) -> Float[np.ndarray, " drives"]:
    """Robust standard deviation by the median size, without NaN; zero without any value."""
    sizes = (np.abs(row[np.isfinite(row)]) for row in values)
    return np.array([ROBUST * np.median(row) if row.size else 0.0 for row in sizes])


def _length(rate: float) -> int:
    """Number of samples that are averaged, odd to be centred at one."""
    return max(1, 2 * round(0.5 * (_MEAN * rate - 1)) + 1)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Means over short blocks of time, evenly thinned where there are many."""

    nuisance: Nuisance
    Y: Float[np.ndarray, "dof blocks columns"]  # active columns of the regressor
    rise: Float[np.ndarray, "dof blocks columns"]  # of these [1/s]
    friction: Float[np.ndarray, "dof blocks nuisances"]  # columns that follow from the motion
    tau: OfBlocks
    speed: OfBlocks
    counts: Bool[np.ndarray, "dof blocks"]  # whether most samples of a drive's block count

    @classmethod
    def cut(cls, source: ExplainedRecording, parts: Sequence[SampleBlock], size: int) -> "_Blocks":
        """Blocks of so many samples from all parts."""
        kinematics = source.dynamics.kinematics
        large = (
            np.quantile(np.abs(np.concatenate(values)), _LARGE, axis=0)
            for values in ([joint_rates(kinematics, w)[0] for w in parts], [w.tau for w in parts])
        )
        speed, torque = (np.where(values > 0, values, 1.0) for values in large)
        nuisance = Nuisance(kinematics, speed, torque)
        stride = max(1, sum(len(w.time) // size for w in parts) // _BLOCKS)
        means = [cls._of_part(source, w, size, stride, nuisance) for w in parts]
        return cls(nuisance, *(np.concatenate(part, axis=1) for part in zip(*means, strict=True)))

    @staticmethod
    def _of_part(
        source: ExplainedRecording, w: SampleBlock, size: int, stride: int, nuisance: Nuisance
    ) -> tuple[np.ndarray, ...]:
        count = len(w.time) // size
        w = w.part(slice(0, count * size))
        rows, columns = source.pattern

        def cut(samples: np.ndarray) -> np.ndarray:
            return samples.reshape(*samples.shape[:-1], count, size)[..., ::stride, :]

        values, counted = cut(source.entries(w)), cut(source.counts(w).astype(float))
        sums = counted.sum(axis=-1)
        share = counted / np.maximum(sums, 1.0)[..., None]
        Y = np.zeros((source.dynamics.dof, values.shape[1], len(source.active)))
        rise = np.zeros_like(Y)
        Y[rows, :, columns] = np.einsum("ebs,ebs->eb", values, share[rows])
        per_second = source.recording.log.rate / max(1, size - 1)
        rise[rows, :, columns] = (values[..., -1] - values[..., 0]) * per_second
        friction = np.einsum("dcbs,dbs->dbc", cut(nuisance.friction(w)), share)
        tau = np.einsum("dbs,dbs->db", cut(w.tau.T), share)
        return Y, rise, friction, tau, cut(w.qd.T).mean(axis=-1), sums > 0.5 * size

    def nuisance_columns(self, p: Float[np.ndarray, " parameters"]) -> ColumnsOfDrives:
        """All nuisance columns, those of torques by parameters p."""
        of_torque = of_torques(self.Y @ p, self.rise @ p, self.speed)
        return np.concatenate([self.friction, of_own_drives(of_torque.transpose(0, 2, 1))], axis=2)


def _fitted(b: _Blocks, source: ExplainedRecording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p, coefficients of nuisance columns, and scatter, by reweighted least squares."""
    torque, columns = b.nuisance.torque, b.Y.shape[2]
    prior = np.array([parameter.prior for parameter in source.parameters])
    spread = _PRIOR * np.array([parameter.std for parameter in source.parameters])
    effect = np.sqrt(np.mean((b.Y / torque[:, None, None]) ** 2, axis=(0, 1)))
    spread = np.maximum(spread, SHARE / np.where(effect > 0, effect, np.inf))
    spread = np.append(spread, b.nuisance.deviations)
    target, p, x = b.tau - b.Y @ prior, prior, np.zeros(len(spread))
    scale, root = np.full(len(torque), np.nan), b.counts / torque[:, None]
    for sweep in range(_SWEEPS):
        A = np.concatenate([b.Y, b.nuisance_columns(p)], axis=2) * spread
        y, h = _ridge(A, target, root, 1.0 if sweep else _START)
        x = spread * y
        p = prior + x[:columns]
        judged = (target - A @ y) / np.sqrt(np.maximum(1.0 - h, _LEAST))
        before, scale = scale, deviation(np.where(b.counts, judged, np.nan))
        scale = np.maximum(scale, HARDLY * torque)
        size = np.abs(judged) / scale[:, None]
        weights = np.clip(1.0 - (size / STRONG) ** 2, 0.0, None) ** 2  # none to strong outliers
        if sweep < _CONVEX:
            weights = _HUBER / np.maximum(size, _HUBER)
        root = np.sqrt(b.counts * weights) / scale[:, None]
        if sweep > _CONVEX and np.all(np.abs(scale - before) <= SETTLED * scale):
            break
    return p, x[columns:], scale


def _ridge(
    A: ColumnsOfDrives, target: OfBlocks, root: OfBlocks, pull: float
) -> tuple[Float[np.ndarray, " columns"], OfBlocks]:
    """y of min ‖root (A y − target)‖² + pull² ‖y‖², and the leverage h of each row.

    The pull keeps the normal equations well conditioned. They take a third of the time of QR, with
    which a whole identification would take 6 to 8 % longer.
    """
    n = A.shape[2]
    rows = (A * root[..., None]).reshape(-1, n)
    L = np.linalg.cholesky(rows.T @ rows + pull**2 * np.eye(n))
    on_axes = solve_triangular(L, rows.T, lower=True)
    y = solve_triangular(L, on_axes @ (target * root).ravel(), lower=True, trans="T")
    return y, np.sum(on_axes**2, axis=0).reshape(target.shape)


def _by_speed(
    b: _Blocks, r: OfBlocks, scale: Float[np.ndarray, " dof"]
) -> tuple[np.ndarray, np.ndarray]:
    """Ends of ranges of speed, and scatter in each, at least that of all.

    More scatter at some speeds comes from friction, not from events. For a drive with too few
    blocks it is infinite.
    """
    ends, scales = np.zeros((len(r), _SPEEDS - 1)), np.full((len(r), _SPEEDS), np.inf)
    for i, (speed, counts) in enumerate(zip(np.abs(b.speed), b.counts, strict=True)):
        if counts.sum() < _FEWEST * _SPEEDS:
            continue
        ends[i] = np.quantile(speed[counts], np.linspace(0, 1, _SPEEDS + 1)[1:-1])
        bins = np.searchsorted(ends[i], speed)
        spread = deviation(np.where(counts & (bins == np.arange(_SPEEDS)[:, None]), r[i], np.nan))
        scales[i] = np.maximum(spread, scale[i])
    return ends, scales
