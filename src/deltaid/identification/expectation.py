"""What torques a recording's drives should have shown, by a fit that a push does not bend.

In short blocks of time, whose means take the place of the filter, torques are fitted by iteratively
reweighted least squares with Tukey's biweight, which gives no weight at all to what is far off.
The residual is judged by its leverage, r / √(1 − h), or a sample that the fit has followed would
look good. Columns of all that a description may lack take part (`slack.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Regressor
from deltaid.identification.additions import Addition, Extended, entries, extended, extended_layout
from deltaid.identification.information import active_columns
from deltaid.identification.interpolation import between
from deltaid.identification.slack import OF_TORQUE, Slack, joint_rates
from deltaid.recording.masks.directions import Directions
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Time over which torques are averaged [s].
MEAN = 0.009
# Windows that are fitted to, and blocks in the fit, at most.
_MOST, _BLOCKS = 32, 1500
# Sweeps: with Huber's weights, then with Tukey's, at most; and the constants of both.
_CONVEX, _SWEEPS, _HUBER, _TUKEY = 6, 20, 1.345, 6.0
# How the prior pulls in the first sweep, with the usual torque as noise; leverage that a row
# has at most is 1 less this.
_START, _LEAST = 0.1, 0.05
# Scatter so many times that of noise is no noise.
NOISE = 1.5
# The largest change of the scales between sweeps that have settled.
_SETTLED = 1e-3
# Share of the samples below a drive's usual torque and speed; no residual is taken to be known
# better than this share of that torque.
_LARGE, _FLOOR = 0.9, 1e-3
# The deviation of a normal distribution for its median size.
_NORMAL = 1.4826
# Priors are drawn to with so many of their standard deviations, or with what makes this share of
# the usual torque.
_PRIOR, _EFFECT = 4.0, 0.1
# Torques may be late by so much [s] before that is known; a reversal says nothing for so long.
_APART = 5e-3
# Speeds, in equal parts of the blocks, whose scatter is looked at apart, each of so many at least.
_SPEEDS, _FEWEST = 8, 4


def deviation(x: Float[np.ndarray, "drives samples"]) -> Float[np.ndarray, " drives"]:
    """Standard deviation of each drive's values by their median size, without those that are NaN;
    zero where none is left."""
    sizes = (np.abs(row[np.isfinite(row)]) for row in x)
    return np.array([_NORMAL * np.median(row) if row.size else 0.0 for row in sizes])


@dataclass(frozen=True, eq=False)
class Source:
    """Whose torques are expected: a recording, and the columns that explain them.

    Attributes:
        dynamics: of the robot.
        additions: columns beside the robot's.
        recording: with the repairs that are known.
    """

    dynamics: Dynamics
    additions: tuple[Addition, ...]
    recording: Recording

    @cached_property
    def regressor(self) -> Regressor | Extended:
        """All columns."""
        return extended(self.dynamics, self.additions)

    @cached_property
    def active(self) -> Int[np.ndarray, " active"]:
        """Columns that show in some torque."""
        return active_columns(self.regressor)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the active columns."""
        layout = extended_layout(self.dynamics.layout, self.additions)
        return tuple(layout.parameters[k] for k in self.active)

    @cached_property
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Drive of each entry, and place of its column among the active ones."""
        rows, columns = self.regressor.regressor_pattern
        return rows, np.searchsorted(self.active, columns)

    def entries(self, w: Samples) -> Float[np.ndarray, "entries samples"]:
        """Of the regressor, in the order of the pattern."""
        return entries(self.regressor, w, w.tau, self.recording)

    def torques(
        self, values: Float[np.ndarray, "entries samples"], p: Float[np.ndarray, " active"]
    ) -> Float[np.ndarray, "dof samples"]:
        """Y p from the entries of Y."""
        rows, at = self.pattern
        return np.stack([p[at[rows == i]] @ values[rows == i] for i in range(self.dynamics.dof)])

    def counts(self, w: Samples) -> Bool[np.ndarray, "dof samples"]:
        """Whether a drive's torque counts, and all directions of friction in it are known."""
        known = Directions(np.inf, np.zeros(self.dynamics.dof)).known(
            self.dynamics.kinematics, w.z, w.qd, w.qdd, within=_APART
        )
        return ((w.weights > 0.5) & known).T


@dataclass(frozen=True, eq=False)
class Compared:
    """Torques at consecutive samples, drives in rows.

    Attributes:
        tau: the expected ones.
        left: recorded ones less these; NaN where they do not count.
        gear: what the gears carry of the expected ones: those without friction and rotors.
    """

    tau: Float[np.ndarray, "dof samples"]
    left: Float[np.ndarray, "dof samples"]
    gear: Float[np.ndarray, "dof samples"]


@dataclass(frozen=True, eq=False)
class Expectation:
    """Torques that a robot's motion asks for, and how far recorded ones scatter about them.

    Attributes:
        source: robot and recording.
        p: parameters of its active columns.
        slack: columns of what a description may lack.
        friction, of_torque: their coefficients.
        speeds: for each drive the ends of ranges of its speed [rad/s or m/s], ascending.
        scale: standard deviation of the residual's mean over `MEAN`, in each range [N m or N].
        noise: the same of single samples, from one to the next.
    """

    source: Source
    p: Float[np.ndarray, " active"]
    slack: Slack
    friction: Float[np.ndarray, " laws"]
    of_torque: Float[np.ndarray, " torques"]
    speeds: Float[np.ndarray, "dof ends"]
    scale: Float[np.ndarray, "dof ranges"]
    noise: Float[np.ndarray, " dof"]

    @property
    def rate(self) -> float:
        """Of the samples [Hz]."""
        return self.source.recording.log.rate

    @property
    def lags(self) -> Float[np.ndarray, " dof"]:
        """How late torques are, to first order [s]."""
        return 1e-3 * self.of_torque[::OF_TORQUE]

    @cached_property
    def coulomb(self) -> Float[np.ndarray, " dof"]:
        """Coulomb friction of each drive [N m or N]; zero without."""
        own = zip(self.source.parameters, self.p.tolist(), strict=True)
        found = {one.owner: value for one, value in own if one.symbol == "coulomb"}
        return np.array([found.get(drive, 0.0) for drive in self.source.dynamics.robot.drives])

    @property
    def misfit(self) -> Float[np.ndarray, " dof"]:
        """How many times what noise would be the residual's mean scatters."""
        return self.scale.min(axis=1) * np.sqrt(length(self.rate)) / self.noise

    @property
    def fits(self) -> bool:
        """Whether the residual is noise."""
        return bool(np.all(self.misfit <= NOISE))

    def compared(self, w: Samples) -> "Compared":
        """Recorded torques and expected ones at consecutive samples."""
        values = self.source.entries(w)
        tau = self._slackened(w, self.source.torques(values, self.p), self.rate)
        gear = self.source.torques(values, np.where(self._of_motors, 0.0, self.p))
        left = np.where(self.source.counts(w), w.tau.T - tau, np.nan)
        return Compared(tau, left, gear)

    def roughly_left(self, w: Samples, every: int) -> Float[np.ndarray, "dof samples"]:
        """Recorded torques less expected ones, as `compared` has it but for its errors.

        Expected ones are computed at each so-manieth sample, and follow between them from the two
        before and the two after; where one of these does not count, or a joint turns round among
        them, it is NaN.
        """
        if len(w.time) <= 3 * every:
            return self.compared(w).left
        knots = w.part(slice(None, None, every))
        tau = self.source.torques(self.source.entries(knots), self.p)
        tau = self._slackened(knots, tau, self.rate / every)
        forward, _ = joint_rates(self.slack.kinematics, knots)
        turns = np.append(np.any(np.diff(forward > 0, axis=0), axis=1), False)
        tau = np.where(self.source.counts(knots) & ~turns, tau, np.nan)
        return np.where(w.weights.T > 0.5, w.tau.T - between(tau, every, len(w.time)), np.nan)

    def _slackened(
        self, w: Samples, tau: Float[np.ndarray, "dof samples"], rate: float
    ) -> Float[np.ndarray, "dof samples"]:
        """Torques with those of the slack, at samples of some rate [Hz]."""
        rise = np.gradient(tau, axis=1) * rate if len(w.time) > 1 else 0 * tau
        more = np.einsum("dcs,c->ds", self.slack.friction(w), self.friction)
        more += np.einsum("dcs,c->ds", self.slack.of_torque(tau, rise, w.qd.T), self.of_torque)
        return tau + more

    def scales(self, w: Samples) -> Float[np.ndarray, "dof samples"]:
        """Standard deviation of the residual's mean at some samples."""
        ranges = zip(self.speeds, np.abs(w.qd.T), self.scale, strict=True)
        return np.stack([scale[np.searchsorted(ends, size)] for ends, size, scale in ranges])

    @cached_property
    def _of_motors(self) -> Bool[np.ndarray, " active"]:
        return np.array([one.kind in ("friction", "rotor") for one in self.source.parameters])


def length(rate: float) -> int:
    """Samples that are averaged: odd, so that their middle is one of them."""
    return max(1, 2 * round(0.5 * (MEAN * rate - 1)) + 1)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def expect(source: Source) -> Expectation | None:
    """Fit a recording; of a long one its excerpt. None if it tells nothing."""
    recording, kinematics = source.recording, source.dynamics.kinematics
    size = length(recording.log.rate)
    parts = [w.own for w in recording.brief.spread(kinematics, _MOST)]
    parts = [w for w in parts if len(w.time) >= size]
    blocks = _blocks(source, parts, size) if parts else None
    if blocks is None or not np.any(blocks.counts.sum(axis=1) >= _FEWEST * _SPEEDS):
        return None
    p, friction, of_torque, scale = _fitted(blocks, source.parameters)
    left = blocks.tau - blocks.Y @ p - np.einsum("dcb,c->db", blocks.friction, friction)
    left -= np.einsum("dcb,c->db", blocks.torque_columns(p), of_torque)
    speeds, scale = _by_speed(blocks, left, scale)
    found = Expectation(
        source, p, blocks.slack, friction, of_torque, speeds, scale, np.zeros(len(scale))
    )
    steps = [np.diff(found.compared(w).left, axis=1) for w in parts]
    noise = deviation(np.concatenate(steps, axis=1)) / np.sqrt(2)
    return replace(found, noise=np.maximum(noise, _FLOOR * np.sqrt(size) * blocks.slack.torque))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Means over short blocks of time.

    Attributes:
        Y, rise: active columns of the regressor, and their rise [1/s].
        friction: columns of the slack.
        tau, speed: recorded torques, and speeds of the drives.
        counts: which of a drive's blocks do.
    """

    slack: Slack
    Y: Float[np.ndarray, "dof blocks columns"]
    rise: Float[np.ndarray, "dof blocks columns"]
    friction: Float[np.ndarray, "dof further blocks"]
    tau: Float[np.ndarray, "dof blocks"]
    speed: Float[np.ndarray, "dof blocks"]
    counts: Bool[np.ndarray, "dof blocks"]

    def torque_columns(self, p: np.ndarray) -> Float[np.ndarray, "dof further blocks"]:
        """Columns of the slack that follow from the torques of parameters p."""
        return self.slack.of_torque(self.Y @ p, self.rise @ p, self.speed)


def _blocks(source: Source, parts: Sequence[Samples], size: int) -> _Blocks:
    kinematics = source.dynamics.kinematics
    speed = _usual([joint_rates(kinematics, w)[0] for w in parts])
    slack = Slack(kinematics, speed, _usual([w.tau for w in parts]))
    every = max(1, sum(len(w.time) // size for w in parts) // _BLOCKS)
    made = [_of_part(source, w, size, every, slack) for w in parts]
    axes = (1, 1, 2, 1, 1, 1)
    return _Blocks(
        slack, *(np.concatenate([one[k] for one in made], axis=axis) for k, axis in enumerate(axes))
    )


def _usual(parts: Sequence[np.ndarray]) -> Float[np.ndarray, " channels"]:
    """A large size of each channel that is not the push of an event; 1 where all are zero."""
    size = np.quantile(np.abs(np.concatenate(parts)), _LARGE, axis=0)
    return np.where(size > 0, size, 1.0)


def _of_part(
    source: Source, w: Samples, size: int, every: int, slack: Slack
) -> tuple[np.ndarray, ...]:
    """Blocks of one window: Y, its rise, friction, τ, speeds, and which count."""
    count = len(w.time) // size
    w = w.part(slice(0, count * size))
    rows, at = source.pattern

    def cut(x: np.ndarray) -> np.ndarray:
        return x.reshape(*x.shape[:-1], count, size)[..., ::every, :]

    values, counted = cut(source.entries(w)), cut(source.counts(w).astype(float))
    sums = counted.sum(axis=-1)
    share = counted / np.maximum(sums, 1.0)[..., None]
    Y = np.zeros((source.dynamics.dof, values.shape[1], len(source.active)))
    rise = np.zeros_like(Y)
    Y[rows, :, at] = np.einsum("ebs,ebs->eb", values, share[rows])
    rise[rows, :, at] = (values[..., -1] - values[..., 0]) * (
        source.recording.log.rate / max(1, size - 1)
    )
    friction = np.einsum("dcbs,dbs->dcb", cut(slack.friction(w)), share)
    tau = np.einsum("dbs,dbs->db", cut(w.tau.T), share)
    return Y, rise, friction, tau, cut(w.qd.T).mean(axis=-1), sums > 0.5 * size


def _fitted(b: _Blocks, parameters: Sequence[Parameter]) -> tuple[np.ndarray, ...]:
    """p, coefficients of friction and of torque, and scatter, by reweighted least squares."""
    dof, torque, columns = len(b.tau), b.slack.torque, b.Y.shape[2]
    prior = np.array([one.prior for one in parameters])
    spread = _PRIOR * np.array([one.std for one in parameters])
    effect = np.sqrt(np.mean((b.Y / torque[:, None, None]) ** 2, axis=(0, 1)))
    spread = np.maximum(spread, _EFFECT / np.where(effect > 0, effect, np.inf))
    spread = np.append(spread, b.slack.deviations)
    target, p, x = b.tau - b.Y @ prior, prior, np.zeros(len(spread))
    weights, scale = b.counts.astype(float), np.full(dof, np.nan)
    root = weights / torque[:, None]
    for sweep in range(_SWEEPS):
        further = np.concatenate([b.friction, b.torque_columns(p)], axis=1)
        A = np.concatenate([b.Y, np.moveaxis(further, 1, 2)], axis=2) * spread
        y, h = _ridge(A, target, root, 1.0 if sweep else _START)
        x = spread * y
        p = prior + x[:columns]
        judged = (target - A @ y) / np.sqrt(np.maximum(1.0 - h, _LEAST))
        before, scale = scale, deviation(np.where(b.counts, judged, np.nan))
        scale = np.maximum(scale, _FLOOR * torque)
        size = np.abs(judged) / scale[:, None]
        if sweep < _CONVEX:
            weights = b.counts * np.minimum(1.0, _HUBER / np.maximum(size, _HUBER))
        else:
            weights = b.counts * np.clip(1.0 - (size / _TUKEY) ** 2, 0.0, None) ** 2
        root = np.sqrt(weights) / scale[:, None]
        if sweep > _CONVEX and np.all(np.abs(scale - before) <= _SETTLED * scale):
            break
    friction = columns + b.friction.shape[1]
    return p, x[columns:friction], x[friction:], scale


def _ridge(
    A: Float[np.ndarray, "dof blocks columns"],
    target: Float[np.ndarray, "dof blocks"],
    root: Float[np.ndarray, "dof blocks"],
    pull: float,
) -> tuple[Float[np.ndarray, " columns"], Float[np.ndarray, "dof blocks"]]:
    """y of min ‖root (A y − target)‖² + pull² ‖y‖², and the leverage h of each row."""
    n = A.shape[2]
    rows = (A * root[..., None]).reshape(-1, n)
    R = np.linalg.qr(np.vstack([rows, pull * np.eye(n)]), mode="r")
    on_axes = solve_triangular(R, rows.T, trans="T")
    y = solve_triangular(R, on_axes @ (target * root).ravel())
    return y, np.sum(on_axes**2, axis=0).reshape(target.shape)


def _by_speed(
    b: _Blocks, left: Float[np.ndarray, "dof blocks"], scale: Float[np.ndarray, " dof"]
) -> tuple[np.ndarray, np.ndarray]:
    """Ends of ranges of speed, and scatter in each, no less than that of all.

    What scatters more at some speeds is friction, and no event stands out there. Of a drive of
    which next to nothing counts, none does.
    """
    ends, scales = [], []
    for one, speed, counts, whole in zip(left, np.abs(b.speed), b.counts, scale, strict=True):
        if counts.sum() < _FEWEST * _SPEEDS:
            ends.append(np.zeros(_SPEEDS - 1))
            scales.append(np.full(_SPEEDS, np.inf))
            continue
        edges = np.quantile(speed[counts], np.linspace(0, 1, _SPEEDS + 1)[1:-1])
        at = np.searchsorted(edges, speed)
        own = [deviation(one[None, counts & (at == k)])[0] for k in range(_SPEEDS)]
        ends.append(edges)
        scales.append(np.maximum(own, whole))
    return np.array(ends), np.array(scales)
