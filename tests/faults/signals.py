"""Faults of signals: rates, clocks, encoders, noise, lag, motions with too little information."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from deltaid.errors import KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from faults.case import Case
from faults.tools import ImpossibleError, drives, kind, random_drive, recorded, some
from plants import log_uniform


@kind("rate", related=("clock", "torque-noise"))
def rate(case: Case, rng: np.random.Generator) -> Case:
    """Only two to five samples per wave of the motion's highest harmonic."""
    setting = case.setting
    highest = setting.harmonics / setting.period
    low = highest * rng.uniform(2.2, 5.0)
    return replace(
        recorded(case, rate=low, duration=max(setting.duration, 150 / low)),
        size=f"{low:.3g} Hz for {highest:.3g} Hz",
    )


@kind("encoder-step")
def encoder_step(case: Case, rng: np.random.Generator) -> Case:
    """A stroke has only 15 to 150 encoder steps."""
    counts = log_uniform(rng, 15, 150)
    step = np.ptp(case.setting.truth.q, axis=0) / counts
    return replace(recorded(case, step=step, velocity=False), size=f"{counts:.0f} steps")


@kind("clock")
def clock_jitter(case: Case, rng: np.random.Generator) -> Case:
    """Rows or their stamps deviate by 5 to 40 % of a step from an even clock."""
    setting, share = case.setting, log_uniform(rng, 0.05, 0.4)
    late = share / setting.rate * rng.uniform(-1, 1, len(setting.time))
    words = "stamps"
    if rng.uniform() < 0.5:  # the stamps are right
        case, words = recorded(case, jitter=late), "rows"
    columns = dict(case.columns) | {"t": setting.time + late}
    return replace(case, columns=columns, size=f"{share:.0%}, {words}")


@kind("clock")
def clock_lost(case: Case, rng: np.random.Generator) -> Case:
    """Single rows or short runs are lost, 0.05 to 2 % in all."""
    share, rows = log_uniform(rng, 5e-4, 0.02), len(case.columns["t"])
    run = int(rng.integers(1, 6))
    starts = rng.integers(1, rows - run - 1, max(2, round(share * rows / run)))
    lost = np.unique(starts[:, None] + np.arange(run))
    columns = {name: np.delete(x, lost, axis=0) for name, x in case.columns.items()}
    return replace(case, columns=columns, size=f"{len(lost)} of {rows} rows")


@kind("clock")
def clock_gaps(case: Case, rng: np.random.Generator) -> Case:
    """One to four gaps of 0.05 to 0.8 s."""
    t, count = case.columns["t"], int(rng.integers(1, 5))
    keep = np.ones(len(t), bool)
    for _ in range(count):
        start, length = rng.uniform(0.1, 0.85) * t[-1], log_uniform(rng, 0.05, 0.8)
        keep &= (t < start) | (t > start + length)
    columns = {name: x[keep] for name, x in case.columns.items()}
    return replace(case, columns=columns, size=f"{count} gaps, {np.sum(~keep)} rows")


@kind("clock")
def clock_doubled(case: Case, rng: np.random.Generator) -> Case:
    """Rows are repeated with the same stamp, or with the next one."""
    rows = len(case.columns["t"])
    share = log_uniform(rng, 5e-4, 0.02)
    again = np.sort(rng.choice(rows - 2, max(2, round(share * rows)), replace=False)) + 1
    columns = {name: np.insert(x, again, x[again], axis=0) for name, x in case.columns.items()}
    return replace(case, columns=columns, size=f"{len(again)} of {rows} rows")


@kind("saturation", related=("torque-step",))
def saturation(case: Case, rng: np.random.Generator) -> Case:
    """Torques of one or all drives saturate at 40 to 85 % of their largest."""
    which, subject = some(case, rng)
    share = rng.uniform(0.4, 0.85)
    limit = np.where(which, share, 2.0) * np.abs(case.columns["tau"]).max(axis=0)
    tau = np.clip(case.columns["tau"], -limit, limit)
    cut = np.mean(np.abs(case.columns["tau"]) > limit, axis=0)
    if not 0.01 < cut.max() < 0.4:
        raise ImpossibleError("hardly a sample is cut, or so many that it could not hold itself")
    return replace(case, columns=dict(case.columns) | {"tau": tau}, subject=subject,
                   size=f"at {share:.0%}, {cut.max():.1%} of the rows")  # fmt: skip


@kind("torque-noise")
def torque_noise(case: Case, rng: np.random.Generator) -> Case:
    """Noise of 10 to 40 % of the largest torque."""
    noise = log_uniform(rng, 0.10, 0.40)
    return replace(recorded(case, noise=noise), size=f"{noise:.0%}")


@kind("torque-step")
def torque_step(case: Case, rng: np.random.Generator) -> Case:
    """Torques in steps of 6 to 30 % of the largest, larger than the drive's noise."""
    share = log_uniform(rng, 0.06, 0.3)
    case = recorded(case, noise=min(case.setting.noise, share / 8))
    step = share * case.setting.scale
    columns = dict(case.columns) | {"tau": step * np.round(case.columns["tau"] / step)}
    return replace(case, columns=columns, size=f"{share:.0%}")


@kind("resonance", related=("torque-noise",))
def resonance(case: Case, rng: np.random.Generator) -> Case:
    """A resonance at 12 to 60 Hz with 3 to 15 % of the largest torque."""
    setting, sharpness = case.setting, log_uniform(rng, 15, 80)
    frequency, share = (
        log_uniform(rng, 12, min(60, 0.3 * setting.rate)),
        log_uniform(rng, 0.03, 0.15),
    )
    turn = 2 * np.pi * frequency / setting.rate
    pole = np.exp(-turn / (2 * sharpness))
    shape = [1, -2 * pole * np.cos(turn), pole**2]
    ringing = lfilter([1.0], shape, rng.standard_normal(case.columns["tau"].shape), axis=0)
    ringing *= share * setting.scale / ringing.std(axis=0)
    columns = dict(case.columns) | {"tau": case.columns["tau"] + ringing}
    return replace(case, columns=columns, size=f"{share:.0%} at {frequency:.0f} Hz")


@kind("torque-lag", hides=True)
def torque_lag(case: Case, rng: np.random.Generator) -> Case:
    """All torques lag or lead the positions by 0.3 to 8 ms."""
    setting, late = case.setting, log_uniform(rng, 0.3e-3, 8e-3)
    late = late if rng.uniform() < 0.7 else -late
    behind = setting.truth_at(setting.time - late).tau - setting.truth.tau
    columns = dict(case.columns) | {"tau": case.columns["tau"] + behind}
    return replace(case, columns=columns, size=f"{1e3 * late:.3g} ms")


@kind("standing")
def standing(case: Case, rng: np.random.Generator) -> Case:
    """The robot stands for 30 to 50 % of the time, in one to three spans."""
    setting, share, spans = case.setting, rng.uniform(0.3, 0.5), int(rng.integers(1, 4))
    duration = max(setting.duration, 15.0)
    length, free = share * duration / spans, (1 - share) * duration / spans
    first = rng.uniform(0, free)
    rest = [(first + k * (length + free), first + k * (length + free) + length)
            for k in range(spans)]  # fmt: skip
    spoilt = recorded(case, rest=tuple(rest), duration=duration)
    return replace(spoilt, size=f"{share:.0%} in {spans} spans")


@kind("excitation", "base-parameters", related=("excitation", "base-parameters"))
def slow(case: Case, rng: np.random.Generator) -> Case:
    """The motion is 10 to 25 times too slow to identify inertia."""
    factor = log_uniform(rng, 10, 25)
    period = factor * case.setting.period
    spoilt = recorded(case, period=period, duration=min(1.2 * period, 60.0))
    return replace(spoilt, size=f"{factor:.3g} times")


@kind("excitation", "base-parameters", related=("excitation", "base-parameters", "standing"))
def resting_drive(case: Case, rng: np.random.Generator) -> Case:
    """One drive never moves."""
    plant, drive = case.setting.plant, random_drive(case, rng)
    kinematics = Kinematics(case.robot)
    q = plant.oracle.positions(plant.path)
    middle = np.mean(q, axis=0)
    q = middle + 0.7 * (q - middle)
    q[:, drive] = middle[drive]
    try:
        path = kinematics.forward(q)
    except KinematicsError:
        raise ImpossibleError("no such path") from None
    regular = kinematics.regularity(path).condition
    if not np.all(np.isfinite(plant.oracle.positions(path))) or not np.all(regular < 20):
        raise ImpossibleError("no such path")
    name = drives(case)[drive]
    return replace(recorded(case, plant=replace(plant, path=path)), size=name, subject="")
