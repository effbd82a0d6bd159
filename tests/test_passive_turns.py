"""Rows beside reversals of passive joints, and what refutes a contest before laws are chosen."""

from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.checks.evidence import evidence
from deltaid.dynamics.dynamics import compiled
from deltaid.effects.effect import causes_of
from deltaid.effects.geometry import reshaped
from deltaid.estimation.scatter import NORMAL
from deltaid.estimation.traces import Trace
from deltaid.identification import contest_outcome
from deltaid.identification.contest import Contest
from deltaid.identification.contest_outcome import why_not
from deltaid.identification.passive_turns import speed_errors, usual_speeds
from deltaid.identification.setup import ContestOutcome, Setup
from deltaid.identification.study import Study, beside_any_friction, left_of_a_drive
from deltaid.recording.filter import LowPass
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import Gears
from deltaid.recording.windows import Directions, SampleBlock
from deltaid.robot.load import load_robot
from logs import tabled
from test_lag import frame
from test_residual_checks import truth

# The joint of a Par4's platform turns by a fourth of the tool's angle.
TURNS = 0.25
RATIO = np.array([0.0, 0.01, -0.004, 0.0])
ZERO = np.array([0.003, 0.0, 0.0, -0.002])
LONGER = 1e-3 * np.array([0.0, 0.0, 1.0, 0.0, -2.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
# Sideways, up, azimuth and tilt of each limb [m, rad].
MOUNTED = 1e-3 * np.random.default_rng(4).standard_normal(16)


def motion_at(t: np.ndarray, turn: float = 2.0) -> np.ndarray:
    """A motion of a Par4 whose tool turns to and fro by so much [rad]."""
    phase = 2 * np.pi * t[:, None] * np.array([0.7, 0.9, 0.5, 1.1])
    return np.array([0.0, 0.0, -0.8, 0.0]) + np.array([0.2, 0.15, 0.05, turn]) * np.sin(phase)


def tracing(t: np.ndarray, turn: float = 2.0) -> tuple[Trace, SampleBlock]:
    dynamics, step = compiled(load_robot("par4")), 1e-5
    z = motion_at(t, turn)
    zd = (motion_at(t + step, turn) - motion_at(t - step, turn)) / (2 * step)
    qd = np.einsum("sij,sj->si", dynamics.kinematics.jacobian(z), zd)
    none = np.zeros((len(t), 0))
    part = SampleBlock(t, z, qd, 0 * qd, 0 * qd, 1 + 0 * qd, none, 0 * qd)
    return Trace(
        dynamics, np.zeros(0), (part,), Mock(spec=LowPass), Mock(spec=PreparedRecording)
    ), part


@pytest.mark.parametrize(
    ("ratio", "zero", "longer", "mounted"),
    [
        (RATIO, ZERO, LONGER, MOUNTED),
        (0 * RATIO, ZERO, 0 * LONGER, 0 * MOUNTED),
        (RATIO, 0 * ZERO, 0 * LONGER, 0 * MOUNTED),
    ],
)
def test_errors_of_speeds_are_what_corrections_change(
    ratio: np.ndarray, zero: np.ndarray, longer: np.ndarray, mounted: np.ndarray
) -> None:
    """By positions of the platform a little earlier and later, at the corrected readings."""
    t, step = np.linspace(0.0, 2.0, 160), 1e-5
    trace, part = tracing(t)
    described, robot = trace.dynamics.kinematics, trace.dynamics.robot
    corrected = compiled(reshaped(robot, longer.tolist(), mounted.tolist())).kinematics

    def turned(t: np.ndarray) -> np.ndarray:
        return corrected.forward(described.inverse(motion_at(t)) * (1 + ratio) + zero)[:, 3]

    speed = (turned(t + step) - turned(t - step)) / (2 * step)
    zd = np.linalg.solve(described.jacobian(part.z), part.qd[:, :, None])[:, 3, 0]
    values = {"gear-ratio": ratio, "zero": zero, "length": longer, "mounting": mounted}
    change = TURNS * np.abs(speed - zd)
    step, unapplied = NORMAL * np.sqrt(np.mean(change**2)), change.max()
    assert step > 0.01
    outcome, usual = ContestOutcome(robot, values=values), usual_speeds([trace])[0]
    for before, applied, bound in (
        ({}, values, step),
        (values, {}, unapplied),
        ({}, {}, step + unapplied),
        (values, values, 0.0),
    ):
        errors = speed_errors([trace], exact(), outcome, before, applied)
        assert errors == pytest.approx([min(bound, usual)] if bound else [], rel=1e-4)
    assert speed_errors([trace], exact(), ContestOutcome(robot), {}, {}) == ()


def exact(**errors: np.ndarray) -> Mock:
    """The last sweep of a contest, whose coefficients may have errors."""
    last = Mock(spec=Contest, shrunk=Mock(candidates=tuple(errors)))
    last.errors.side_effect = lambda names, draws: [errors] * draws if names else []
    return last


def test_errors_of_coefficients_count() -> None:
    trace, _ = tracing(np.linspace(0.0, 2.0, 160))
    robot = trace.dynamics.robot
    values = {"zero": ZERO, "tilt": np.ones(2)}
    outcome = ContestOutcome(robot, values=values)
    moved = speed_errors([trace], exact(), outcome, {}, values)
    last = exact(zero=-ZERO, tilt=np.ones(2))
    assert speed_errors([trace], last, outcome, values, values) == pytest.approx(moved)


def test_errors_that_put_poses_out_of_reach_leave_fast_rows_only() -> None:
    trace, _ = tracing(np.linspace(0.0, 2.0, 160))
    values = {"zero": ZERO}
    outcome = ContestOutcome(trace.dynamics.robot, values=values)
    errors = speed_errors([trace], exact(zero=np.full(4, 2.0)), outcome, values, values)
    assert errors == usual_speeds([trace])


def test_errors_are_at_most_the_usual_speed() -> None:
    """Beyond the median of its speed they would exclude most rows."""
    trace, _ = tracing(np.linspace(0.0, 2.0, 160), 0.02)
    (usual,) = usual_speeds([trace])
    outcome = ContestOutcome(trace.dynamics.robot, values={"gear-ratio": RATIO})
    assert speed_errors([trace], exact(), outcome, {}, {}) == (usual,)


def test_rows_where_a_joint_may_turn_either_way_are_excluded() -> None:
    trace, part = tracing(np.linspace(0.0, 2.0, 160))
    kinematics, motion = trace.dynamics.kinematics, (part.z, part.qd, part.qdd)
    rows = Directions(1e-9, np.zeros(4), turns=(2.0 * TURNS,)).known(kinematics, *motion)
    zd = np.linalg.solve(kinematics.jacobian(part.z), part.qd[:, :, None])[:, 3, 0]
    assert 0.05 < np.mean(~rows) < 0.6
    assert np.array_equal(~rows[:, 0], np.abs(zd) < 2.0)
    assert Directions(1e-9, np.zeros(4)).known(kinematics, *motion).all()


def test_behind_compliant_gears_rows_near_reversals_of_passive_joints_are_excluded() -> None:
    """The links follow a step of the gears' torques for two periods of their low-pass."""
    t = np.linspace(0.0, 2.0, 1600)
    trace, part = tracing(t)
    kinematics, step, settling = trace.dynamics.kinematics, 1e-5, 0.04
    qd = [np.einsum("sij,sj->si", kinematics.jacobian(motion_at(t + at)),
                    (motion_at(t + at + step) - motion_at(t + at - step)) / (2 * step))
          for at in (-step, step)]  # fmt: skip
    motion = part.z, part.qd, (qd[1] - qd[0]) / (2 * step)
    zd = np.linalg.solve(kinematics.jacobian(part.z), part.qd[:, :, None])[:, 3, 0]
    reversals = t[1:][zd[1:] * zd[:-1] < 0]
    near = np.abs(t[:, None] - reversals).min(axis=1)
    known = Directions(1e-9, np.zeros(4), settling=settling).known(kinematics, *motion)
    assert len(reversals) > 3
    assert np.all(known[near > 1.05 * settling])
    assert not np.any(known[near < 0.95 * settling])
    gears = Gears((1e-4,) * 4, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4, 2 / settling)
    assert gears.settling == pytest.approx(settling)


def test_beside_friction_of_any_law_no_friction_is_a_cause() -> None:
    """Friction that grows with the square of speed and differs by direction."""
    table, (_, _, _, qd, _) = frame(np.zeros(3), noise=0.01), truth()
    tau = table.select(["tau1", "tau2", "tau3"]).to_numpy()
    more = tau + 0.3 * (qd > 0) + 0.4 * np.sign(qd) * (qd / np.abs(qd).max()) ** 2
    study = evidence(load_robot("clavel-delta3"), table.with_columns(tabled(tau=more))).study
    assert study is not None
    assert {cause.kind for cause in causes_of(study.fit, study.account)} == {"friction-law"}
    beside = beside_any_friction(study)
    assert not causes_of(beside.fit, beside.account)
    assert left_of_a_drive(beside) == 0.0
    assert np.sum(beside.account.left**2) < np.sum(study.fit.span.without(study.fit.tau) ** 2)


@pytest.mark.parametrize(
    ("as_described", "any_law", "kept", "refuted"),
    [
        (0.005, 1.0, "ripple", False),
        (0.02, 0.005, "ripple", False),
        (0.02, 0.015, "ripple", True),
        (0.015, 0.005, "unexplained time", True),  # free functions and any friction explain all
    ],
)
def test_friction_laws_still_to_be_chosen_refute_nothing(
    monkeypatch: pytest.MonkeyPatch, as_described: float, any_law: float, kept: str, refuted: bool
) -> None:
    before, beside = Mock(spec=Study), Mock(spec=Study)
    monkeypatch.setattr(contest_outcome, "beside_any_friction", {before: beside}.__getitem__)
    left = {before: as_described, beside: any_law}
    monkeypatch.setattr(contest_outcome, "left_of_a_drive", left.__getitem__)
    outcome = Mock(spec=ContestOutcome, kept=(kept,))
    why = why_not(Mock(spec=Setup, studies=(before, None), outcome=outcome), ())
    assert why == ("1.5 % of a drive's torque would remain" if refuted else "")
