"""Logs that drives write of a moving machine."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import polars as pl
from scipy.signal import butter, lfilter

from drives.happening import Happening, within
from logs import tabled
from oracle.tree import Array

# Encoder step of a motor at the joint (rad); lead of a spindle (m per turn); noise of readings
# (steps).
_STEP, _LEAD, _DITHER = 2 * np.pi / 2**17 / 20, 0.02, 0.2


@dataclass(frozen=True, eq=False)
class Sensors:
    """Measurement and log of the drives; numbers are the same for all drives, or (drives,).

    Attributes:
        noise: of torques, as a share of each drive's largest without contacts.
        delay: lag of torque columns (s).
        current_loop: cut-off of a first-order filter on torques (Hz).
        second_order: cut-off of a Butterworth filter of second order on torques (Hz).
        average: time over which each row averages the torque until then (s).
        velocity, velocity_lag: whether q̇ is recorded, and its filter's time constant (s).
        clip: share of the largest torque at which torque columns saturate.
        gain: of the torque constants: recorded = gain × true.
        believed: recorded torque as a function of the true one, both as shares of the largest true
            torque.
        offset: of the torque columns, as a share of the largest.
        ripple: over the angle, as a share of the largest torque.
        waves, phase: of the ripple, the sine of waves · q + phase (rad per rad or m; rad).
        scale: ratio of the recorded angle to the true one.
        homing: error of q's zero (rad, m).
        stale: share of rows that repeat the previous one.
        hold: time between two updates of a torque column, which holds its value in between (s);
            updates do not shift with the delay.
        held_noise: whether noise arises in the drive, and is held as well; else in the log.
        clocks: relative error of the torques' clock, positive if it is fast.
        gripper: whether a column reports when a load is held.
    """

    noise: float = 0.02
    delay: Array | float = 0.0
    current_loop: float | None = None
    second_order: float | None = None
    average: float = 0.0
    velocity: bool = False
    velocity_lag: float = 0.0
    clip: float | None = None
    gain: Array | float = 1.0
    believed: Callable[[Array], Array] | None = None
    offset: Array | float = 0.0
    ripple: Array | float = 0.0
    waves: Array | float = 12.0
    phase: Array | float = 0.0
    scale: Array | float = 1.0
    homing: Array | float = 0.0
    stale: float = 0.0
    hold: float = 0.0
    held_noise: bool = True
    clocks: float = 0.0
    gripper: bool = False

    @property
    def lag(self) -> Array | float:
        """Lag of torques: dead time plus that of slow torques behind filters and averages (s)."""
        loop = 0.0 if self.current_loop is None else 1 / (2 * np.pi * self.current_loop)
        second = 0.0 if self.second_order is None else 2**0.5 / (2 * np.pi * self.second_order)
        return self.delay + loop + second + 0.5 * self.average

    def recorded(self, happening: Happening) -> pl.DataFrame:
        """The log: t, q, qd if recorded, tau, gripper if recorded."""
        machine, truth = happening.machine, happening.truth
        rng, time = np.random.default_rng([happening.seed, 2]), happening.time
        step = np.where(machine.rotary, _STEP, _LEAD / 2**17)
        counts = np.round(truth.q / step + _DITHER * rng.standard_normal(truth.q.shape))
        q = self.scale * (step * counts) + self.homing
        columns = {"t": time, "q": q}
        if self.velocity:
            columns["qd"] = _first_order(self.scale * truth.qd, self.velocity_lag * machine.rate)
        tau = self._late(happening)
        scale = np.abs(replace(happening, contacts=()).truth.tau).max(axis=0)
        tau = tau + scale * self.ripple * np.sin(self.waves * truth.q + self.phase)
        if self.believed is not None:
            tau = scale * self.believed(tau / scale)
        if self.current_loop is not None:
            tau = _first_order(tau, machine.rate / (2 * np.pi * self.current_loop))
        if self.second_order is not None:
            b, a = butter(2, self.second_order, fs=machine.rate)
            tau = lfilter(b, a, tau - tau[0], axis=0) + tau[0]
        if self.average:
            rows = round(self.average * machine.rate)
            taps = np.ones(rows + 1) / rows
            taps[[0, -1]] /= 2.0
            tau = lfilter(taps, 1.0, tau - tau[0], axis=0) + tau[0]
        tau = self.gain * tau + scale * self.offset
        if not self.held_noise:
            tau = self._held(tau, machine.rate)
        tau = tau + self.noise * scale * rng.standard_normal(tau.shape)
        if self.held_noise:
            tau = self._held(tau, machine.rate)
        if self.clip is not None:
            tau = np.clip(tau, -self.clip * scale, self.clip * scale)
        columns["tau"] = tau
        if self.gripper:
            columns["gripper"] = within(time, happening.held).astype(float)
        table = tabled(**columns)
        stale = rng.uniform(size=len(time)) < self.stale
        if not np.any(stale):
            return table
        row = np.maximum.accumulate(np.where(stale, 0, np.arange(len(time))))
        return table[row].with_columns(pl.Series("t", time))

    def _held(self, tau: Array, rate: float) -> Array:
        """Torques that hold their value between updates."""
        if not self.hold:
            return tau
        every = round(self.hold * rate)
        return tau[np.arange(len(tau)) // every * every]

    def _late(self, happening: Happening) -> Array:
        delay = np.broadcast_to(self.delay, happening.machine.dof)
        if self.clocks:
            time = happening.time * (1 + self.clocks)
            return happening.moved(time - float(np.mean(delay))).tau
        tau = happening.truth.tau.copy()
        for late in np.unique(delay[delay != 0]):
            tau[:, delay == late] = happening.moved(happening.time - late).tau[:, delay == late]
        return tau


def _first_order(x: Array, samples: float) -> Array:
    """Low-pass 1 / (1 + T s) with T in samples, by Tustin's rule, from a steady state."""
    if samples == 0:
        return x
    a = 1 / (1 + 2 * samples)
    pole = (2 * samples - 1) / (2 * samples + 1)
    return lfilter([a, a], [1, -pole], x - x[0], axis=0) + x[0]
