"""Torques behind a filter, held, or on another clock; values at other instants: closed forms."""

from collections.abc import Iterator

import numpy as np
import pytest

import deltaid
from deltaid.model.verdict import Grade
from deltaid.recording.delay import LagGrowth, Shift, delayed
from deltaid.recording.hold import Hold, filled, holds
from deltaid.recording.repairs import Repairs
from deltaid.recording.time.signals import Signal, interpolate, merged
from drives import case
from drives.identify import identified
from drives.judge import judge
from test_lag import columns

RATE, SAMPLES = 1000.0, 12_000
TIME = np.arange(SAMPLES) / RATE
COLUMNS = columns(2)


def wave(t: np.ndarray) -> np.ndarray:
    return np.sin(6 * np.pi * t) + 0.3 * np.sin(22 * np.pi * t + 1)


def slope(t: np.ndarray) -> np.ndarray:
    return 6 * np.pi * np.cos(6 * np.pi * t) + 6.6 * np.pi * np.cos(22 * np.pi * t + 1)


def rows(tau: np.ndarray) -> np.ndarray:
    """With the same torque for both drives."""
    return np.column_stack([TIME, TIME, TIME, tau, tau, np.ones((SAMPLES, 2))])


def blocks(values: np.ndarray, size: int) -> Iterator[np.ndarray]:
    return (values[start : start + size] for start in range(0, len(values), size))


def updated(every: float) -> np.ndarray:
    """The row whose torque each row has."""
    updates = np.unique(np.ceil(np.arange(0, SAMPLES, every)).astype(int))
    return np.repeat(updates, np.diff(np.append(updates, SAMPLES + 9)))[:SAMPLES]


@pytest.mark.parametrize(
    ("delay", "constants", "growth"),
    [
        ((0.0, 0.0), (5e-3, 2e-3), None),
        ((1.3e-3, 2e-3), (5e-3, 0.0), None),
        ((1e-3, -2e-3), (0.0, 0.0), LagGrowth(5e-4, 6.0, 6.0)),
        ((1e-3, -2e-3), (4e-3, 0.0), LagGrowth(-5e-4, 6.0, 6.0)),
    ],
)
def test_filters_and_clocks_are_undone_exactly(
    delay: tuple[float, ...], constants: tuple[float, ...], growth: LagGrowth | None
) -> None:
    shift = Shift.of_delays(delay, RATE, constants, growth)
    found, again = (
        np.vstack([*delayed(blocks(rows(wave(TIME)), size), COLUMNS, shift, RATE)])
        for size in (777, 5000)
    )
    np.testing.assert_array_equal(found, again)
    for i in range(2):
        at = found[:, 0] + delay[i]
        at += growth.rate * (found[:, 0] - growth.about) if growth else 0.0
        counts = found[:, 5 + i] > 0
        assert np.count_nonzero(~counts) < 40
        np.testing.assert_allclose(
            found[counts, 3 + i], (wave(at) + constants[i] * slope(at))[counts], atol=1e-6
        )


@pytest.mark.parametrize("every", [2.0, 3.0, 2.5, 1.5])
def test_held_torques_are_interpolated_between_updates(every: float) -> None:
    values = rows(wave(TIME[updated(every)]))
    hold = holds([blocks(values, 777)], COLUMNS, RATE)
    assert hold == (Hold(every), Hold(every))
    found, again = (
        np.vstack([*filled(blocks(values, size), COLUMNS, hold, RATE)]) for size in (777, 5000)
    )
    np.testing.assert_array_equal(found, again)
    counts = found[:, 5] > 0
    assert np.count_nonzero(~counts) < 20
    np.testing.assert_allclose(found[counts, 3], wave(TIME)[counts], atol=2e-5)


@pytest.mark.parametrize("every", [2, 4, 7])
def test_a_hold_is_found_beneath_noise_of_each_row(every: int) -> None:
    noise = 0.03 * np.random.default_rng(0).standard_normal(SAMPLES)
    values = rows(wave(TIME[updated(every)]) + noise)
    hold = holds([blocks(values, 777)], COLUMNS, RATE)
    assert hold == (Hold(float(every), 0), Hold(float(every), 0))
    found = np.vstack([*filled(blocks(values, 777), COLUMNS, hold, RATE)])
    error = (found[:, 3] - wave(TIME))[found[:, 5] > 0]
    assert np.std(error) < 0.03 / np.sqrt(0.9 * every)
    assert abs(np.mean(error)) < 1e-3


@pytest.mark.parametrize("every", [2, 4, 12])
@pytest.mark.parametrize(("noise", "digits"), [(0.0, 12), (0.03, 12), (0.03, 4)])
def test_straight_lines_between_updates_are_found(every: int, noise: float, digits: int) -> None:
    update = TIME[3::every]
    known = wave(update) + noise * np.random.default_rng(0).standard_normal(len(update))
    values = rows(np.round(np.interp(TIME, update, known), digits))
    hold = holds([blocks(values, 777)], COLUMNS, RATE)
    assert hold == (Hold(float(every), 3 % every, is_straight=True),) * 2
    found, again = (
        np.vstack([*filled(blocks(values, size), COLUMNS, hold, RATE)]) for size in (777, 5000)
    )
    np.testing.assert_array_equal(found, again)
    inner = (
        (found[:, 5] > 0)
        & (np.arange(SAMPLES) > 2 * every + 3)
        & (np.arange(SAMPLES) < SAMPLES - 4 * every)
    )
    at_updates = inner & ((np.arange(SAMPLES) - 3) % every == 0)
    np.testing.assert_allclose(found[at_updates, 3], values[at_updates, 3])
    if not noise:
        np.testing.assert_allclose(found[inner, 3], wave(TIME)[inner], atol=6e-3)
        straight = np.abs(values[inner, 3] - wave(TIME)[inner]).max()
        assert np.abs(found[inner, 3] - wave(TIME)[inner]).max() < 0.2 * straight


@pytest.mark.parametrize("unit", [0.0, 1e-3, 0.05, 0.3])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_coarse_unit_is_no_hold(unit: float, noise: float) -> None:
    tau = wave(TIME) + noise * np.random.default_rng(1).standard_normal(SAMPLES)
    tau = np.round(tau / unit) * unit if unit else tau
    assert not any(holds([blocks(rows(tau), 777)], COLUMNS, RATE))


def test_pulses_that_begin_in_every_fifth_row_are_no_hold() -> None:
    noise = 0.01 * np.random.default_rng(2).standard_normal(SAMPLES)
    pulses = np.maximum(1 - np.arange(SAMPLES) % 100 / 13, 0)
    assert not any(holds([blocks(rows(wave(TIME) + noise + pulses), 777)], COLUMNS, RATE))


def waves(time: np.ndarray, frequency: float = 10.0) -> np.ndarray:
    """Two channels of one frequency [Hz], and a polynomial of degree 7."""
    phase = 2 * np.pi * frequency * time
    return np.column_stack([np.sin(phase), np.cos(phase), (time - 0.5) ** 7])


@pytest.mark.parametrize("uneven", [0.0, 0.2])
def test_band_limited_values_at_other_instants(uneven: float) -> None:
    rng = np.random.default_rng(1)
    time = (np.arange(100) + uneven * rng.uniform(-1, 1, 100)) / 100  # ten samples a period
    at = rng.uniform(0.05, 0.94, 20_000)
    found = interpolate(time, waves(time), at)
    np.testing.assert_allclose(found, waves(at), atol=3e-4 if uneven else 6e-5)
    np.testing.assert_allclose(found[:, 2], waves(at)[:, 2], atol=1e-14)


def test_samples_are_kept_where_instants_meet_them() -> None:
    time = np.arange(20) / 7
    np.testing.assert_array_equal(interpolate(time, waves(time), time[::-1]), waves(time[::-1]))
    few = time[:3]  # a parabola through three samples
    np.testing.assert_allclose(interpolate(few, few[:, None] ** 2, time)[:, 0], time**2)


def test_signals_meet_on_the_grid_of_the_fastest() -> None:
    slow, fast = np.arange(0.1, 2, 1 / 250), np.arange(0, 1.9, 1 / 1000) + 3e-4
    slow = np.concatenate([slow[:200], slow[199:200], slow[200:]])  # a doubled sample
    parts = [[Signal(slow, waves(slow))], [Signal(x, waves(x)) for x in np.split(fast, [700])]]
    together, same = merged(["slow", "fast"], parts, "log")
    assert same == [False, True]
    low, high = np.hsplit(together.values, 2)
    inside = (fast >= slow[0]) & (fast <= slow[-1])
    np.testing.assert_array_equal(together.time, fast[inside])
    np.testing.assert_array_equal(high, waves(together.time))
    np.testing.assert_allclose(low, waves(together.time), atol=1e-4)


def test_a_hole_in_one_signal_is_one_of_all() -> None:
    fast = np.arange(1000) / 1000
    slow = fast[::4]
    slow = slow[(slow < 0.301) | (slow > 0.37)]
    signals = [[Signal(fast, waves(fast))], [Signal(slow, waves(slow))]]
    together, _ = merged(["fast", "slow"], signals, "log")
    np.testing.assert_array_equal(together.time, np.concatenate([fast[:301], fast[372:997]]))


def test_blurred_and_interpolated_torques_reach_as_far_as_both() -> None:
    assert Repairs().smear(RATE) == ()
    assert Repairs(blur=(4e-3, 0.0)).smear(RATE) == (4, 0)
    held = Repairs(blur=(4.2e-3, 0.0), hold=(Hold(2.0), Hold(0.0)))
    spread = Hold(2.0).spread
    assert held.smear(2 * RATE) == (9 + spread, Hold(0.0).spread)
    late = Repairs(blur=(4e-3, 0.0), delay=(1e-3, 1.5e-3))
    assert late.smear(RATE) == tuple(np.add((4, 0), late.shift(RATE).smear).tolist())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "kind", "seed"),
    [("average-8ms", "linear", 0), ("second-order", "linear", 0), ("average-8ms", "resized", 0)],
)
def test_blurred_steps_are_a_lag_and_no_friction(row: str, kind: str, seed: int) -> None:
    made = case(row, kind, seed)
    result = identified(made)
    judged = judge(made, result)
    assert dict(judged.said) == {"lag": 1}
    assert judged.lag < 1e-4
    assert judged.M < 0.003  # 0.1 to 2.8 % where these rows count
    assert judged.friction < 0.007  # 5 to 9 %
    assert np.mean(judged.curves) > 0.9
    (lag,) = result.model.corrections
    assert "steps of friction at reversals are blurred" in lag.text
    assert "first-order" not in lag.text
    assert row == "second-order" or not judged.verdicts


def test_check_takes_averages_for_no_friction() -> None:
    averaged = case("average-8ms", "linear", 0)
    verdicts = deltaid.check(averaged.robot, averaged.logs[0])
    bad = {verdict.key: verdict for verdict in verdicts if verdict.grade is not Grade.GOOD}
    assert set(bad) == {"torque-lag"}  # "presliding" where rows with blurred steps count
    assert bad["torque-lag"].number == pytest.approx(4.0, abs=0.1)
