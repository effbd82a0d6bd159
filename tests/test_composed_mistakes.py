"""Mistakes in descriptions of composed robots: what is wrong is said, with line and key."""

import re

import casadi as ca
import numpy as np
import pytest

from deltaid.errors import DescriptionError, KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue_text, load_robot, parse
from descriptions import refusal, replaced
from support import KINDS
from sweeps import swept


def changed(name: str, old: str, new: str) -> str:
    """A catalogue file with one place changed."""
    return replaced(old, new, catalogue_text(name))


SPRING = "workspace:\n"
MISTAKES = [
    ("par4", "strut: 0.825", "strut: [0.8, 0.8, 0.8]", "limbs.strut: has 3 entries, but azimuth"),
    (
        "par4",
        "upper_arm: 0.375",
        "upper_arm: []",
        "limbs.upper_arm: has 0 entries, but azimuth_deg",
    ),
    ("par4", "  upper_arm: 0.375\n", "", "line 13, limbs: upper_arm is missing; rotary drives"),
    ("par4", "ratio: 4", "ratio: 0", "line 25, platform.ratio: is zero; the tool would not turn"),
    ("i4", "ratio: 40", "ratio: 0", "line 25, platform.ratio: is zero; the tool would not turn"),
    ("par4", "first: [1, 2]", "first: [1, 5]", "platform.first: must name two limbs by number"),
    ("par4", "first: [1, 2]", "first: [1]", "platform.first: must name two limbs"),
    ("par4", "  length: 0.120\n  f", "  lenght: 0.1\n  f", "line 23, platform.lenght: unknown key"),
    ("par4", "kind: par4", "kind: par5", "'par5' is no 'kind'; choose from 'rigid', 'h4', 'par4'"),
    ("par4", "kind: par4", "kind: h4", "line 21, platform.half_length: is missing"),
    (
        "par4",
        "[-185, 185]",
        "[185, -185]",
        "platform.angle_deg: must be given as [lowest, highest]",
    ),
    (
        "par4",
        "bodies:\n",
        "telescope: {}\nbodies:\n",
        "line 30, telescope: is given, but the platf",
    ),
    (
        "par4",
        "  MP: #",
        "  SB: #",
        "line 30, bodies: lacks MP and has unknown SB; this robot has U, S",
    ),
    (
        "par4",
        "limbs:\n",
        "limbs:\n  identical: false\n",
        "bodies: lacks U1, S1, U2, S2, U3, S3, U4",
    ),
    (
        "par4",
        "  drive1: 0.10",
        "  drive5: 0.10",
        "rotor_inertia: has unknown drive5; choose from dri",
    ),
    (
        "par4",
        "{angle_deg: [-45, 95], torque: 180}",
        "{force: 180}",
        "has force, but the drive is rot",
    ),
    (
        "par4",
        SPRING,
        f"springs: {{drive1: {{stiffness: 4, rest: 1}}}}\n{SPRING}",
        "the joint turns",
    ),
    (
        "par4",
        SPRING,
        f"springs: {{slide: {{stiffness: 4}}}}\n{SPRING}",
        "springs: has unknown slide",
    ),
    (
        "i4",
        SPRING,
        f"springs: {{platform: {{stiffness: 4, rest_deg: 1}}}}\n{SPRING}",
        "joint slides",
    ),
    (
        "linear-delta",
        SPRING,
        f"springs: {{drive1: {{stiffness: 4, rest_deg: 1}}}}\n{SPRING}",
        "line 47, springs.drive1: has rest_deg, but the joint slides",
    ),
    ("linear-delta", "limbs:\n", "limbs:\n  tilt_deg: [0, 10]\n", "limbs.tilt_deg: has 2 entries"),
    (
        "linear-delta",
        "  strut:",
        "  upper_arm: 0.2\n  strut:",
        "limbs.upper_arm: is given, but a lin",
    ),
    (
        "linear-delta",
        "[0, 120, 240]",
        "[0, 90, 180, 270]",
        "azimuth_deg: has 4 limbs, but a platfor",
    ),
    (
        "linear-delta",
        "drive: linear",
        "drive: prismatic",
        "limbs.drive: must be 'rotary' or 'linear'",
    ),
    (
        "linear-delta",
        "base_radius: 0.300",
        "base_radius: 300",
        "base_radius: 300 m cannot be; lengths",
    ),
    (
        "linear-delta",
        "{position: [-0.15, 0.50], speed: 2.5, force: 600}",
        "{torque: 60}",
        "drive_limits.drive1: has torque, but the drive is linear",
    ),
    (
        "linear-delta",
        "{position: [-0.15, 0.50], speed: 2.5, force: 600}",
        "{position: [-150, 0.5], speed: 2500}",
        "drive_limits.drive1.position[1]: -150 m cannot be; positions are in metres; line 53, ",
    ),
    (
        "linear-delta",
        "drive1: {viscous: 40",
        "platform: {viscous: 40",
        "friction: has unknown platform; choose from drive1, drive2, drive3",
    ),
]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake: tuple[str, str, str, str]) -> None:
    name, old, new, fragment = mistake
    message = refusal(changed(name, old, new))
    assert fragment in message
    assert "line 1," not in message


def test_coinciding_rails_are_named() -> None:
    text = changed("linear-delta", "[0, 120, 240]", "[0, 0, 180]")
    points = "base_points: [[0.3, 0, 0], [0.3, 0, 0], [-0.3, 0, 0]]"
    message = refusal(text.replace("base_radius: 0.300", points))
    assert "limbs: the rails coincide, those of limbs 1 and 2" in message


def test_vertical_rails_on_one_line_coincide_whatever_their_azimuth() -> None:
    message = refusal(changed("linear-delta", "base_radius: 0.300", "base_radius: 0"))
    assert "limbs: the rails coincide, those of limbs 1 and 2" in message


def test_limbs_at_right_angles_are_a_robot() -> None:
    """Struts push and pull, so limbs need not surround the platform."""
    text = changed("clavel-delta3", "[0, 120, 240]", "[0, 90, 180]")
    kinematics = Kinematics(parse(text, RobotDescription, where="robot.yaml"))
    z = np.random.default_rng(0).uniform([-0.3, -0.3, -1.1], [0.3, 0.3, -0.85], (1000, 3))
    assert kinematics.regularity(z).worst.max() < 2.5
    np.testing.assert_allclose(kinematics.forward(kinematics.inverse(z)), z, atol=1e-12)


@pytest.mark.parametrize("name", swept(KINDS, "linear-delta", "h4"))
def test_a_strut_that_cannot_close_is_named_with_file_and_line(name, tmp_path) -> None:
    """The geometry of the loaded file against the limits of the symbolic kinematics."""
    refusals, strut = 0, load_robot(name).limbs.strut
    for strut_now in np.round(np.array([0.1, 0.3, 0.6, 0.8, 1.3, 2.5, 6.0]) * strut, 3):
        text = re.sub(r"(?m)^  strut: .*", f"  strut: {strut_now}", catalogue_text(name))
        try:
            kinematics = Kinematics(parse(text, RobotDescription, where="robot.yaml"))
        except DescriptionError:  # not even the lengths alone can close
            continue
        mechanism = kinematics.mechanism
        reach = ca.Function("reach", [mechanism.z], [mechanism.reach])(kinematics.home)
        (tmp_path / "robot.yaml").write_text(text)
        if np.all(np.array(reach) > 0):
            load_robot(tmp_path / "robot.yaml")
            continue
        refusals += 1
        with pytest.raises(
            DescriptionError, match=r"robot\.yaml: line \d+, limbs\.strut: limb \d "
        ):
            load_robot(tmp_path / "robot.yaml")
    assert refusals


def test_a_strut_that_is_merged_in_has_the_line_of_the_merge(tmp_path) -> None:
    text = re.sub(r"(?m)^  strut: .*", "  <<: {strut: 0.3}", catalogue_text("clavel-delta3"))
    (tmp_path / "robot.yaml").write_text(text)
    line = text.splitlines().index("  <<: {strut: 0.3}") + 1
    with pytest.raises(DescriptionError, match=rf"line {line}, limbs\.strut: limb 1 cannot"):
        load_robot(tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    ("name", "old", "new", "fragment"),
    [
        ("par4", "strut: 0.825", "strut: 0.3", "limb 1 cannot reach the pose"),
        ("linear-delta", "strut: 0.600", "strut: 0.2", "cannot reach the pose"),
        ("par4", "z: [-0.90, -0.70]", "z: [-1.9, -1.7]", "limb 1 cannot reach the pose"),
        ("i4", "direction_deg: 90", "direction_deg: 0", "passes through singular poses"),
        ("par4", "first: [1, 2]", "first: [1, 4]", "passes through singular poses"),
    ],
)
def test_robots_that_cannot_move_in_their_workspace(name, old, new, fragment) -> None:
    robot = parse(changed(name, old, new), RobotDescription, where="robot.yaml")
    with pytest.raises(KinematicsError) as caught:
        random_motion(Kinematics(robot), np.random.default_rng(0))
    assert fragment in str(caught.value)
    assert "check workspace" in str(caught.value)


def test_forward_kinematics_needs_a_regular_middle_of_the_workspace() -> None:
    for name, old, new, fragment in (
        ("i4", "direction_deg: 90", "direction_deg: 0", "is singular"),
        ("par4", "z: [-0.90, -0.70]", "z: [-1.9, -1.7]", "is out of reach"),
    ):
        text = changed(name, old, new)
        kinematics = Kinematics(parse(text, RobotDescription, where="robot.yaml"))
        with pytest.raises(KinematicsError, match=rf"^workspace: the middle .* {fragment}"):
            kinematics.forward(np.full((2, 4), 0.3))
