"""Limits of an excitation: all are kept, or refused by name."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.random_motion import random_motion
from deltaid.robot.limits import Box, Cylinder, Hemisphere
from deltaid.robot.load import load_robot
from deltaid.view.excitation import verdict
from sweeps import slow, swept


def test_limits_that_fight_are_named() -> None:
    robot = load_robot("clavel-delta3").changed(
        workspace={"shape": "cylinder", "radius": 0.3, "z": [-1.1, -0.8]},
        drive_limits={f"drive{i}": {"angle_deg": [-44, -30]} for i in (1, 2, 3)},
    )
    with pytest.raises(DeltaidError, match=r"drive\d leaves its angle range") as caught:
        Exciter(compiled(robot), ExcitationSettings(starts=1)).optimise()
    assert "workspace" in str(caught.value)


@pytest.mark.parametrize("ends", [(-90.0, 90.0), (90.0, 270.0)])
def test_random_motions_keep_the_range_of_a_telescope(ends: tuple[float, float]) -> None:
    robot = load_robot("irb360-6-1600")
    own = robot.drive_limits["drive4"].changed(angle_deg=ends)
    kinematics = compiled(
        robot.changed(drive_limits=robot.drive_limits | {"drive4": own})
    ).kinematics
    motion = random_motion(kinematics, np.random.default_rng(0))
    q = kinematics.inverse(motion.evaluate(np.linspace(0, 10, 500))[0])
    low, high = np.deg2rad(ends)
    assert kinematics.home[3] == pytest.approx(0.5 * (low + high))
    assert low <= q[:, 3].min()
    assert q[:, 3].max() <= high
    assert np.ptp(q[:, 3]) > 0.3 * (high - low)


def test_a_motion_that_determines_next_to_nothing_is_poor() -> None:
    robot = load_robot("clavel-delta3").changed(platform_speed=1e-4)
    result = Exciter(compiled(robot), ExcitationSettings(starts=1, duration=3.0)).optimise()
    determined = sum(p.std < p.prior_std for p in result.predictions)
    sentence = verdict(result).sentence
    assert sentence.startswith("Poor")
    assert f"determines {determined} of {len(result.predictions)} combinations" in sentence


@given(
    radius=st.floats(0.1, 0.5),
    speed=st.floats(0.5, 5),
    acceleration=st.floats(5, 60),
    swing=st.floats(15, 60),
    torque=st.floats(40, 200),
)
@example(radius=0.157493889294181, speed=2.8159673209, acceleration=40.044, swing=15, torque=40)
@settings(max_examples=1, deadline=None)
def test_any_limits_are_kept_or_refused(radius, speed, acceleration, swing, torque) -> None:
    robot = load_robot("clavel-delta3").changed(
        workspace={"shape": "cylinder", "radius": radius, "z": [-1.1, -0.85]},
        platform_speed=speed,
        platform_acceleration=acceleration,
        strut_swing_deg=swing,
        drive_limits={f"drive{i}": {"torque": torque} for i in (1, 2, 3)},
    )
    exciter = Exciter(compiled(robot), ExcitationSettings(starts=1))
    result = exciter.optimise()
    assert all(limit.share <= 1.0 for limit in result.limits)
    z, zd, zdd = result.run.evaluate(np.linspace(0, result.run.duration, 3000))
    assert np.all(robot.workspace.contains(z[:, :3] * [1 - 1e-9, 1 - 1e-9, 1]))
    assert np.abs(zd).max() <= speed
    assert np.abs(zdd).max() <= acceleration


@pytest.mark.parametrize(
    "space",
    [
        slow(Cylinder(shape="cylinder", radius=0.4, z=(-1.1, -0.8))),
        Hemisphere(shape="hemisphere", radius=0.4, top=-0.8),
        Box(shape="box", x=(-0.3, 0.2), y=(-0.1, 0.4), z=(-1.1, -0.8)),
    ],
)
def test_motions_stay_in_each_kind_of_workspace(space) -> None:
    robot = load_robot("clavel-delta3").changed(workspace=space)
    result = Exciter(compiled(robot), ExcitationSettings(starts=1)).optimise()
    z, _, _ = result.run.evaluate(np.linspace(0, result.run.duration, 3000))
    assert np.all(space.contains(z[:, :3]))
    centre, half = space.inner_box
    corners = centre + half * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * (1 - 1e-9)
    assert np.all(space.contains(corners))


@pytest.mark.parametrize("torque", swept([12.0, 15.0, 20.0], 15.0))
def test_true_torques_keep_tight_limits_where_friction_changes_its_sign(torque: float) -> None:
    limits = {f"drive{i}": {"torque": torque} for i in (1, 2, 3)}
    robot = load_robot("clavel-delta3").changed(drive_limits=limits)
    result = Exciter(compiled(robot), ExcitationSettings(starts=1)).optimise()
    assert np.all(result.torque_max <= torque)


def test_a_middle_of_the_workspace_that_is_out_of_bounds_is_no_dead_end() -> None:
    robot = load_robot("irb360-6-1600")
    bar = robot.telescope.changed(stroke=(0.80, 1.0))
    robot = robot.changed(telescope=bar)
    result = Exciter(compiled(robot), ExcitationSettings(starts=1)).optimise()
    assert np.isfinite(result.criterion_after)
    assert all(limit.share <= 1.0 for limit in result.limits)


def test_limits_that_allow_no_motion_are_named() -> None:
    robot = load_robot("irb360-6-1600").changed(platform_speed=1e-6, platform_acceleration=1e-5)
    with pytest.raises(DeltaidError, match="although it uses the description's limits") as caught:
        Exciter(compiled(robot), ExcitationSettings(starts=1))
    assert "raise the limits" in str(caught.value)
