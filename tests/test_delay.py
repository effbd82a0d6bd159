"""Torques that come late, put back beside the motion: closed forms, ends, block borders."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.recording.columns import Channel, Columns, TimeChannel
from deltaid.recording.delay import Shift, delayed


def columns(drives: int, *, velocity: bool = False) -> Columns:
    def channels(name: str) -> tuple[Channel, ...]:
        return tuple(Channel(f"{name}{i}", 1.0, 0.0) for i in range(drives))

    only = Columns(TimeChannel("t", 1.0, 0.0), channels("q"), (), (), channels("tau"))
    return replace(only, velocity=channels("qd")) if velocity else only


def waves(rate: float, late: np.ndarray, seconds: float = 2.0) -> np.ndarray:
    """Rows of t, q, q̇, torques that come late, and weights; torques are 3 q + 2 q̇ of their time."""
    t, dof = np.arange(round(seconds * rate)) / rate, len(late)
    turns = 2 * np.pi * (1.0 + 0.7 * np.arange(dof))

    def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(turns * time), turns * np.cos(turns * time)

    q, qd = at(t[:, None])
    early = at(t[:, None] - late)
    return np.hstack([t[:, None], q, qd, 3 * early[0] + 2 * early[1], np.ones((len(t), dof))])


def put_right(rows: np.ndarray, late: np.ndarray, rate: float, cuts: list[int]) -> np.ndarray:
    blocks = iter(np.split(rows, cuts))
    kinds = columns(len(late), velocity=True)
    return np.vstack([*delayed(blocks, kinds, Shift.of_delays(late.tolist(), rate), rate)])


@pytest.mark.parametrize("rate", [100.0, 1000.0, 10_000.0])
@pytest.mark.parametrize(
    "late",
    [[7.3e-3] * 3, [-10e-3] * 3, [20e-3] * 3, [2e-3, 2e-3, -1.5e-3], [0.11e-3, -4.4e-3, 3.37e-3]],
)
def test_torques_stand_beside_their_motion(rate: float, late: list[float]) -> None:
    rows = put_right(waves(rate, np.array(late)), np.array(late), rate, [31, 32, 90])
    _, q, qd, tau, weights = np.split(rows, [1, 4, 7, 10], axis=1)
    error = np.where(weights > 0, tau - 3 * q - 2 * qd, 0.0)
    assert np.abs(error).max() < 2e-4 * np.abs(tau).max()
    turns = 2 * np.pi * (1.0 + 0.7 * np.arange(3))
    np.testing.assert_allclose(q[9:-9], np.sin(turns * rows[9:-9, :1]), atol=1e-6)
    lost = np.count_nonzero(weights == 0, axis=0)
    assert np.all(lost >= np.floor(np.abs(late) * np.array(rate) + 1e-9))
    assert np.all(lost <= np.ceil(np.abs(late) * np.array(rate)) + 8)


def test_rows_do_not_depend_on_how_they_are_cut() -> None:
    late, rng = np.array([1.3e-3, -0.4e-3, 6e-3]), np.random.default_rng(0)
    rows = rng.standard_normal((25_000, 13))
    rows[:, -3:] = rng.uniform(size=(25_000, 3)) < 0.9
    whole = put_right(rows, late, 1000.0, [])
    some = np.sort(rng.integers(0, 25_000, 400)).tolist()
    np.testing.assert_array_equal(put_right(rows, late, 1000.0, some), whole)
    assert len(whole) == len(rows)


def test_a_common_lag_leaves_every_torque_as_it_was_recorded() -> None:
    """And moves it by whole samples: a jump stays one."""
    rows = waves(1000.0, np.zeros(2), 0.1)
    rows[:, 5:7] = np.sign(np.arange(100) - 49.5)[:, None]
    out = put_right(rows, np.full(2, 2.4e-3), 1000.0, [])
    np.testing.assert_array_equal(out[:-2, 5:7], rows[2:, 5:7])
    np.testing.assert_allclose(out[:, 0], rows[:, 0] - 0.4e-3, atol=1e-12)
    np.testing.assert_allclose(out[20:80, 1], np.sin(2 * np.pi * out[20:80, 0]), atol=1e-9)


def test_of_drives_that_differ_as_few_as_can_be_are_interpolated() -> None:
    shift = Shift.of_delays([2.4e-3, -0.6e-3, 2.4e-3, 1.0e-3], 1000.0)
    assert shift.whole == (2, -1, 2, 1)
    np.testing.assert_allclose(shift.common, 0.4)
    np.testing.assert_allclose(shift.rest, [0, 0, 0, -0.4], atol=1e-9)
    assert shift.smear == (0, 0, 0, 2)


def test_the_weight_is_the_least_of_the_rows_own_and_of_those_that_a_torque_is_made_of() -> None:
    rows = waves(1000.0, np.zeros(2), 0.1)
    rows[50, -2:], rows[60, -1] = 0.0, 0.3
    whole = put_right(rows, np.array([3e-3, 3e-3]), 1000.0, [])
    assert np.flatnonzero(whole[:-3, -2] == 0).tolist() == [47, 50]
    assert np.flatnonzero(whole[:, -1] == 0.3).tolist() == [57, 60]
    parted = put_right(rows, np.array([3e-3, 0.5e-3]), 1000.0, [])
    assert np.flatnonzero(parted[3:-3, -1] == 0).tolist() == [45, 46, 47, 48]
    assert np.all(whole[-3:, -2:] == 0)
    assert np.all(whole[:47, -2:] == 1)


def test_without_a_lag_nothing_changes() -> None:
    rows = waves(500.0, np.zeros(3))
    np.testing.assert_array_equal(put_right(rows, np.zeros(3), 500.0, [100]), rows)


def test_a_segment_shorter_than_the_lag_counts_for_nothing() -> None:
    rows = waves(1000.0, np.zeros(2), 0.004)
    out = put_right(rows, np.full(2, 9.5e-3), 1000.0, [1])
    assert len(out) == 4
    assert np.all(out[:, -2:] == 0)
    assert [*delayed(iter([]), columns(2), Shift.of_delays((1e-3, 1e-3), 1000.0), 1000.0)] == []
