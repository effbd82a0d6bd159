"""What torques a recording's drives should have shown, by a fit that a push does not bend.

In short blocks of time, whose means take the place of the filter, torques are fitted robustly
(`expectation_blocks.py`) by the robot's columns and nuisance columns (`expectation_source.py`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view
from threadpoolctl import threadpool_limits

from deltaid.identification.expectation_blocks import (
    FLOOR,
    blocks_of,
    by_speed,
    deviation,
    fitted,
)
from deltaid.identification.expectation_source import Nuisance, Source, Torques, joint_rates
from deltaid.recording.delay import around
from deltaid.recording.windows import Samples

# Time over which torques are averaged [s].
_MEAN = 0.009
# Windows that are fitted to, at most.
_MOST = 32
# Scatter more than so many times that of noise is misfit.
NOISE = 1.5


@dataclass(frozen=True, eq=False)
class Expectation:
    """Torques that a robot's motion asks for, and how far recorded ones scatter about them.

    Attributes:
        p: parameters of the source's active columns.
        x: coefficients of the nuisance columns.
        speeds: for each drive the ends of ranges of its speed [rad/s or m/s], ascending.
        scale: standard deviation of the residual's mean over `_MEAN`, in each range [N m or N].
        noise: the same of single samples, from one to the next.
    """

    source: Source
    p: Float[np.ndarray, " active"]
    nuisance: Nuisance
    x: Float[np.ndarray, " columns"]
    speeds: Float[np.ndarray, "dof ends"]
    scale: Float[np.ndarray, "dof ranges"]
    noise: Float[np.ndarray, " dof"]

    @property
    def rate(self) -> float:
        return self.source.recording.log.rate

    @property
    def length(self) -> int:
        """Samples that are averaged."""
        return _length(self.rate)

    @property
    def lags(self) -> Float[np.ndarray, " dof"]:
        """How late torques are, to first order [s]."""
        return self.nuisance.lags(self.x)

    @cached_property
    def coulomb(self) -> Float[np.ndarray, " dof"]:
        """Coulomb friction of each drive [N m or N]; zero without."""
        pairs = zip(self.source.parameters, self.p.tolist(), strict=True)
        coulomb = {entry.owner: value for entry, value in pairs if entry.symbol == "coulomb"}
        return np.array([coulomb.get(drive, 0.0) for drive in self.source.dynamics.robot.drives])

    @property
    def misfit(self) -> Float[np.ndarray, " dof"]:
        """How many times what noise would be the residual's mean scatters."""
        return self.scale.min(axis=1) * np.sqrt(self.length) / self.noise

    @property
    def fits(self) -> bool:
        return bool(np.all(self.misfit <= NOISE))

    def compared(self, w: Samples) -> tuple[Torques, Torques]:
        """Recorded torques less expected ones at consecutive samples, NaN where they do not count;
        and what gears carry of the expected ones: those without friction and rotors."""
        values = self.source.entries(w)
        tau = self._expected(w, values, self.rate)
        gear = self.source.torques(values, np.where(self._of_motors, 0.0, self.p))
        return np.where(self.source.counts(w), w.tau.T - tau, np.nan), gear

    def rough_residual(self, w: Samples, stride: int) -> Torques:
        """Recorded torques less expected ones, as `compared` has it but for its errors.

        Expected ones are computed at each `stride`-th sample and interpolated from four; where one
        of these does not count, or a joint turns round among them, it is NaN.
        """
        if len(w.time) <= 3 * stride:
            return self.compared(w)[0]
        knots = w.part(slice(None, None, stride))
        tau = self._expected(knots, self.source.entries(knots), self.rate / stride)
        forward, _ = joint_rates(self.nuisance.kinematics, knots)
        turns = np.append(np.any(np.diff(forward > 0, axis=0), axis=1), False)
        tau = np.where(self.source.counts(knots) & ~turns, tau, np.nan)
        return np.where(w.weights.T > 0.5, w.tau.T - _between(tau, stride, len(w.time)), np.nan)

    def _expected(
        self, w: Samples, values: Float[np.ndarray, "entries samples"], rate: float
    ) -> Torques:
        return self.nuisance.added(w, self.source.torques(values, self.p), rate, self.x)

    def scales(self, w: Samples) -> Float[np.ndarray, "dof samples"]:
        """Standard deviation of the residual's mean at some samples."""
        ranges = zip(self.speeds, np.abs(w.qd.T), self.scale, strict=True)
        return np.stack([scale[np.searchsorted(ends, size)] for ends, size, scale in ranges])

    @cached_property
    def _of_motors(self) -> Bool[np.ndarray, " active"]:
        return np.array([entry.kind in ("friction", "rotor") for entry in self.source.parameters])


def _length(rate: float) -> int:
    """Samples that are averaged: odd, so that their middle is one of them."""
    return max(1, 2 * round(0.5 * (_MEAN * rate - 1)) + 1)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def expect(source: Source) -> Expectation | None:
    """Fit a recording; of a long one its excerpt. None without enough data."""
    recording, size = source.recording, _length(source.recording.log.rate)
    parts = [w.own for w in recording.brief.spread(source.dynamics.kinematics, _MOST)]
    parts = [w for w in parts if len(w.time) >= size]
    blocks = blocks_of(source, parts, size) if parts else None
    if blocks is None or not blocks.tells:
        return None
    p, x, scale = fitted(blocks, source.parameters)
    speeds, scale = by_speed(blocks, blocks.tau - blocks.Y @ p - blocks.beside(p) @ x, scale)
    fit = Expectation(source, p, blocks.nuisance, x, speeds, scale, np.zeros(len(scale)))
    steps = [np.diff(fit.compared(w)[0], axis=1) for w in parts]
    noise = deviation(np.concatenate(steps, axis=1)) / np.sqrt(2)
    return replace(fit, noise=np.maximum(noise, FLOOR * np.sqrt(size) * blocks.nuisance.torque))


def _between(
    x: Float[np.ndarray, "channels knots"], stride: int, samples: int
) -> Float[np.ndarray, "channels samples"]:
    """Values at all samples from every `stride`-th, by cubics through four neighbours."""
    before = 3 * (x[:, :1] - x[:, 1:2]) + x[:, 2:3]
    after = 3 * (x[:, -1:] - x[:, -2:-1]) + x[:, -3:-2]
    beyond = 3 * (after - x[:, -1:]) + x[:, -2:-1]
    shares = np.zeros((4, stride))
    for k in range(stride):
        for knot, share in around(k / stride, 2):
            shares[1 + knot, k] = share
    values = sliding_window_view(np.hstack([before, x, after, beyond]), 4, axis=1) @ shares
    return values.reshape(len(x), -1)[:, :samples]
