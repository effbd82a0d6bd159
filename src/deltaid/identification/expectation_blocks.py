"""Means over short blocks of time, fitted by iteratively reweighted least squares.

Tukey's biweight gives no weight at all to what is far off. The residual is judged by its leverage,
r / √(1 − h), or a sample that the fit has followed would look good.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.identification.expectation_source import Nuisance, Source, joint_rates, of_torques
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Blocks in the fit, at most.
_BLOCKS = 1500
# Sweeps: with Huber's weights, then with Tukey's, at most; and the constants of both.
_CONVEX, _SWEEPS, _HUBER, _TUKEY = 6, 20, 1.345, 6.0
# How the prior pulls in the first sweep, with the usual torque as noise; leverage that a row
# has at most is 1 less this.
_START, _LEAST = 0.1, 0.05
# The largest change of the scales between sweeps that have settled.
_SETTLED = 1e-3
# Share of the samples below a drive's usual torque and speed; no residual is taken to be known
# better than this share of that torque.
_LARGE, FLOOR = 0.9, 1e-3
# The deviation of a normal distribution for its median size.
_NORMAL = 1.4826
# Priors are drawn to with so many of their standard deviations, or with what makes this share of
# the usual torque.
_PRIOR, _EFFECT = 4.0, 0.1
# Ranges of speed with equal parts of the blocks and separate scatter, each of so many at least.
_SPEEDS, _FEWEST = 8, 4

OfBlocks = Float[np.ndarray, "dof blocks"]


def deviation(values: Float[np.ndarray, "drives samples"]) -> Float[np.ndarray, " drives"]:
    """Standard deviation of each drive's values by their median size, without NaN; zero without
    any."""
    sizes = (np.abs(row[np.isfinite(row)]) for row in values)
    return np.array([_NORMAL * np.median(row) if row.size else 0.0 for row in sizes])


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means over short blocks of time.

    Attributes:
        Y, rise: active columns of the regressor, and their rise [1/s].
        friction: nuisance columns that follow from the motion.
        tau, speed: recorded torques, and speeds of the drives.
        counts: which of a drive's blocks do.
    """

    nuisance: Nuisance
    Y: Float[np.ndarray, "dof blocks columns"]
    rise: Float[np.ndarray, "dof blocks columns"]
    friction: Float[np.ndarray, "dof blocks nuisances"]
    tau: OfBlocks
    speed: OfBlocks
    counts: Bool[np.ndarray, "dof blocks"]

    @property
    def tells(self) -> bool:
        """Whether some drive has enough blocks that count."""
        return bool(np.any(self.counts.sum(axis=1) >= _FEWEST * _SPEEDS))

    def beside(self, p: Float[np.ndarray, " parameters"]) -> ColumnsOfDrives:
        """All nuisance columns, those of torques by parameters p."""
        of_torque = of_torques(self.Y @ p, self.rise @ p, self.speed)
        return np.concatenate([self.friction, of_own_drives(of_torque.transpose(0, 2, 1))], axis=2)


def blocks_of(source: Source, parts: Sequence[Samples], size: int) -> Blocks:
    """Blocks of so many samples from all parts, evenly thinned where there are many."""
    kinematics = source.dynamics.kinematics
    speed = _usual([joint_rates(kinematics, w)[0] for w in parts])
    nuisance = Nuisance(kinematics, speed, _usual([w.tau for w in parts]))
    stride = max(1, sum(len(w.time) // size for w in parts) // _BLOCKS)
    means = [_of_part(source, w, size, stride, nuisance) for w in parts]
    return Blocks(nuisance, *(np.concatenate(part, axis=1) for part in zip(*means, strict=True)))


def _usual(parts: Sequence[np.ndarray]) -> Float[np.ndarray, " channels"]:
    """A large size of each channel that is not the push of an event; 1 where all are zero."""
    size = np.quantile(np.abs(np.concatenate(parts)), _LARGE, axis=0)
    return np.where(size > 0, size, 1.0)


def _of_part(
    source: Source, w: Samples, size: int, stride: int, nuisance: Nuisance
) -> tuple[np.ndarray, ...]:
    """What `Blocks` has of one window."""
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
    rise[rows, :, columns] = (values[..., -1] - values[..., 0]) * (
        source.recording.log.rate / max(1, size - 1)
    )
    friction = np.einsum("dcbs,dbs->dbc", cut(nuisance.friction(w)), share)
    tau = np.einsum("dbs,dbs->db", cut(w.tau.T), share)
    return Y, rise, friction, tau, cut(w.qd.T).mean(axis=-1), sums > 0.5 * size


def fitted(b: Blocks, parameters: Sequence[Parameter]) -> tuple[np.ndarray, ...]:
    """p, coefficients of nuisance columns, and scatter, by reweighted least squares."""
    torque, columns = b.nuisance.torque, b.Y.shape[2]
    prior = np.array([parameter.prior for parameter in parameters])
    spread = _PRIOR * np.array([parameter.std for parameter in parameters])
    effect = np.sqrt(np.mean((b.Y / torque[:, None, None]) ** 2, axis=(0, 1)))
    spread = np.maximum(spread, _EFFECT / np.where(effect > 0, effect, np.inf))
    spread = np.append(spread, b.nuisance.deviations)
    target, p, x = b.tau - b.Y @ prior, prior, np.zeros(len(spread))
    weights, scale = b.counts.astype(float), np.full(len(torque), np.nan)
    root = weights / torque[:, None]
    for sweep in range(_SWEEPS):
        A = np.concatenate([b.Y, b.beside(p)], axis=2) * spread
        y, h = _ridge(A, target, root, 1.0 if sweep else _START)
        x = spread * y
        p = prior + x[:columns]
        judged = (target - A @ y) / np.sqrt(np.maximum(1.0 - h, _LEAST))
        before, scale = scale, deviation(np.where(b.counts, judged, np.nan))
        scale = np.maximum(scale, FLOOR * torque)
        size = np.abs(judged) / scale[:, None]
        if sweep < _CONVEX:
            weights = b.counts * np.minimum(1.0, _HUBER / np.maximum(size, _HUBER))
        else:
            weights = b.counts * np.clip(1.0 - (size / _TUKEY) ** 2, 0.0, None) ** 2
        root = np.sqrt(weights) / scale[:, None]
        if sweep > _CONVEX and np.all(np.abs(scale - before) <= _SETTLED * scale):
            break
    return p, x[columns:], scale


def _ridge(
    A: ColumnsOfDrives, target: OfBlocks, root: OfBlocks, pull: float
) -> tuple[Float[np.ndarray, " columns"], OfBlocks]:
    """y of min ‖root (A y − target)‖² + pull² ‖y‖², and the leverage h of each row.

    The pull keeps the normal equations well conditioned, which take a third of the time of QR: with
    that a whole identification would take 6 to 8 % longer.
    """
    n = A.shape[2]
    rows = (A * root[..., None]).reshape(-1, n)
    L = np.linalg.cholesky(rows.T @ rows + pull**2 * np.eye(n))
    on_axes = solve_triangular(L, rows.T, lower=True)
    y = solve_triangular(L, on_axes @ (target * root).ravel(), lower=True, trans="T")
    return y, np.sum(on_axes**2, axis=0).reshape(target.shape)


def by_speed(
    b: Blocks, r: OfBlocks, scale: Float[np.ndarray, " dof"]
) -> tuple[np.ndarray, np.ndarray]:
    """Ends of ranges of speed, and scatter in each, no less than that of all.

    More scatter at some speeds is friction, no event. Of a drive with too few blocks, none
    counts.
    """
    dof = len(r)
    ends, scales = np.zeros((dof, _SPEEDS - 1)), np.full((dof, _SPEEDS), np.inf)
    for i, (speed, counts) in enumerate(zip(np.abs(b.speed), b.counts, strict=True)):
        if counts.sum() < _FEWEST * _SPEEDS:
            continue
        ends[i] = np.quantile(speed[counts], np.linspace(0, 1, _SPEEDS + 1)[1:-1])
        bins = np.searchsorted(ends[i], speed)
        spread = deviation(np.where(counts & (bins == np.arange(_SPEEDS)[:, None]), r[i], np.nan))
        scales[i] = np.maximum(spread, scale[i])
    return ends, scales
