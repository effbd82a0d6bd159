"""Both cut-offs: what is lost before Y is formed is a bias, what is lost behind it is not."""

from dataclasses import replace
from functools import cache

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.information import merge
from deltaid.identification.gathering import gather
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters
from deltaid.recording.filter import design_low_pass
from deltaid.recording.log import Log
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.recording.spectrum import apply, spectrum_of
from deltaid.robot.load import load_robot
from logs import names, tabled
from support import along, largest_mass_error

RATE = 500.0


@cache
def lively() -> tuple[Dynamics, np.ndarray, Log]:
    """A motion of up to 6 Hz without any noise, positions and torques."""
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(1)
    p = surrogate_parameters(dynamics.robot, rng)
    motion = random_motion(dynamics.kinematics, rng, period=1.0, harmonics=6)
    frame = simulate_recording(dynamics, p, motion, rng, duration=6.0, rate=RATE)
    positions = frame.select(names("t", "q", "tau"))
    return dynamics, p, open_log(positions, dynamics.kinematics, keep_all=True)


@pytest.mark.parametrize("cutoff", [6.0, 9.0, 16.0])
def test_rows_lose_without_bias_what_positions_keep(cutoff: float) -> None:
    dynamics, p, log = lively()
    apart = with_filter(replace(log, motion_cutoff=40.0), cutoff)
    assert (apart.cutoff, apart.motion_cutoff) == (cutoff, 40.0)
    alike = with_filter(replace(log, motion_cutoff=cutoff), cutoff)
    wrong, bent = (merge(gather(dynamics, recording)).rms(p).max() for recording in (apart, alike))
    assert wrong < 1e-4 * log.torque_max.max()
    assert bent > 5 * wrong


@pytest.mark.parametrize("rate", [500.0, 20000.0])
def test_positions_and_rows_are_filtered_by_their_own_cutoffs(rate: float) -> None:
    both = design_low_pass(8.0, rate, motion_cutoff=30.0)
    rows, motion = design_low_pass(8.0, rate), design_low_pass(30.0, rate)
    assert both.rate / both.thinned < 1.5 * rows.rate / rows.thinned
    time = np.arange(round(2 * rate)) / rate
    for frequency, passed in ((2.0, 1.0), (14.0, 1.0), (46.0, 0.0)):
        x = np.sin(2 * np.pi * frequency * time)[None]
        led = apply(both.lead, x, both.stride) if both.stride > 1 else x
        size = np.abs(apply(both.level, led)).max()
        assert size == pytest.approx(passed, abs=1e-3)
        assert np.abs(apply(both.second, led)).max() == pytest.approx(
            passed * (2 * np.pi * frequency) ** 2, rel=3e-3, abs=3e-3 * (2 * np.pi * frequency) ** 2
        )
        behind = np.abs(apply(both.smooth, led)).max()
        assert behind == pytest.approx(1.0 if frequency < 4 else 0.0, abs=1e-3)
    assert both.margin == motion.margin or both.stride != motion.stride
    assert len(both.level) == len(both.first) == len(both.second)


@pytest.mark.parametrize("rate", [250.0, 1000.0, 8000.0])
def test_bandwidth_is_that_of_the_speeds(rate: float) -> None:
    time, rng = np.arange(round(40 * rate)) / rate, np.random.default_rng(1)
    resolution = 4 * rate / 4096
    # Of 2 % of the size, the faster wave has 1 % of the speeds' power; of 0.2 %, next to nothing.
    for share, expected in ((0.02, 10.0), (0.002, 2.0)):
        q = np.sin(4 * np.pi * time) + share * np.sin(20 * np.pi * time)
        q = np.column_stack([q, 0.1 * np.roll(q, 50), 1e-5 * np.sin(200 * time)])
        q += 1e-6 * rng.standard_normal(q.shape)
        assert spectrum_of(q).bandwidth(rate) == pytest.approx(expected, abs=resolution + 0.1)
    assert spectrum_of(q[:255]).bandwidth(rate) is None


def test_cutoff_of_rows_follows_motion_noise_and_length() -> None:
    _, _, log = lively()

    def chosen(**changes: float) -> float | None:
        return replace(log, **changes).suggested_cutoff

    assert chosen(bandwidth=20.0, motion_cutoff=100.0) == 40.0
    assert chosen(bandwidth=20.0, motion_cutoff=30.0) == 30.0
    assert chosen(bandwidth=1.0, motion_cutoff=100.0) == pytest.approx(100 * RATE / log.samples)
    longer = replace(log.clock, rows=100 * log.samples)
    assert replace(log, bandwidth=1.0, clock=longer).suggested_cutoff == 12.0
    holes = np.array([log.samples // 2])
    gap = {"holes": holes, "lost": np.array([1000]), "since": np.zeros(1), "until": np.ones(1)}
    halves = replace(log.clock, steady=False, **gap)
    cut = replace(log, bandwidth=1.0, motion_cutoff=100.0, clock=halves)
    assert cut.suggested_cutoff == pytest.approx(200 * RATE / log.samples, rel=0.01)


@cache
def with_play() -> tuple[Dynamics, np.ndarray, pl.DataFrame]:
    """Motors that turn by 0.05° more where the torque behind their gears changes its sign."""
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(4)
    p = surrogate_parameters(dynamics.robot, rng)
    time = np.arange(8000) / 1000.0
    z, q, qd, qdd = along(dynamics.kinematics, rng, time, period=4.0, harmonics=8)
    link = dynamics.inverse_dynamics(q, 0 * qd, qdd, p)
    noise = [0.005 * rng.standard_normal(q.shape), 1e-6 * rng.standard_normal(q.shape)]
    tau = dynamics.torque(z, qd, qdd, p)
    size = np.abs(tau).max(axis=0)
    q = q + 0.5 * np.deg2rad(0.05) * np.tanh(link / (0.02 * size)) + noise[1]
    return dynamics, p, tabled(t=time, q=q, tau=tau + size * noise[0])


@cache
def fitted(cutoff: float | None) -> deltaid.Identification:
    dynamics, _, table = with_play()
    plain = deltaid.Settings(cutoff=cutoff, events=False, lag="none", friction="described")
    return deltaid.identify(dynamics.robot, table, settings=plain)


def test_play_in_gears_bends_no_parameters() -> None:
    dynamics, p, _ = with_play()
    z = dynamics.kinematics.home + 0.1 * np.random.default_rng(1).uniform(-1, 1, (20, 3))
    q = dynamics.kinematics.inverse(z)
    true = dynamics.mass_matrix(q, p)
    chosen, open_wide = (
        largest_mass_error(dynamics.mass_matrix(q, fitted(cutoff).model.p), true)
        for cutoff in (None, 80.0)
    )
    assert chosen < 0.004
    assert open_wide > 4 * chosen


def test_a_model_tells_both_cutoffs() -> None:
    found = fitted(None)
    (recording,), (source,) = found.recordings, found.model.sources
    assert source.cutoff_hz == recording.cutoff
    assert source.motion_cutoff_hz == recording.motion_cutoff
    assert recording.motion_cutoff > 4 * recording.cutoff
