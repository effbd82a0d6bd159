"""What drives read: positions with zeros and ratios, torques whose constant falls with current."""

import numpy as np
import pytest

from deltaid.effects.falling_gain import Saturation
from deltaid.effects.point import TracePoint
from deltaid.identification.study import studied_trace
from deltaid.recording.columns import Channel, Columns, TimeChannel
from deltaid.recording.readings import Readings
from drives import case
from drives.judge import judge
from drives.told import identified


def test_readings_give_positions_and_torques_as_they_are() -> None:
    def channels(name: str) -> tuple[Channel, ...]:
        return tuple(Channel(f"{name}{i}", 1.0, 0.0) for i in (1, 2))

    columns = Columns(
        TimeChannel("t", 1.0, 0.0), channels("q"), channels("qd"), (), channels("tau")
    )
    rows = np.random.default_rng(3).standard_normal((4, 9))
    readings = Readings(
        zero=(0.1, -0.2), ratio=(0.01, 0.0), falling=((0.1, 0.02), (0.0, 0.0)), largest=(2.0, 1.0)
    )
    out, u = readings.corrected(rows, columns), rows[:, 5] / 2.0
    assert out[:, 1] == pytest.approx(1.01 * rows[:, 1] + 0.1)
    assert out[:, 2] == pytest.approx(rows[:, 2] - 0.2)
    assert out[:, 3] == pytest.approx(1.01 * rows[:, 3])
    assert out[:, 5] == pytest.approx(rows[:, 5] * (1 - 0.1 * u**2 - 0.02 * u**4))
    assert out[:, [0, 4, 6, 7, 8]] == pytest.approx(rows[:, [0, 4, 6, 7, 8]])


def test_what_amplifiers_say_is_the_inverse_of_what_it_means() -> None:
    readings = Readings(falling=((0.4, -0.13), (0.1, 0.05)), largest=(2.0, 3.0))
    recorded = np.random.default_rng(5).uniform(-1, 1, (50, 2)) * [2.0, 3.0]
    u = recorded / [2.0, 3.0]
    torque = recorded * (1 - np.array([0.4, 0.1]) * u**2 - np.array([-0.13, 0.05]) * u**4)
    assert readings.recorded(torque) == pytest.approx(recorded, abs=1e-9)
    assert np.all(np.abs(readings.recorded(10 * torque)) <= [2.0, 3.0])
    assert Readings(zero=(0.1, 0.1)).recorded(torque) is torque


def test_torques_grow_with_current() -> None:
    u = np.linspace(0, 1, 200)[:, None]
    steep, gentle = (0.5, 0.6), (0.2, 0.05)
    possible = Saturation().possible(np.array([*steep, *gentle])).reshape(-1, 2)
    slope = 1 - 3 * possible[:, 0] * u**2 - 5 * possible[:, 1] * u**4
    assert slope.min() == pytest.approx(0.1, abs=0.01)
    assert possible[0] / possible[0, 0] == pytest.approx(np.array(steep) / steep[0])
    assert possible[1] == pytest.approx(gentle)


def test_slopes_of_a_torque_constant_are_at_recorded_torques() -> None:
    """τ = Y p falls by what a coefficient adds to the share that joints lack."""
    result = identified(case("falling-gain", "delta3"))
    recording, p = result.recordings[0], result.model.p
    readings = recording.repairs.readings
    assert readings is not None
    record = studied_trace(result.problem.dynamics, recording, p)
    columns = Saturation().columns(TracePoint(record, p, highest=readings.largest))
    model, step = record.model(p), 1e-5
    within = np.abs(readings.recorded(model.T).T) < np.array(readings.largest)[:, None]
    assert within.mean() > 0.99
    for drive in range(3):
        for k in range(2):
            pairs = np.array(readings.falling)
            pairs[drive, k] += step
            moved = readings.model_copy(update={"falling": tuple(map(tuple, pairs.tolist()))})
            more = moved.recorded(model.T).T - readings.recorded(model.T).T
            share = readings._share(readings.recorded(model.T))[1].T
            expected = np.zeros_like(model)
            expected[drive] = (more * share)[drive] / step
            column = columns[:, :, 2 * drive + k]
            assert column[within] == pytest.approx(expected[within], rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("row", ["saturation", "falling-gain"])
def test_motors_that_saturate_are_the_only_cause(row: str) -> None:
    made = case(row, "delta4")
    judged = judge(made, identified(made))
    assert dict(judged.said)["torque-constant"] == 4
    # The form is not quite that of motors that saturate softly: small ripples are on an edge.
    assert set(dict(judged.said)) <= {"torque-constant", "contact", "ripple"}
    assert judged.M < 0.008  # 0.9 to 2.7 % where slopes are at the model's torques
    assert judged.friction_shape < 0.01
