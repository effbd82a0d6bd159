"""Checks on signals: each fault by its number, and drives that noise shakes."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import signal
from scipy.signal import butter, sosfiltfilt

from deltaid.checks.closed_loop import checked_feedback, encoder_feedback
from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.identify import identify
from deltaid.checks.signal import checked_signals
from deltaid.control.controllers import ControlModel, tuned
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.dynamics import compiled
from deltaid.estimation.spectra import bandwidth, density, step_of, white_noise
from deltaid.model.model import Model
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.memory import Recording
from deltaid.robot.load import load_robot
from test_lag import frame as lagging


@cache
def frame(rate: float = 500.0) -> pl.DataFrame:
    return lagging(np.zeros(3), noise=0.01, rate=rate)


def column(name: str) -> np.ndarray:
    """Of the clean recording."""
    return frame()[name].to_numpy()


def said(table: pl.DataFrame | Path) -> dict[str, list[Verdict]]:
    """Verdicts that are not good, by key."""
    found: dict[str, list[Verdict]] = {}
    for verdict in checked_signals(evidence(load_robot("clavel-delta3"), table)):
        if verdict.grade is not Grade.GOOD:
            assert verdict.cause
            assert verdict.cure
            found.setdefault(verdict.key, []).append(verdict)
    return found


def test_a_clean_recording_has_good_signals() -> None:
    verdicts = list(checked_signals(evidence(load_robot("clavel-delta3"), frame())))
    assert {v.grade for v in verdicts} == {Grade.GOOD}
    assert {v.key for v in verdicts} == {
        "rate", "encoder-step", "clock", "saturation", "frozen-torque", "standing", "torque-noise",
        "torque-step",
    }  # fmt: skip
    noise = next(v for v in verdicts if v.key == "torque-noise")
    assert noise.number == pytest.approx(1.0, rel=0.2)


def test_stamps_that_most_rows_share_hide_no_verdict() -> None:
    fast = frame(4000.0).with_columns(pl.col("t").mul(1e3).floor().mul(1e-3))
    looked_at = evidence(load_robot("clavel-delta3"), fast)
    assert looked_at.rows.step == pytest.approx(1 / 4000, rel=0.05)
    assert "torque-noise" in {v.key for v in checked_signals(looked_at)}


@pytest.mark.parametrize(("rate", "grade"), [(50.0, Grade.DOUBTFUL), (10.0, Grade.WRONG)])
def test_too_few_samples_for_a_wave(rate: float, grade: Grade) -> None:
    (verdict,) = said(frame()[:: round(500 / rate)])["rate"]
    assert verdict.grade is grade
    assert verdict.unit == "samples"


def test_coarse_encoders_are_named_by_drive() -> None:
    step = 0.02
    coarse = frame().with_columns((pl.col("q2") / step).round() * step)
    (verdict,) = said(coarse)["encoder-step"]
    assert verdict.subject == "drive2"
    assert "steps of 0.02 rad" in verdict.seen
    assert verdict.number > 10


@pytest.mark.parametrize("lost", [slice(1000, 1003), slice(2000, 2400)])
def test_lost_rows_are_counted(lost: slice) -> None:
    keep = np.ones(len(frame()), dtype=bool)
    keep[lost] = False
    (verdict,) = said(frame().filter(pl.Series(keep)))["clock"]
    assert f"{lost.stop - lost.start} rows are missing in 1 place" in verdict.seen


def test_rows_that_are_there_twice_are_counted() -> None:
    again = pl.concat([frame()[:1000], frame()[998:]])
    (verdict,) = said(again)["clock"]
    assert "there twice" in verdict.seen
    assert verdict.number == pytest.approx(200 / len(again))


@pytest.mark.parametrize("leap", [3600.0, 1.7e9])
def test_a_clock_that_leaps_ahead_is_no_logger_that_falls_behind(leap: float) -> None:
    late = pl.when(pl.int_range(pl.len()) < 1500).then(0.0).otherwise(leap)
    (verdict,) = said(frame().with_columns(pl.col("t") + late))["clock"]
    assert verdict.seen == f"time leaps ahead by up to {leap:.4g} s in 1 place"
    assert "the clock was set" in verdict.cause


def test_a_clock_that_passes_midnight_is_no_logger_that_falls_behind() -> None:
    clock = (pl.col("t") + 86397.0) % 86400.0
    (verdict,) = said(frame().with_columns(clock.alias("t")))["clock"]
    assert re.fullmatch(r"time starts again in 1 place, the first in row \d+", verdict.seen)
    assert "passed midnight" in verdict.cause


@pytest.mark.parametrize("robots", [("left", "right"), (17, 23)])
def test_robots_below_one_another_are_to_be_split_by_the_column_that_names_them(
    robots: tuple[str, str] | tuple[int, int], tmp_path: Path
) -> None:
    half = len(frame()) // 2
    parts = [frame().slice(start, half) for start in (0, half)]
    stacked = pl.concat(
        part.with_columns(t=frame()["t"][:half], index=pl.Series(range(half)), robot=pl.lit(robot))
        for part, robot in zip(parts, robots, strict=True)
    )
    stacked.write_csv(log := tmp_path / "stacked.csv")
    (verdict,) = said(log)["clock"]
    first, second = robots
    assert verdict.seen == (
        f"time starts again in 1 place, the first in row {half + 2}, and column robot changes "
        f"there only, first from {first} to {second}"
    )
    assert "split it by column robot" in verdict.cure


def test_jitter_is_a_share_of_the_period() -> None:
    rng = np.random.default_rng(0)
    late = 0.2 / 500 * rng.uniform(-1, 1, len(frame()))
    (verdict,) = said(frame().with_columns(pl.col("t") + pl.Series(late)))["clock"]
    assert verdict.number == pytest.approx(20 / np.sqrt(3), rel=0.3)


def test_a_clipped_drive_is_named() -> None:
    limit = 0.6 * np.abs(column("tau3")).max()
    (verdict,) = said(frame().with_columns(pl.col("tau3").clip(-limit, limit)))["saturation"]
    assert verdict.subject == "drive3"
    share = 100 * np.mean(np.abs(column("tau3")) > limit)
    assert verdict.number == pytest.approx(share, rel=0.3)


def test_a_drive_whose_torque_freezes_is_named() -> None:
    first, last = len(frame()) // 2, len(frame()) // 2 + len(frame()) // 10
    frozen = column("tau2").copy()
    frozen[first:last] = frozen[first]
    (verdict,) = said(frame().with_columns(tau2=frozen))["frozen-torque"]
    assert verdict.subject == "drive2"
    assert verdict.number == pytest.approx(10.0, abs=0.1)


def test_standing_still_is_a_share_of_the_time() -> None:
    time, rng = (np.arange(4000) - 4000) / 500, np.random.default_rng(0)
    noise = {f"tau{i}": pl.Series(0.1 * rng.standard_normal(4000)) for i in (1, 2, 3)}
    still = pl.concat([frame()[:1]] * 4000).with_columns(t=pl.Series(time))
    still = still.with_columns(pl.col(name) + more for name, more in noise.items())
    (verdict,) = said(pl.concat([still, frame()]))["standing"]
    assert verdict.number == pytest.approx(40.0, abs=3.0)


def test_noise_of_a_torque_is_a_share_of_its_largest() -> None:
    rng, largest = np.random.default_rng(0), np.abs(column("tau1")).max()
    more = 0.15 * largest * rng.standard_normal(len(frame()))
    (verdict,) = said(frame().with_columns(pl.col("tau1") + pl.Series(more)))["torque-noise"]
    assert (verdict.subject, verdict.grade) == ("drive1", Grade.DOUBTFUL)
    assert 10 < verdict.number < 16


def test_a_channel_of_noise_only_is_wrong() -> None:
    rng = np.random.default_rng(0)
    table = frame().with_columns(tau2=pl.Series(rng.standard_normal(len(frame()))))
    (verdict,) = said(table)["torque-noise"]
    assert (verdict.subject, verdict.grade) == ("drive2", Grade.WRONG)
    assert "noise only" in verdict.seen


def test_torques_of_a_robot_that_stands_still_are_no_noise_of_channels() -> None:
    rng, still = np.random.default_rng(0), {"t": np.arange(8000) / 500.0}
    for drive in (1, 2, 3):
        for name, size in ((f"q{drive}", 1e-5), (f"tau{drive}", 0.1)):
            still[name] = column(name)[0] + rng.normal(scale=size, size=8000)
    table = pl.DataFrame(still)
    verdicts = [*checked_signals(evidence(load_robot("clavel-delta3"), table))]
    assert {v.key for v in verdicts if v.grade in (Grade.DOUBTFUL, Grade.WRONG)} == {"standing"}


def test_a_torque_in_coarse_steps_is_reported_by_its_step() -> None:
    step = 0.3 * np.std(column("tau2"))
    said_of = said(frame().with_columns((pl.col("tau2") / step).round() * step))
    (verdict,) = said_of["torque-step"]
    assert verdict.subject == "drive2"
    assert verdict.number == pytest.approx(30, rel=0.1)
    assert "torque-noise" not in said_of


def test_a_step_is_found_whatever_the_offset_and_none_where_there_is_none() -> None:
    x = np.random.default_rng(0).standard_normal(5000)
    assert step_of(0.3 + 0.01 * np.round(x / 0.01)) == pytest.approx(0.01, rel=1e-6)
    assert step_of(x) == 0.0
    assert step_of(np.ones(10)) == 0.0


def test_white_noise_has_its_level_beside_a_motion_and_steps_of_friction() -> None:
    rng, t = np.random.default_rng(0), np.arange(20000) / 1000
    x = np.stack([5 * np.sin(2 * np.pi * 3 * t), np.sign(np.sin(2 * np.pi * 0.7 * t))], axis=1)
    noise = white_noise(x + 0.1 * rng.standard_normal(x.shape))
    np.testing.assert_allclose(noise, 0.1, rtol=0.1)


def test_density_adds_up_to_the_variance() -> None:
    x = np.random.default_rng(0).standard_normal((40000, 1))
    frequency, power = density(2 * x, 100.0, 512)
    assert np.sum(power) * frequency[1] == pytest.approx(4.0, rel=0.03)


def test_bandwidth_is_the_fastest_part_of_a_motion() -> None:
    t = np.arange(10000) / 1000
    q = np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sin(2 * np.pi * 4 * t)
    noisy = q + 1e-5 * np.random.default_rng(0).standard_normal(len(t))
    assert bandwidth(noisy[:, None], 1000.0) == pytest.approx(4.0, rel=0.1)
    assert bandwidth(np.zeros((1000, 2)), 1000.0) == 0.0


def test_bandwidth_is_that_of_a_spectrum_by_a_window_of_blackman_and_harris() -> None:
    """Two waves, the faster one from hardly any of the speed's power to more than a hundredth."""
    n, rate = 1000, 100.0
    turn = 2 * np.pi * np.arange(n) / n
    window, frequency = signal.windows.blackmanharris(n, sym=False), np.fft.rfftfreq(n, 1 / rate)
    for share in np.geomspace(0.01, 0.2, 300):
        q = np.cos(turn) + share * np.cos(9 * turn)
        power = np.abs(np.fft.rfft((q - q.mean()) * window)) ** 2
        power[power < 1e-4 * power.max()] = 0.0
        total = np.cumsum(power * frequency**2)
        expected = frequency[np.searchsorted(total, 0.99 * total[-1])]
        assert bandwidth(q[:, None], rate) == pytest.approx(expected), share


RATE, SECONDS = 1000.0, 5.0


@cache
def controlled(bits: int, bandwidth: float) -> tuple[Evidence, np.ndarray]:
    """What a drive logs of a robot that follows a motion, and the robot's true q."""
    robot, rng = load_robot("clavel-delta3"), np.random.default_rng(2)
    dynamics, p = compiled(robot), surrogate_parameters(robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    trajectory = MotionTrajectory(dynamics.kinematics, motion, SECONDS)
    step = 2 * np.pi / 2.0**bits
    q = trajectory.desired(np.linspace(0, SECONDS, 40)).q
    mass = np.einsum("sii->i", dynamics.mass_matrix(q, p)) / len(q)
    law, known = tuned("pd-feedforward", mass, bandwidth), ControlModel(robot, 0.9 * p)
    run = track(Model(robot, p, "true"), law, known, trajectory, Drives(RATE, step))
    noise = 0.01 * np.abs(run.tau).max(axis=0) * rng.standard_normal(run.tau.shape)
    log = Recording.from_arrays(q=step * np.round(run.q / step), tau=run.tau + noise, rate=RATE)
    return evidence(robot, log, settings=Settings(lag="none", friction="described")), run.q


def test_drives_that_noise_shakes_are_reported() -> None:
    (verdict,) = checked_feedback(controlled(13, 30.0)[0])
    assert verdict.key == "closed-loop"
    assert verdict.grade in (Grade.DOUBTFUL, Grade.WRONG)
    assert verdict.number > 1.0
    assert "encoder" in verdict.seen


def test_the_shake_is_as_large_as_it_is_reported() -> None:
    seen, q = controlled(13, 30.0)
    shake = encoder_feedback(seen.rows, seen.surveyed, seen.fitted, seen.study)
    assert shake is not None
    high = butter(4, 2 * seen.surveyed.cutoff, "high", fs=RATE, output="sos")
    speed = sosfiltfilt(high, np.gradient(q, 1 / RATE, axis=0), axis=0)
    assert shake.speed == pytest.approx(np.sqrt(np.mean(speed**2, axis=0)), rel=0.3)


def test_encoders_of_today_do_no_harm() -> None:
    verdicts = checked_feedback(controlled(20, 20.0)[0])
    assert {verdict.grade for verdict in verdicts} <= {Grade.GOOD}


def test_noise_that_does_not_come_back_is_no_feedback() -> None:
    """The same positions with torques of a quiet loop: what is recorded apart goes not together."""
    quiet, _ = controlled(20, 20.0)
    rng, q = np.random.default_rng(0), quiet.rows.q
    noisy = q + 2 * np.pi / 2.0**13 * rng.uniform(-0.5, 0.5, q.shape)
    log = Recording.from_arrays(q=noisy, tau=quiet.rows.tau, rate=RATE)
    noisy_evidence = evidence(quiet.robot, log, settings=Settings(lag="none", friction="described"))
    assert all(verdict.grade is Grade.GOOD for verdict in checked_feedback(noisy_evidence))


def test_a_lag_that_noise_hides_is_left_alone_and_said() -> None:
    """Noise that comes back hides the steps of friction, which tell a lag to 20 µs elsewhere: here
    it is known to 0.5 ms, more than three times what counts as hardly known, and may be none.
    `test_lag_unknown.py` has what this does to intervals."""
    seen, _ = controlled(14, 20.0)
    log = Recording.from_arrays(q=seen.rows.q, tau=seen.rows.tau, rate=RATE)
    found = identify(seen.robot, log, settings=Settings(friction="described"))
    assert found.recordings[0].repairs.delay == ()
    (lag,) = [verdict for verdict in found.verdicts if verdict.key == "torque-lag"]
    assert lag.grade is Grade.CANNOT_TELL
    assert "hardly known" in lag.seen
