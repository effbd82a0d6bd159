"""Friction of the ball joints at the ends of struts."""

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.effects.ball_joints import BallJointFriction, of_ball_joints
from deltaid.effects.point import TracePoint
from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import Grade
from deltaid.robot.load import load_robot
from drives import case
from drives.identify import identified
from drives.judge import judge
from drives.pulls import BallJoints
from support import example

KINDS = ("clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "par4", "i4")


def vector(S: np.ndarray) -> np.ndarray:
    """ω of skew matrices."""
    return np.stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]], axis=1)


def rates(dynamics: Dynamics, z: np.ndarray, zd: np.ndarray) -> np.ndarray:
    """|ω| of all joints, (2, samples, limbs), by poses of struts and driven bodies alone."""
    step, bodies = 1e-5, {}
    ends = [dynamics.kinematics.poses(z + way * zd) for way in (step, -step, 0)]
    for later, before, now in zip(*ends, strict=True):
        turned = (later.R_WB - before.R_WB) / (2 * step)
        bodies.setdefault(now.name, []).append(
            (now.R_WB[:, :, 0], vector(turned @ now.R_WB.transpose(0, 2, 1)))
        )
    on_arms, on_platform = list[np.ndarray](), list[np.ndarray]()
    for limb in range(len(dynamics.robot.limb_geometry)):
        driven, strut = dynamics.robot.limb_bodies(limb)
        of_limb = sum(dynamics.robot.limb_bodies(k)[0] == driven for k in range(limb))
        (_, w_driven), (x, w_strut) = bodies[driven][of_limb], bodies[strut][of_limb]
        # about its own axis a strut turns half as fast as the arm
        spin = 0.5 * np.sum(w_driven * x, axis=1) - np.sum(w_strut * x, axis=1)
        w_strut = w_strut + spin[:, None] * x
        on_arms.append(np.linalg.norm(w_strut - w_driven, axis=1))
        on_platform.append(np.linalg.norm(w_strut, axis=1))
    return np.array([on_arms, on_platform]).transpose(0, 2, 1)


@pytest.mark.parametrize("name", KINDS)
def test_torques_are_slopes_of_the_power_that_joints_lose(name: str) -> None:
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(3)
    kinematics, step = dynamics.kinematics, 1e-5
    z = kinematics.home + 0.02 * rng.standard_normal((6, dynamics.dof))
    zd, other = rng.standard_normal((2, 6, dynamics.dof))
    J = kinematics.jacobian(z)
    qd, towards = (np.einsum("sij,sj->si", J, way) for way in (zd, other))
    lost = [rates(dynamics, z, zd + way * other).sum(axis=2) for way in (step, -step)]
    on_arms, on_platform = (lost[0] - lost[1]) / (2 * step)
    friction = BallJointFriction(dynamics, (), (1.0, 1.0), fastest=1e-6)
    entries = friction.of_motion(z, qd, qd).reshape(2, dynamics.dof, 6)
    slopes = np.sum(entries * towards.T, axis=1)
    expected = np.array([on_platform + on_arms, on_platform - on_arms])
    assert slopes == pytest.approx(expected, rel=1e-4, abs=1e-5)
    if name == "linear-delta":
        assert np.abs(slopes[1]).max() < 1e-9 * np.abs(slopes[0]).max()


def test_a_joint_that_hardly_turns_has_little_friction() -> None:
    """Its power is ω² / √(ω² + r²), r being a hundredth of the fastest platform over a strut."""
    dynamics = compiled(load_robot("clavel-delta3"))
    kinematics, fastest = dynamics.kinematics, 2.0
    friction = BallJointFriction(dynamics, (), (1.0, 1.0), fastest=fastest)
    z, zd = kinematics.home[None], np.array([[0.01, 0.02, -0.015]])
    qd = np.einsum("sij,sj->si", kinematics.jacobian(z), zd)
    moment, _ = friction.of_motion(z, qd, qd).reshape(2, 3)
    omega, r = rates(dynamics, z, zd), 0.01 * fastest / dynamics.robot.limb_geometry[0].strut
    assert moment @ qd[0] == pytest.approx(np.sum(omega**2 / np.hypot(omega, r)), rel=1e-4)
    assert not friction.of_motion(z, 0 * qd, qd).any()


def test_the_correction_is_the_mean_moment_of_both_ends() -> None:
    friction = BallJointFriction(compiled(load_robot("clavel-delta3")), (), (1.0, 1.0))
    judged = [
        Parameter(name=name, value=value, std=half / 2, low=value - half, high=value + half,
                  unit="N m", prior=0.0, determined_by="data")
        for name, value, half in (("moment", 0.3, 0.02), ("difference", -0.1, 0.5))
    ]  # fmt: skip
    (correction,) = friction.to_corrections(judged)
    assert (correction.kind, correction.unit) == ("joint-friction", "N m")
    assert (correction.value, correction.low) == pytest.approx((0.3, 0.28))


def test_joints_of_a_user_defined_mechanism_are_not_known() -> None:
    dynamics = compiled(example("planar_delta"))
    assert of_ball_joints(Mock(spec=TracePoint, dynamics=dynamics)) == ()


def test_check_names_the_friction_of_ball_joints() -> None:
    rubbing = case("ball-joints", "delta3", 0)
    doubts = [
        verdict
        for verdict in deltaid.check(rubbing.robot, rubbing.logs[0])
        if verdict.grade != Grade.GOOD
    ]
    assert [verdict.key for verdict in doubts] == ["joint-friction"]
    assert "follows the turns of the struts in their ball joints" in doubts[0].sentence


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("delta3", 1), ("delta4", 0), ("linear", 0)])
def test_friction_of_ball_joints_is_no_hose_and_no_law_of_drives(
    kind: str, seed: int, tmp_path: Path
) -> None:
    rubbing = case("ball-joints", kind, seed)
    result = identified(rubbing)
    judged = judge(rubbing, result)
    (correction,) = result.model.corrections
    joints = rubbing.happenings[0].pulls[0]
    assert isinstance(joints, BallJoints)
    assert correction.kind == "joint-friction"
    assert correction.value == pytest.approx(0.5 * (joints.elbow + joints.platform), rel=0.05)
    assert judged.M < 0.003
    assert judged.friction_shape < 0.006
    assert np.mean(judged.curves) > 0.8
    model, log = tmp_path / "model.yaml", tmp_path / "log.csv"
    result.save(model)
    rubbing.logs[0].write_csv(log)
    assert deltaid.validate(deltaid.load(model), log).error.nrmse.max() < 0.03
