"""Faults of real recordings: what is found is right, or a word of its own says why it is not."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from deltaid.errors import RecordingError
from deltaid.online.doubts import doubts, gripper_doubts
from deltaid.online.events import LoadEntry, WeighedLoad
from deltaid.online.instant import EMPTY, HOLDS
from deltaid.online.replay import Replay, open_replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.suspicion import GripTiming, Offset, RunEvidence
from deltaid.online.watch import Watched, watch
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from picking import HELD, MASS, PUSHES, assert_as_it_was, picked

TORQUES = ("tau1", "tau2", "tau3")


def opened(table: pl.DataFrame) -> Replay:
    return open_replay(picked().model, table, gripper="gripper")


def watched(table: pl.DataFrame) -> Watched:
    return watch(picked().model, opened(table), OnlineSettings(largest_mass=2.0))


def changed(columns: Mapping[str, np.ndarray | pl.Expr]) -> pl.DataFrame:
    return picked().table.with_columns(**columns)


def rates() -> dict[str, np.ndarray]:
    return {f"qd{i}": np.gradient(picked().table[f"q{i}"].to_numpy(), 1e-3) for i in (1, 2, 3)}


def test_columns_of_other_drives_and_signs_are_refused() -> None:
    with pytest.raises(RecordingError, match="another order"):
        opened(picked().table.rename({"tau1": "tau2", "tau2": "tau1"}))
    with pytest.raises(RecordingError, match="drive1 counts the other way"):
        opened(changed({"tau1": -pl.col("tau1")}))


def test_too_few_rows_and_rows_that_only_repeat_are_refused() -> None:
    with pytest.raises(RecordingError, match="has 10 rows"):
        opened(picked().table[:10])
    slow = picked().table[[k - k % 4 for k in range(10_000)]].with_columns(t=picked().table["t"])
    with pytest.raises(RecordingError, match="75 % of its rows repeat"):
        opened(slow)


def test_torques_of_another_scale() -> None:
    found = watched(changed({name: 0.7 * pl.col(name) for name in TORQUES}))
    (doubt,) = found.doubts
    assert "torques of all drives are 0.7" in doubt
    assert "torque constant" in doubt
    assert max(load.mass.value for load in found.loads) < 0.8 * MASS  # so it has to be said


def test_a_channel_ends_at_the_number_that_it_stays_on() -> None:
    tau = picked().table["tau1"].to_numpy().copy()
    tau[2000:2020] = end = 1.2 * np.abs(tau).max()
    assert opened(changed({"tau1": tau})).ends == (pytest.approx(end), np.inf, np.inf)


@pytest.mark.slow
def test_a_torque_of_one_drive_at_the_end_of_its_channel() -> None:
    tau = picked().table["tau1"].to_numpy()
    end = 0.6 * np.abs(tau).max()
    found = watched(changed({"tau1": np.clip(tau, -end, end)}))
    assert_as_it_was(found)
    (doubt,) = found.doubts
    assert "smallest number of tau1" in doubt


def test_a_torque_that_stays() -> None:
    tau = picked().table["tau1"].to_numpy().copy()
    tau[5000:] = tau[5000]
    found = watched(changed({"tau1": tau}))
    assert "column tau1 stays the same for 5 s from 5 s on" in found.doubts[0]


def test_brakes_are_no_contact() -> None:
    table, rng = picked().table[:6000], np.random.default_rng(2)
    on = np.arange(6000) >= 5200
    stopped = {q: np.where(on, table[q][5200], table[q].to_numpy()) for q in ("q1", "q2", "q3")}
    off = {
        name: np.where(on, 0.02 * rng.standard_normal(6000), table[name].to_numpy())
        for name in TORQUES
    }
    found = watched(table.with_columns(**stopped, **off))
    assert "brakes hold the robot in 13 % of the rows" in found.doubts[0]
    assert found.bad == 800
    assert [round(touch.start, 1) for touch in found.touches] == [PUSHES[0][0]]


def test_velocities_that_are_late_or_noisy_are_excluded() -> None:
    true, rng = rates(), np.random.default_rng(0)
    fine = opened(changed(true))
    assert fine.has_velocity
    assert not fine.doubts
    slow = {f"qdd{i}": np.roll(np.gradient(true[f"qd{i}"], 1e-3), 3) for i in (1, 2, 3)}
    assert opened(changed(true | slow)).has_velocity  # accelerations are not used
    late = opened(changed({name: np.roll(x, 1) for name, x in true.items()}))
    assert not late.has_velocity
    assert "1 ms late against its position" in late.doubts[0]
    noisy = {name: x + 0.02 * rng.standard_normal(len(x)) for name, x in true.items()}
    found = opened(changed(noisy))
    assert not found.has_velocity
    assert "has noise of 0.02 a row" in found.doubts[0]


def test_positions_in_coarse_steps() -> None:
    coarse = {q: np.round(picked().table[q].to_numpy() / 5e-4) * 5e-4 for q in ("q1", "q2", "q3")}
    (doubt,) = watched(changed(coarse)).doubts
    assert "loads look lighter" in doubt


def test_stale_rows_are_no_noise_of_positions() -> None:
    """Their steps had made loads a fifth lighter, with coarse encoders as the likeliest cause, and
    filters that restarted at each had torn pushes into pieces."""
    table, rows = picked().table, np.arange(picked().table.height)
    fresh = np.random.default_rng(1).uniform(size=len(rows)) > 0.02
    stale = table[np.maximum.accumulate(np.where(fresh, rows, 0))].with_columns(t=table["t"])
    found = watched(stale)
    assert_as_it_was(found)
    (doubt,) = found.doubts
    assert "repeat the one before them" in doubt


def test_a_gripper_that_tells_the_other_way() -> None:
    (doubt,) = watched(changed({"gripper": 1 - pl.col("gripper")})).doubts
    assert "0 while something is held, and 1 while not" in doubt


def test_loads_of_a_mapping() -> None:
    """Numbers of a column, and spans of time, in place of `--gripper`."""
    table = changed({"gripper": 255 * pl.col("gripper")})
    of_numbers = Load(column="gripper", when=255.0)
    for load, rows in ((of_numbers, table), (Load(spans=HELD), picked().table)):
        replay = open_replay(picked().model, rows, ColumnMapping(load=load))
        found = watch(picked().model, replay, OnlineSettings(largest_mass=2.0))
        assert_as_it_was(found)
        assert not found.doubts


@pytest.mark.slow
def test_a_gripper_that_tells_early() -> None:
    early = np.roll(picked().table["gripper"].to_numpy(), -50)
    table = changed({"gripper": early})
    (doubt,) = watched(table).doubts
    assert "ms before loads are taken, and left" in doubt
    assert "--grip-time 0.05" in doubt or "--grip-time 0.04" in doubt
    replay = open_replay(picked().model, table, gripper="gripper")
    mended = watch(picked().model, replay, OnlineSettings(largest_mass=2.0, grip_time=0.05))
    assert_as_it_was(mended)
    assert not mended.doubts


UNSEEN = Offset(0.0, 0.0, 9, 0)
NOTHING = RunEvidence(
    gain=np.ones(3), deviation=np.full(3, 0.01), touched=1.0, untouched=99.0, touched_empty=0.0,
    empty=50.0, signals=frozenset({EMPTY, HOLDS}), taken=UNSEEN, released=UNSEEN,
    stuck=np.zeros(3), stuck_at=np.zeros(3),
)  # fmt: skip


def load(mass: float = 1.0) -> WeighedLoad:
    entry = LoadEntry("m", "kg", mass, max(mass - 0.1, 0.0), mass + 0.1, shown=True)
    return WeighedLoad(1.0, 2.0, None, (entry,))


def timing(off: float) -> GripTiming:
    """Signals of 20 loads that are held `off` later, with noise and pushes."""
    found, rng = GripTiming(1e-3), np.random.default_rng(1)
    t = 1e-3 * np.arange(20_000)
    lifted = np.column_stack([np.sin(9 * t), np.cos(11 * t)]) * 3.0
    signal, held = t % 1 < 0.4, (t - off - 0.005) % 1 < 0.4
    residual = held[:, None] * lifted * 0.8 + 0.1 * rng.standard_normal(lifted.shape)
    residual[(t % 0.83 < 0.1)] += [0.0, 2.0]
    lacking = np.full_like(lifted, 0.7)
    for part in np.array_split(np.arange(len(t)), 7):
        found.add(signal[part].astype(float), residual[part], lifted[part], lacking[part])
    found.broken()
    return found


@pytest.mark.parametrize("off", [0.06, 0.02, -0.03, -0.12])
def test_signals_that_are_early_or_late_are_timed(off: float) -> None:
    found = timing(off)
    taken, left = (found.offset(taken=kind) for kind in (True, False))
    for timed in (taken, left):
        assert timed.low - 6e-3 < off < timed.high + 6e-3
        assert timed.high - timed.low < 0.03
    assert taken.signals + left.signals == 39
    (doubt,) = gripper_doubts(replace(NOTHING, taken=taken, released=left), [load()], 0.0)
    assert f" ms {'before' if off > 0 else 'after'} loads are taken, and left" in doubt
    assert ("--grip-time" in doubt) == (off > 0)


@pytest.mark.parametrize("way", [1, -1])
def test_a_signal_at_the_end_of_the_search_may_be_farther_off(way: int) -> None:
    low, high = sorted((0.17 * way, 0.195 * way))
    (doubt,) = gripper_doubts(replace(NOTHING, released=Offset(low, high, 9, 8)), [load()], 0.0)
    assert f"signals at least 170 ms {'before' if way > 0 else 'after'} loads are left" in doubt


def test_signals_in_time_are_not_doubted() -> None:
    found = timing(0.0)
    assert found.offset(taken=True).low == found.offset(taken=False).high == 0.0
    known = replace(NOTHING, taken=Offset(0.04, 0.06, 9, 8), released=Offset(0.045, 0.049, 9, 8))
    assert not list(gripper_doubts(known, [load()], 0.05))


def test_a_gripper_that_never_changes_or_closes_on_nothing() -> None:
    (doubt,) = gripper_doubts(replace(NOTHING, signals=frozenset({EMPTY})), [], 0.0)
    assert "signals empty from the first row to the last" in doubt
    (doubt,) = gripper_doubts(replace(NOTHING, signals=frozenset({HOLDS})), [load()], 0.0)
    assert "something held from the first row" in doubt
    always = replace(NOTHING, signals=frozenset({HOLDS}))
    assert not list(gripper_doubts(always, [load()], 0.0, is_column=False))
    (doubt,) = gripper_doubts(NOTHING, [load(0.0), load(0.0), load()], 0.0)
    assert "closed without a part" in doubt


def test_torques_beyond_the_model_for_most_of_the_time_are_no_contact() -> None:
    replay, settings = opened(picked().table), OnlineSettings(largest_mass=2.0)

    def keys(touched: float, untouched: float) -> list[str]:
        seen = replace(NOTHING, touched=touched, untouched=untouched)
        return [doubt.key for doubt in doubts(picked().model, replay, settings, seen, [load()], [])]

    assert "residual" in keys(60.0, 40.0)
    assert "residual" not in keys(10.0, 90.0)
