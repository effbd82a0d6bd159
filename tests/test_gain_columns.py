"""Gains of drives as columns of a fit, and what drives read: zeros, ratios, constants that fall."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.gain_over_time import GainOverTime
from deltaid.effects.point import TracePoint
from deltaid.effects.saturation import Saturation
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.identification.gains import SPREAD, Gains
from deltaid.identification.study import studied_trace
from deltaid.model.parameter_record import Parameter
from deltaid.recording.columns import Channel, Columns, Readings, TimeChannel
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import TorqueDrift
from deltaid.recording.windows import SampleBlock
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import PriorParameter
from drives import case
from drives.identify import identified
from drives.judge import judge
from drives.rows import Case

GAIN = np.array([1.2, 0.9, 1.05])


@dataclass(frozen=True, eq=False)
class Push(Addition):
    """A torque of the second drive, determined by a load that is known."""

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return (PriorParameter("load", "push", "m", "N m", -np.inf, np.inf, 0.0, 1.0),)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1]), np.array([0])

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return np.ones((1, len(w.time)))

    @property
    def scale_reference(self) -> str:
        return "a push"


def gains(ratio_drives: tuple[int, ...] = ()) -> tuple[Dynamics, Gains]:
    """With a push of 3 N m, beside what the prior says of a robot."""
    dynamics = compiled(load_robot("clavel-delta3"))
    values = np.append(prior_parameters(dynamics.robot), 3.0)
    return dynamics, Gains(
        dynamics, (Push(dynamics),), values, GAIN, prior_spread=0.5, ratio_drives=ratio_drives
    )


def test_before_any_recording_torque_constants_are_right_to_a_tenth() -> None:
    """Where torques have been multiplied by c already, what is left is 1/c."""
    _, found = gains()
    left = np.exp([parameter.prior for parameter in found.parameters])
    np.testing.assert_allclose(GAIN * left, 1.0)
    np.testing.assert_allclose([0.5 * parameter.scale for parameter in found.parameters], SPREAD)
    np.testing.assert_array_equal(found.free.A, np.eye(3))


def test_before_any_recording_drives_of_limbs_that_are_alike_are_alike() -> None:
    """Ratios are right to a tenth; what is common to all is left as it is."""
    _, found = gains(ratio_drives=(0, 1, 2))
    free = found.free
    left = free.A @ [variable.prior for variable in free.variables]
    total = GAIN * np.exp(left)
    np.testing.assert_allclose(total, np.exp(np.mean(np.log(GAIN))))
    np.testing.assert_allclose([0.5 * variable.scale for variable in free.variables], SPREAD)
    np.testing.assert_allclose(free.A.T @ free.A, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(free.A.sum(axis=0), 0.0, atol=1e-12)


def test_drives_that_agree_may_be_the_reference() -> None:
    _, found = gains(ratio_drives=(0, 1, 2))
    free = replace(found, reference=(0, 2)).free
    assert free.A.shape == (3, 2)
    np.testing.assert_allclose(free.A[[0, 2]].sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(free.A[1]), 1.0)


def test_what_drives_have_in_common_is_known_as_their_ratios_scatter() -> None:
    """The mean of three drives, by t of two degrees of freedom."""
    _, found = gains(ratio_drives=(0, 1, 2))
    off = np.log(GAIN) - np.mean(np.log(GAIN))
    standard_error = np.sqrt(np.sum(off**2) / 2 / 3)
    assert found.common_spread == pytest.approx(4.302653 / 1.959964 * standard_error)
    _, two = gains(ratio_drives=(0, 1))
    error = np.abs(np.log(GAIN[0] / GAIN[1])) / 2
    assert two.common_spread == pytest.approx(12.706205 / 1.959964 * error)


def test_torques_that_gains_multiply_are_all_that_drives_bear() -> None:
    """Those of the robot, of other additions, and of what is held; −ε of them is missing."""
    dynamics, found = gains()
    rng, n = np.random.default_rng(0), 5
    z = dynamics.kinematics.home + 0.02 * rng.standard_normal((n, 3))
    qd, qdd, carried = rng.standard_normal((3, n, 3))
    none = np.zeros((n, 0))
    w = SampleBlock(np.arange(n) * 0.1, z, qd, qdd, none, none, none, carried)
    own = dynamics.sparse_regressor(z, qd, qdd, np.zeros_like(qd)).values
    torque = dynamics.torque(z, qd, qdd) + carried + [0.0, 3.0, 0.0]
    recording = object.__new__(PreparedRecording)  # no addition here asks whose samples they are
    np.testing.assert_allclose(found.entries(w, own, recording), -torque.T, rtol=1e-9)
    drives, columns = found.pattern
    np.testing.assert_array_equal(drives, columns)


def judged(std: float) -> list[Parameter]:
    """What a fit leaves of each drive's gain: 2 %."""
    return [
        Parameter(
            name=f"gain.drive{i}", value=0.02, std=std, low=0.02 - 2 * std, high=0.02 + 2 * std,
            unit="", prior=0.0, determined_by="data",
        )
        for i in (1, 2, 3)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("ratio_drives", "std", "words"),
    [((), 0.01, "determined by a push"), ((), 0.06, "hardly shows"),
     ((0, 1), 0.01, "drive3 is assumed correct")],
)  # fmt: skip
def test_what_is_reported_is_the_whole_gain_with_its_interval(
    ratio_drives: tuple[int, ...], std: float, words: str
) -> None:
    """c times what is left of it; told by a load where its prior is not most of what is known."""
    corrections = gains(ratio_drives)[1].to_corrections(judged(std))
    assert [correction.subject for correction in corrections] == ["drive1", "drive2", "drive3"][
        : len(ratio_drives) or 3
    ]
    for c, correction in zip(GAIN, corrections, strict=False):
        expected = c * np.exp([0.02 - 2 * std, 0.02, 0.02 + 2 * std])
        np.testing.assert_allclose([correction.low, correction.value, correction.high], expected)
        assert words in correction.text


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


def test_two_slopes_of_a_torque_constant_are_one_correction() -> None:
    """Their sum, as wide as the wider of the two."""
    robot, values = load_robot("clavel-delta3"), np.array([0.01, 0.02, 0.03, -0.01, 0.0, 0.05])
    half = np.array([0.001, 0.004, 0.005, 0.002, 0.003, 0.003])
    corrections = GainOverTime().corrections(robot, values, half)
    assert [correction.subject for correction in corrections] == list(robot.drives)
    assert [correction.value for correction in corrections] == pytest.approx([3.0, 2.0, 5.0])
    wide = [correction.high - correction.value for correction in corrections]
    assert wide == pytest.approx([0.4, 0.5, 0.3])


def test_torques_grow_with_current() -> None:
    u = np.linspace(0, 1, 200)[:, None]
    steep, gentle = (0.5, 0.6), (0.2, 0.05)
    possible = Saturation().possible(np.array([*steep, *gentle])).reshape(-1, 2)
    slope = 1 - 3 * possible[:, 0] * u**2 - 5 * possible[:, 1] * u**4
    assert slope.min() == pytest.approx(0.1, abs=0.01)
    assert possible[0] / possible[0, 0] == pytest.approx(np.array(steep) / steep[0])
    assert possible[1] == pytest.approx(gentle)


def test_a_torque_constant_that_grows_with_current_is_no_saturation() -> None:
    falls, grows = (0.08, 0.02), (-0.05, -0.03)
    well, hardly = 1e-4 * np.eye(4), np.eye(4)
    assert Saturation().is_possible(np.array([*falls, 0.0, -0.01]), well)
    assert not Saturation().is_possible(np.array([*grows, 0.0, 0.01]), well)
    again = np.array([0.26, -0.2, 0.26, -0.2])  # falls, then rises
    assert not Saturation().is_possible(again, well)
    assert Saturation().is_possible(again, hardly)
    steep = np.array([-0.1, 0.4, -0.1, 0.4])  # of large currents alone
    assert Saturation().is_possible(steep, well)


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


@pytest.mark.slow
@pytest.mark.parametrize("row", ["saturation", "falling-gain"])
def test_motors_that_saturate_are_the_only_cause(row: str) -> None:
    made = case(row, "delta4")
    judged = judge(made, identified(made))
    assert dict(judged.said)["torque-constant"] == 4
    # The form is not quite that of motors that saturate softly: small ripples and windings of gears
    # are on an edge.
    assert set(dict(judged.said)) <= {"torque-constant", "contact", "ripple", "compliance"}
    # 0.4 to 0.9 % by the kernel of BLAS; up to 2.7 % where slopes are at the model's torques
    assert judged.M < 0.01
    assert judged.friction_shape < 0.01


@pytest.mark.slow
def test_the_drive_of_a_telescope_keeps_its_torque_where_limbs_are_compared() -> None:
    made = case("clean", "delta4")
    (log,) = made.logs
    made = replace(made, logs=(log.with_columns(pl.col("tau2") * 1.04),))
    result = identified(made)
    assert result.model.gains == pytest.approx([1.0, 1 / 1.04, 1.0, 1.0], rel=1e-3)
    assert judge(made, result).M < 0.003


@pytest.mark.slow
def test_motors_may_saturate_beside_other_causes() -> None:
    """How far a torque constant falls is no matter of tolerances that parts are made to."""
    made = case("saturation", "delta4")
    (log,) = made.logs
    q, tau = log["q2"].to_numpy(), log["tau2"].to_numpy()
    ripple = 0.02 * np.abs(tau).max() * np.sin(12.0 * q)
    made = replace(made, logs=(log.with_columns(pl.Series("tau2", tau + ripple)),))
    result = identified(made)
    kinds = {correction.kind for correction in result.model.corrections}
    assert {"torque-constant", "ripple"} <= kinds
    assert judge(made, result).M < 0.02


def drifting(made: Case, ends: Sequence[float]) -> Case:
    """With torque constants that drift by these shares to the end of each recording, evenly."""
    drives, logs = len(made.robot.drives), list[pl.DataFrame]()
    for log, end in zip(made.logs, ends, strict=True):
        share = log["t"].to_numpy() / float(np.max(log["t"].to_numpy()))
        names = [f"tau{i + 1}" for i in range(drives)]
        logs.append(log.with_columns(pl.col(name) * (1.0 + end * share) for name in names))
    return replace(made, logs=tuple(logs))


def test_torque_constants_that_drift_are_no_load_that_is_put_down(tmp_path: Path) -> None:
    """By 6 % over the recording, as magnets do that warm up."""
    made = drifting(case("clean", "delta3"), [-0.06])
    model, log = tmp_path / "model.yaml", tmp_path / "log.csv"
    made.logs[0].write_csv(log)
    result = deltaid.identify(made.robot, log)
    corrections = result.model.corrections
    assert [correction.kind for correction in corrections] == ["torque-drift"] * 3
    for correction in corrections:
        assert correction.value == pytest.approx(-6.0, abs=0.5)
        assert (correction.low or 0.0) < -6.0 < (correction.high or -9.0)
    judged = judge(made, result)
    assert judged.M < 0.003  # 4.5 % with the load that a step in time looks like
    assert judged.friction < 0.01
    result.save(model)
    verification = deltaid.validate(deltaid.load(model), log)
    assert verification.error.nrmse.max() < 0.012  # 0.02 where the drift is not read again


def test_each_recording_has_a_drift_of_its_own() -> None:
    """Two halves of a recording: noise that both shared would count twice."""
    made = case("clean", "delta3", 1)
    (log,) = made.logs
    half = len(log) // 2
    halves = (log[:half], log[half:].with_columns(pl.col("t") - log["t"][half]))
    corrections = identified(drifting(replace(made, logs=halves), [0.05, -0.03])).model.corrections
    assert {correction.kind for correction in corrections} == {"torque-drift"}
    values = [correction.value for correction in corrections]
    assert values == pytest.approx([5.0] * 3 + [-3.0] * 3, abs=0.5)
    assert len({correction.log for correction in corrections}) == 2


def test_a_recording_may_have_other_torque_constants_than_the_first() -> None:
    """As of a motor that was warm already, or of a drive with another scale since."""
    made = case("clean", "delta3", 1)
    (log,) = made.logs
    half = len(log) // 2
    second = log[half:].with_columns(pl.col("t") - log["t"][half], pl.col("tau1") * 1.08)
    made = replace(made, logs=(log[:half], second))
    result = identified(made)
    values = [c.value for c in result.model.corrections if c.kind == "torque-drift"]
    assert values == pytest.approx([0.0] * 3 + [8.0, 0.0, 0.0], abs=0.5)
    assert judge(made, result).M < 0.005


def test_drift_is_undone_exactly() -> None:
    drift = TorqueDrift(2.0, 10.0, ((0.1, -0.02, 0.07), (-0.3, 0.05, 0.0)))
    rng, time = np.random.default_rng(3), np.linspace(2.0, 12.0, 50)
    tau, names = rng.standard_normal((50, 2)), ("tau1", "tau2")
    torques = tuple(Channel(name, 1.0, 0.0) for name in names)
    columns = Columns(TimeChannel("t", 1.0, 0.0), (), (), (), torques)
    share = (time - 2.0) / 10.0
    recorded = tau * np.column_stack([
        1.07 + 0.1 * share - 0.02 * share**2, 1 - 0.3 * share + 0.05 * share**2
    ])  # fmt: skip
    assert drift.undone(np.column_stack([time, recorded]), columns)[:, 1:] == pytest.approx(tau)
