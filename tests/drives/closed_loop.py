"""Recordings of a robot under control, with noise that the controller feeds back.

Encoder noise is in the recorded angles and, through the controller, in the torques that move the
robot. The package's simulation moves it. Drives may apply another torque than they log, to which
the controller reacts.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl
from scipy.signal import lfilter

from deltaid.control.controllers import (
    Controller,
    ControlModel,
    Desired,
)
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import SampledTrajectory
from deltaid.dynamics.dynamics import compiled
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from drives.happening import Happening
from logs import tabled
from oracle.tree import Array

# Noise of the encoders' readings (rad or m); noise of torque columns, as a share of the largest;
# cut-off of the low-pass on differences of angles, as a share of the rate.
_NOISE, _TORQUE_NOISE, _CUTOFF = 1e-5, 0.005, 0.1
# Cut-off of the torque that drives apply but do not log [Hz].
_SLOW = 20.0


@dataclass(eq=False)
class Noisy:
    """A controller with noisy encoders, whose drives apply additional torque; both are given sample
    by sample."""

    law: Controller
    noise: Array
    more: Array
    rate: float
    sample: int = 0
    last: Array = field(default_factory=lambda: np.zeros(0))
    slope: Array = field(default_factory=lambda: np.zeros(0))

    def torque(self, model: ControlModel, q: Samples, qd: Samples, desired: Desired) -> Samples:
        """Torque of the law for noisy angles and their low-passed difference, plus the addition."""
        now = self.noise[self.sample]
        last = self.last if self.sample else now
        slope = (now - last) * self.rate
        share = 1 - np.exp(-2 * np.pi * _CUTOFF)
        self.slope = self.slope + share * (slope - self.slope) if self.sample else slope
        self.last, self.sample = now, self.sample + 1
        seen = q + now, qd + self.slope
        return self.law.torque(model, *seen, desired) + self.more[self.sample - 1]


def followed(
    happening: Happening, rng: np.random.Generator, unlogged: float = 0.0
) -> tuple[Happening, pl.DataFrame]:
    """A recording under computed torque of 10 to 30 Hz.

    Args:
        unlogged: standard deviation of the torque that drives apply but do not log, as a share of
            the largest; noise below 20 Hz.
    """
    m, truth = happening.machine, happening.truth
    happening = replace(happening, duration=min(happening.duration, 12.0))
    dynamics = compiled(m.robot)
    wanted = happening.truth_at(happening.time)
    plant = Model(m.robot, m.plant.p)
    law = Controller("computed-torque", bandwidth=2 * np.pi * float(rng.uniform(10, 30)))
    noise = _NOISE * rng.standard_normal((len(wanted.q) + 2, m.dof))
    drives = Drives(rate=m.rate, velocity_cutoff=_CUTOFF)
    trajectory = SampledTrajectory(dynamics.kinematics, wanted.time, wanted.q)
    scale = np.abs(truth.tau).max(axis=0)
    more = np.zeros_like(noise)
    if unlogged:
        share = np.exp(-2 * np.pi * _SLOW / m.rate)
        more = lfilter([1.0], [1.0, -share], rng.standard_normal(noise.shape), axis=0)
        more *= unlogged * scale / more.std(axis=0)
    run = track(
        plant, Noisy(law, noise, more, m.rate), ControlModel(m.robot, m.plant.p), trajectory, drives
    )
    count = len(run.time)
    tau = run.tau - more[:count] + _TORQUE_NOISE * scale * rng.standard_normal(run.tau.shape)
    return happening, tabled(t=run.time, q=run.q + noise[:count], tau=tau)
