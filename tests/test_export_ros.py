"""What ROS 2, Gazebo and Drake need of the URDF: base, inertia, drives, joints that follow."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from deltaid.exports.files import export
from deltaid.exports.tree import spanning_tree
from deltaid.exports.urdf import PLACEHOLDER, urdf
from exports import configuration, model, states, subject, total_mass, tree_motion
from support import assert_close
from sweeps import swept
from test_export_urdf import Tree

# Of urdfdom: on the machine, or of the wheel that Pinocchio's takes in.
CHECK = shutil.which("check_urdf") or shutil.which("check_urdf", path=Path(sys.executable).parent)
NAMES = swept(["irb360-6-1600", "linear-delta", "par4", "i4/second"], "irb360-6-1600", "i4/second")


def parsed(name: str) -> ElementTree.Element:
    return ElementTree.fromstring(urdf(subject(name)).text(".urdf"))


@pytest.mark.parametrize("name", NAMES)
def test_every_link_that_moves_has_inertia_on_a_fixed_base(name: str) -> None:
    chosen, root = subject(name), parsed(name)
    joints = root.findall("joint")
    children = {j.find("child").get("link"): j for j in joints}  # pyright: ignore
    links = {link.get("name"): link for link in root.findall("link")}
    assert set(links) - set(children) == {"world"}
    assert links["world"].find("inertial") is None  # the root of KDL's trees must have none
    assert children["base"].get("type") == "fixed"
    total = 0.0
    for link, joint in children.items():
        mass = links[link].find("inertial/mass")
        assert (mass is not None) or joint.get("type") == "fixed"
        total += float(mass.get("value", "")) if mass is not None else 0.0
    own = total_mass(chosen)
    placeholders = json.loads(urdf(chosen).text(".loops.json"))["placeholder_links"]
    assert total == pytest.approx(own + len(placeholders) * PLACEHOLDER[0], rel=1e-14)
    assert PLACEHOLDER[0] > 1e-6  # Gazebo drops lighter links, and what hangs on them
    assert total < own * (1 + 1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_placeholders_hardly_change_the_torque(name: str) -> None:
    chosen = subject(name).without_friction()
    tree = Tree(chosen, placeholders=True)
    z, _, qd, qdd = states(chosen, 3)
    tau = model(chosen, z, qd, qdd).tau
    for i in range(len(z)):
        motion = tree_motion(chosen, tree.order, (z[i], qd[i], qdd[i]))
        q = tree.configuration(motion.x)
        forces = pin.rnea(tree.model, tree.data, q, motion.v, motion.a) + tree.armature * motion.a
        assert_close(motion.partial.T @ forces, tau[i], 2e-5)


@pytest.mark.parametrize("name", NAMES)
def test_joints_that_mimic_do_so_exactly(name: str) -> None:
    """In the closed robot, and so that every drawn strut ends where it is held."""
    chosen, root = subject(name), parsed(name)
    kinematics, tree = chosen.dynamics.kinematics, spanning_tree(chosen)
    whole = pin.buildModelFromXML(urdf(chosen).text(".urdf"))
    data = whole.createData()
    z, *_ = states(chosen, 1)
    found = kinematics.joint_states(kinematics.inverse(z[0]))
    value = dict(zip(found.names, found.position, strict=True))
    mimics = {j.get("name"): m for j in root.findall("joint") if (m := j.find("mimic")) is not None}
    for joint, mimic in mimics.items():
        followed = float(mimic.get("multiplier", "")) * value[mimic.get("joint")]
        assert value.setdefault(joint, followed) == pytest.approx(followed, abs=1e-12)
    assert set(value) == set(whole.names[1:])
    pin.framesForwardKinematics(whole, data, configuration(whole, value))
    assert len(tree.struts) == 2 * len(chosen.robot.limb_geometry)
    for strut, limb in zip(tree.struts, np.repeat(chosen.robot.limb_geometry, 2), strict=True):
        upper, seat = (data.oMf[whole.getFrameId(n)] for n in (strut.name, strut.second.body))
        driven = data.oMf[whole.getFrameId(strut.first.body)]
        np.testing.assert_allclose(
            upper.translation, driven.act(strut.first.position), rtol=0, atol=1e-12
        )
        lower = upper.act(np.array([limb.strut, 0.0, 0.0]))
        np.testing.assert_allclose(lower, seat.act(strut.second.position), rtol=0, atol=1e-12)


def test_drives_have_interfaces_limits_and_transmissions() -> None:
    chosen, root = subject("irb360-6-1600"), parsed("irb360-6-1600")
    [system] = root.findall("ros2_control")
    assert system.find("hardware/plugin") is not None
    home = spanning_tree(chosen).home
    for drive in chosen.robot.drives:
        joint = system.find(f"joint[@name='{drive}']")
        assert [x.get("name") for x in joint.findall("command_interface")] == [
            "position", "velocity", "effort"
        ]  # fmt: skip
        limits = chosen.robot.drive_limits[drive]
        bounds = [float(x.text or "") for x in joint.findall("command_interface[3]/param")]
        assert bounds == pytest.approx([-limits.effort, limits.effort])
        bounds = [float(x.text or "") for x in joint.findall("command_interface[1]/param")]
        assert bounds == pytest.approx(limits.range or [])
        start = joint.find("state_interface[@name='position']/param[@name='initial_value']")
        assert float(start.text or "") == home[drive]
        assert system.find(f"transmission[@name='{drive}_transmission']/plugin") is not None
    slide = root.find("joint[@name='slide']/limit")
    assert slide is not None
    stroke = chosen.robot.telescope.stroke
    assert stroke is not None
    assert (float(slide.get("lower", "")), float(slide.get("upper", ""))) == stroke


@pytest.mark.skipif(CHECK is None, reason="check_urdf is not installed")
@pytest.mark.parametrize("name", [*NAMES, *swept(["h4"])])
def test_check_urdf_accepts_it(name: str, tmp_path: Path) -> None:
    export(subject(name), "urdf", tmp_path / "robot.urdf")
    done = subprocess.run([str(CHECK), tmp_path / "robot.urdf"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "root Link: world has 1 child" in done.stdout
