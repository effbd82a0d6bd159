"""Units, gears, signs and order of columns: each fault is told, and its cure mends it."""

import re
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from deltaid.checks.evidence import evidence
from deltaid.checks.wiring.candidate import WiringHypothesis
from deltaid.checks.wiring.residual import Map, motion, patterns, residual
from deltaid.checks.wiring.search import _likely
from deltaid.checks.wiring.time_unit import _agrees, _faster
from deltaid.checks.wiring.wiring import checked_wiring, checked_wirings
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.model.verdict import Grade
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.load import load_robot
from drives.cycles import cycling
from drives.happening import Happening
from drives.robots import machine
from drives.sensors import Sensors
from faults import faulty
from logs import tabled
from plants import true_parameters
from support import along
from wired import RATE, Columns, bad, evidence_of, only_verdict, recorded, times, without


@pytest.mark.parametrize("name", ["linear-delta", "par4", "irb360-6-1600", "clavel-delta3"])
def test_nothing_is_said_of_right_columns(name: str) -> None:
    verdicts = checked_wiring(evidence_of(name, recorded(name)))
    assert {verdict.grade for verdict in verdicts} == {Grade.GOOD}
    assert {verdict.key for verdict in verdicts} == {"drive-order", "homing-or-tilt", "velocity"}


def test_columns_of_a_drive_that_the_robot_lacks_are_named() -> None:
    columns = recorded("clavel-delta3")
    more = {"q4": columns["q"][:, 0], "tau4": columns["tau"][:, 0]}
    (verdict,) = bad(checked_wiring(evidence_of("clavel-delta3", columns | more)))
    assert (verdict.key, verdict.grade) == ("drive-count", Grade.DOUBTFUL)
    assert "another drive (q4, tau4), but the robot has 3" in verdict.seen
    (verdict,) = bad(
        checked_wiring(evidence_of("clavel-delta3", columns | more | {"q5": more["q4"]}))
    )
    assert "2 more drives (q4, tau4, q5), but the robot has 3" in verdict.seen


def test_columns_beside_the_drives_are_nobody_s_business() -> None:
    columns = recorded("clavel-delta3")
    beside = dict.fromkeys(("q_4", "temperature4", "quality", "tau_sum"), columns["t"])
    assert not bad(checked_wiring(evidence_of("clavel-delta3", columns | beside)))
    named = [{"column": f"q{i}", "unit": "rad"} for i in (1, 2, 3)]
    mapping = ColumnMapping.model_validate({"position": named})
    more = {"q4": columns["q"][:, 0]}
    assert not bad(checked_wiring(evidence_of("clavel-delta3", columns | more, mapping)))


@pytest.mark.parametrize(
    ("name", "which", "factor"),
    [("clavel-delta3", None, 180 / np.pi), ("clavel-delta3", 1, 180 / np.pi),
     ("irb360-6-1600", 3, 180 / np.pi), ("linear-delta", None, 1e3)],
)  # fmt: skip
def test_unit_of_positions(name: str, which: int | None, factor: float) -> None:
    columns = recorded(name)
    n = columns["q"].shape[1]
    by = np.where([which in (None, i) for i in range(n)], factor, 1.0)
    verdict = only_verdict(name, times(columns, q=by))
    assert (verdict.key, verdict.grade) == ("angle-unit", Grade.WRONG)
    assert verdict.subject == ("" if which is None else f"drive{which + 1}")
    assert ("the loops then close" in verdict.seen) == (which != 3)  # no loop has a telescope's


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "linear-delta", "par4"])
@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
def test_time_in_another_unit(name: str, factor: float) -> None:
    """Which is no unit of angles, gear or torque; recorded velocities confirm a small factor."""
    columns = times(recorded(name), t=factor)
    alone = only_verdict(name, without(columns, "qd"), cured=False)
    verdict = only_verdict(name, columns, cured=False)
    assert (verdict.key, verdict.grade) == ("time-unit", Grade.WRONG)
    assert verdict.number == pytest.approx(factor, rel=1e-3)
    assert alone.key == "time-unit"
    (rate,) = re.findall(r"time: {rate: (\d+)}", verdict.cure)
    assert float(rate) == pytest.approx(RATE, rel=0.05)
    assert alone.grade is (Grade.WRONG if factor in (0.1, 10.0) else Grade.DOUBTFUL)
    assert ("as described" in alone.cause) == (alone.grade is Grade.DOUBTFUL)


@pytest.mark.parametrize(("declared", "proposed"), [("ms", "s"), ("us", "ms"), ("1e-3 ms", "ms")])
def test_a_unit_of_time_is_proposed_for_the_declared_one(declared: str, proposed: str) -> None:
    """The nearest one of those that bring speeds below their limits."""
    columns = recorded("irb360-6-1600")
    columns = times(columns, t=1.0 if proposed == "s" else 1e3)
    mapping = ColumnMapping.model_validate({"time": {"column": "t", "unit": declared}})
    (verdict,) = checked_wiring(evidence_of("irb360-6-1600", columns, mapping))
    assert (verdict.key, verdict.grade) == ("time-unit", Grade.WRONG)
    assert f"time: {{column: t, unit: {proposed}}}" in verdict.cure


def test_a_slow_motion_is_not_one_in_another_unit_of_time() -> None:
    """Its inertia and viscous friction are noise, which may seem eight times too large."""
    slow = faulty("slow", 110)
    verdicts = checked_wiring(evidence(slow.robot, slow.table, None))
    assert "time-unit" not in {verdict.key for verdict in verdicts}


def test_a_motion_with_its_time_divided() -> None:
    name, columns = "clavel-delta3", recorded("clavel-delta3")
    right, late = (
        motion(evidence_of(name, given).rows) for given in (columns, times(columns, t=2.0))
    )
    assert right is not None
    assert late is not None
    timed = _faster(late, 2.0)
    for rates, true in ((timed.qd, right.qd), (timed.qdd, right.qdd)):
        assert np.std(rates, axis=0) == pytest.approx(np.std(true, axis=0), rel=0.2)
    assert [_agrees(ratio, 0.5) for ratio in (0.8, 0.6, 0.4, 0.3)] == [False, True, True, False]


def test_heavy_rotors_or_light_friction_are_no_unit_of_time() -> None:
    """One of them alone: both together are what time looks like."""
    name, columns = "clavel-delta3", recorded("clavel-delta3")
    robot = load_robot(name)
    light = {drive: {"viscous": 0.15, "coulomb": 5.0} for drive in robot.drives}
    for changes in ({"friction": light}, {"rotor_inertia": dict.fromkeys(robot.drives, 3.0)}):
        described = robot.changed(**changes)
        keys = {v.key for v in bad(checked_wiring(evidence(described, tabled(**columns), None)))}
        assert "time-unit" not in keys


def test_motor_side_of_a_gear() -> None:
    columns = recorded("clavel-delta3")
    verdict = only_verdict("clavel-delta3", times(columns, q=20.0, qd=20.0, tau=1 / 20))
    assert (verdict.key, verdict.subject) == ("gear", "")
    proposed = dict(verdict.proposals[0].changes)
    assert all(proposed[f"{quantity}[{i}].gear"] == 20
               for quantity in ("position", "velocity", "torque") for i in range(3))  # fmt: skip


@pytest.mark.parametrize("scale", [33 * 65536 / (2 * np.pi), 500.0])
def test_counts_of_an_encoder_are_named(scale: float) -> None:
    """Whatever gear their size looks like."""
    columns = recorded("clavel-delta3")
    q = np.round(columns["q"] * scale)
    (verdict,) = bad(checked_wiring(evidence_of("clavel-delta3", columns | {"q": q})))
    assert "counts of encoders" in verdict.cause
    assert "360/65536 deg" in verdict.cure
    assert not verdict.proposals


def test_spindle_of_a_linear_drive() -> None:
    turns = 2 * np.pi / 0.02
    verdict = only_verdict("linear-delta", times(recorded("linear-delta"), q=turns, qd=turns))
    assert verdict.key == "gear"
    lead = dict(verdict.proposals[0].changes)["position[0].lead"]
    assert lead == pytest.approx(0.02, rel=0.1)  # a straight rail hardly shows it


def test_scale_of_torques() -> None:
    columns = recorded("clavel-delta3")
    motor = only_verdict("clavel-delta3", times(columns, tau=1 / 30), cured=False)
    assert (motor.key, motor.subject) == ("gear", "")
    assert only_verdict("clavel-delta3", times(columns, tau=1e3)).key == "torque-unit"
    signal = only_verdict("clavel-delta3", times(columns, tau=1e-5), cured=False)
    assert (signal.key, "gear" in signal.cause) == ("torque-unit", False)
    alone = only_verdict("clavel-delta3", times(columns, tau=[1, 1 / 25, 1]))
    assert (alone.key, alone.subject) == ("gear", "drive2")
    assert alone.number == pytest.approx(25, rel=0.02)


def test_signs() -> None:
    turned = [1.0, -1.0, 1.0]

    def said(**factors: object) -> tuple[str, str, bool]:
        verdict = only_verdict("linear-delta", times(recorded("linear-delta"), **factors))
        return verdict.key, verdict.subject, "torque" in verdict.cause

    assert said(tau=turned) == ("torque-sign", "drive2", True)
    assert said(tau=-1.0) == ("torque-sign", "", True)
    assert said(q=turned, qd=turned) == ("angle-sign", "drive2", False)
    assert said(q=turned, qd=turned, tau=turned) == ("angle-sign", "drive2", True)


def test_a_sign_that_may_be_of_either_column() -> None:
    # Nothing ties the drive of a telescope to the others.
    columns = recorded("irb360-6-1600")
    verdicts = bad(checked_wiring(evidence_of("irb360-6-1600", times(columns, tau=[1, 1, 1, -1]))))
    assert {verdict.key for verdict in verdicts} == {"torque-sign", "angle-sign"}
    graded = {(verdict.grade, verdict.subject) for verdict in verdicts}
    assert graded == {(Grade.DOUBTFUL, "drive4")}


def test_limbs_that_are_alike_hide_no_simple_cause() -> None:
    # Limbs exchanged, or two signs turned, explain a recording as well as one sign does.
    name = "linear-delta"
    moved, dynamics = motion(evidence_of(name, recorded(name)).rows), compiled(load_robot(name))
    assert moved is not None
    solved = residual(dynamics, moved, Map.identity(3))
    assert solved is not None
    alike = [
        WiringHypothesis(solved, tuple(order.tolist()), signs, evidence=-1e-3 * signs.sum())
        for order, signs in zip(*patterns(3), strict=True)
    ]
    assert min(trial.changes for trial in _likely(alike)) == 0


def test_order_of_drives() -> None:
    columns = recorded("par4")
    torques = only_verdict("par4", columns | {"tau": columns["tau"][:, [1, 0, 2, 3]]})
    assert (torques.key, torques.subject) == ("drive-order", "drive1, drive2")
    together = only_verdict("par4", {k: x[:, [0, 2, 1, 3]] if x.ndim > 1 else x
                             for k, x in columns.items()})  # fmt: skip
    assert together.key == "drive-order"
    assert "together" in together.cause
    # A symmetric robot does not show which limb is which.
    columns = recorded("linear-delta")
    turned = {k: x[:, [1, 2, 0]] if x.ndim > 1 else x for k, x in columns.items()}
    assert not bad(checked_wiring(evidence_of("linear-delta", turned)))


def test_velocities() -> None:
    columns = recorded("clavel-delta3")
    assert only_verdict("clavel-delta3", times(columns, qd=30 / np.pi)).key == "velocity-unit"
    order = only_verdict("clavel-delta3", columns | {"qd": columns["qd"][:, [0, 2, 1]]})
    assert (order.key, order.subject) == ("velocity", "drive2, drive3")
    scale = only_verdict("clavel-delta3", times(columns, qd=[1, 1, 1.4]), cured=False)
    assert (scale.key, scale.grade, scale.subject) == ("velocity", Grade.WRONG, "drive3")
    late = columns | {"qd": np.vstack([columns["qd"][:1], columns["qd"][:-1]])}
    lag = only_verdict("clavel-delta3", late, cured=False)
    assert (lag.key, lag.grade) == ("velocity", Grade.DOUBTFUL)
    assert lag.number == pytest.approx(1e3 / RATE, abs=0.05)


def test_gains_of_drives_are_no_order_of_them() -> None:
    columns = times(recorded("irb360-6-1600"), tau=[1.08, 0.92, 1.04, 0.944])
    verdicts = checked_wiring(evidence_of("irb360-6-1600", columns))
    assert Grade.WRONG not in {verdict.grade for verdict in verdicts}


def test_a_drive_at_rest_tells_neither_sign_nor_order() -> None:
    name = "linear-delta"
    robot, rng = load_robot(name), np.random.default_rng(2)
    dynamics, time = compiled(robot), np.arange(2500) / RATE
    _, q, _, _ = along(dynamics.kinematics, rng, time)
    q[:, 0] = q[:, 0].mean()
    z = dynamics.kinematics.forward(q)
    qd = np.gradient(q, time, axis=0)
    tau = dynamics.torque(z, qd, np.gradient(qd, time, axis=0), prior_parameters(robot))
    tau[:, 0] -= 3 * (tau[:, 0] - tau[:, 0].mean())  # what friction at rest makes of it
    columns = {"t": time, "q": q, "tau": tau + 0.01 * rng.standard_normal(tau.shape)}
    assert not bad(checked_wiring(evidence_of(name, columns)))


def test_standing_still_is_excluded() -> None:
    columns = recorded("clavel-delta3")
    rest = np.repeat([[0.0, 0.0, 0.0]], 500, axis=0)
    still = {k: np.vstack([x, rest + x[-1]]) for k, x in columns.items() if k != "t"}
    still["qd"][-500:] = 0.0
    still["tau"][-500:] += [8.0, -8.0, 4.0]  # friction holds the arms
    again = motion(evidence_of("clavel-delta3", still | {"t": np.arange(3000) / RATE}).rows)
    assert again.awake[: len(again.tau) // 2].all()
    assert not again.awake[-len(again.tau) // 10 :].any()


def test_torques_pass_the_filter_that_samples_pass() -> None:
    # Torques and positions of one sine stay in phase through all stages of filter and thinning.
    rows = evidence_of("linear-delta", recorded("linear-delta")).rows
    sine = rows.q[:, :1] + 0.0 * rows.q
    looked_at = motion(replace(rows, q=sine, tau=sine))
    again = looked_at.filtered(looked_at.q.T).T
    assert len(again) == len(looked_at.tau)
    np.testing.assert_allclose(again, looked_at.tau, atol=2e-4 * np.ptp(sine))


def test_a_recording_too_short_to_be_filtered() -> None:
    short = {name: x[:50] for name, x in recorded("linear-delta").items()}
    assert checked_wiring(evidence_of("linear-delta", short)) == ()


def test_a_recording_without_any_torque() -> None:
    columns = recorded("clavel-delta3")
    assert not checked_wiring(evidence_of("clavel-delta3", times(columns, tau=0.0)))


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "par4"])
def test_gravity_in_the_opposite_direction(name: str) -> None:
    robot = load_robot(name)
    upwards = robot.changed(gravity=(0.0, 0.0, 9.81))
    (verdict,) = bad(checked_wiring(evidence(upwards, tabled(**recorded(name)))))
    assert (verdict.key, verdict.grade) == ("homing-or-tilt", Grade.WRONG)
    assert "opposite direction" in verdict.seen
    (proposal,) = verdict.proposals
    assert dict(proposal.changes) == {"gravity": [0.0, 0.0, -9.81]}


def picking() -> tuple[str, Columns]:
    """Six seconds of a robot that packs, by the oracle."""
    robot = load_robot("clavel-delta3")
    machine = cycling(robot, true_parameters(robot, np.random.default_rng(3)), "adept", 1)
    log = Sensors().recorded(Happening(machine, 6.0, 1))
    q, tau = (log.select(f"{x}{i}" for i in (1, 2, 3)).to_numpy() for x in ("q", "tau"))
    return robot.name, {"t": log["t"].to_numpy(), "q": q, "tau": tau}


@pytest.mark.parametrize("angles", [[-1, 1, -1], [1, 1, 1]])
def test_two_drives_reversed_while_packing(angles: list[int]) -> None:
    name, columns = picking()
    verdicts = bad(checked_wiring(evidence_of(name, times(columns, q=angles, tau=[-1, 1, -1]))))
    assert {verdict.subject for verdict in verdicts} == {"drive1", "drive3"}
    assert {verdict.grade for verdict in verdicts} == {Grade.WRONG}
    assert all(("position" in str(verdict.proposals)) == (angles[0] < 0) for verdict in verdicts)
    assert not bad(checked_wiring(evidence_of(name, columns)))


def test_a_reversed_drive_that_masses_nearly_explain() -> None:
    """Free least squares, and masses near their prior, leave little of a rail's torques."""
    case = faulty("both-signs", 403)
    verdicts = bad(checked_wiring(evidence(case.robot, case.table)))
    assert [(verdict.key, verdict.subject) for verdict in verdicts] == [("angle-sign", "drive3")]


def test_several_recordings_get_one_verdict() -> None:
    name, columns = picking()
    wrong = times(columns, q=[-1, 1, 1], tau=[-1, 1, 1])
    half = {key: values[: len(values) // 2] for key, values in wrong.items()}
    common, each = checked_wirings([evidence_of(name, wrong), evidence_of(name, half)])
    assert [(verdict.key, verdict.subject, verdict.grade) for verdict in common] == [
        ("angle-sign", "drive1", Grade.WRONG)
    ]
    assert not [verdict for verdicts in each for verdict in bad(verdicts)]


def test_a_drive_that_is_reversed_in_one_of_two_recordings_is_named_there() -> None:
    """Judged together, they would make a reversed wrist look like a poor model."""
    reversed_drive = pl.col("q4", "tau4") * -1
    made, sensors = Happening(machine("delta4", 0, False), 14.0, 1), Sensors()
    right, other = (sensors.recorded(happening) for happening in (made, replace(made, seed=2)))
    records = [
        evidence(made.machine.robot, log) for log in (right, other.with_columns(reversed_drive))
    ]
    common, each = checked_wirings(records)
    assert not bad(common)
    assert not bad(each[0])
    assert [(verdict.key, verdict.subject) for verdict in bad(each[1])] == [
        ("angle-sign", "drive4")
    ]


@pytest.mark.parametrize(
    ("factor", "unit"), [(30.0, "min"), (150.0, "min"), (3.6e3, "3600 s"), (8.64e4, "86400 s")]
)
def test_a_time_so_much_too_short_that_nothing_can_be_filtered_is_named(
    factor: float, unit: str
) -> None:
    name = "irb360-6-1600"
    columns = times(without(recorded(name), "qd"), t=1 / factor)
    (verdict,) = checked_wiring(evidence_of(name, columns))
    assert (verdict.key, verdict.grade) == ("time-unit", Grade.WRONG)
    chords = np.abs(np.diff(columns["q"], axis=0)).sum(axis=0) / np.ptp(columns["t"])
    limits = [load_robot(name).limits_of(f"drive{i + 1}").top_speed for i in range(4)]
    largest = max(v / most for v, most in zip(chords, limits, strict=True) if most)
    assert 1.0 < verdict.number <= largest
    assert f"unit: {unit}}}" in verdict.cure


def test_a_torque_column_copied_from_another_drive_is_refused() -> None:
    columns = recorded("clavel-delta3")
    with pytest.raises(RecordingError, match="torques of drive1 and drive2 are one signal"):
        checked_wiring(
            evidence_of("clavel-delta3", columns | {"tau": columns["tau"][:, [0, 0, 2]]})
        )


def test_a_position_column_copied_from_another_drive_is_refused() -> None:
    columns = recorded("clavel-delta3")
    q = columns["q"][:, [0, 0, 2]]
    with pytest.raises(RecordingError, match="positions of drive1 and drive2 are one signal"):
        checked_wiring(
            evidence_of("clavel-delta3", columns | {"q": q, "qd": columns["qd"][:, [0, 0, 2]]})
        )
    # Drives that move up and down together have one position, and torques that go together.
    alike = {name: columns[name][:, [0, 0, 0]] for name in ("q", "qd", "tau")}
    noise = np.random.default_rng(0).normal(scale=0.2 * alike["tau"].std(), size=alike["tau"].shape)
    checked_wiring(evidence_of("clavel-delta3", columns | alike | {"tau": alike["tau"] + noise}))


def test_drives_that_rest_are_no_copies() -> None:
    columns = recorded("irb360-6-1600")
    q = np.where([True, False, False, True], columns["q"], columns["q"][0])
    checked_wiring(evidence_of("irb360-6-1600", {"t": columns["t"], "q": q, "tau": columns["tau"]}))


def test_a_robot_that_stands_still_is_refused_as_one() -> None:
    columns, rng = recorded("irb360-6-1600"), np.random.default_rng(0)
    q = columns["q"][0] + 1e-5 * rng.normal(size=columns["q"].shape)
    tau = columns["tau"][0] + 0.1 * rng.normal(size=columns["tau"].shape)
    with pytest.raises(RecordingError, match="the robot stands still: no position changes by more"):
        checked_wiring(evidence_of("irb360-6-1600", {"t": columns["t"], "q": q, "tau": tau}))


def test_one_outlier_changes_no_unit() -> None:
    columns = recorded("irb360-6-1600")
    tau = columns["tau"].copy()
    tau[1500, 3] = 9000.0
    assert not bad(checked_wiring(evidence_of("irb360-6-1600", columns | {"tau": tau})))
