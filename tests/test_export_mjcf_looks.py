"""What the MJCF export shows, and what its sensors say."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from composed import Make
from deltaid.exports.mjcf import mjcf
from deltaid.joint_forces.constraint_forces import ConstraintForces
from exports import COMPOSED, model, states, subject, the, title, tree_motion
from test_export_mjcf import Simulation


@pytest.mark.parametrize("name", ["irb360-6-1600", "linear-delta", "par4"])
def test_sensors_say_what_the_package_says(name: str) -> None:
    chosen = subject(name).without_friction()
    simulation, kinematics = Simulation(chosen), chosen.dynamics.kinematics
    data = simulation.data
    simulation.model.jnt_limited[:] = False
    z, q, qd, qdd = states(chosen, 2)
    forces, tau = ConstraintForces(chosen), model(chosen, z, qd, qdd).tau
    carried = forces.evaluate(z, qd, qdd, chosen.p)
    for i in range(len(z)):
        data.ctrl[:] = 0.1 * np.arange(len(q[i]))
        simulation.set(tree_motion(chosen, simulation.joints, (z[i], qd[i], qdd[i])))
        simulation.accelerations(tau[i] - data.ctrl)
        for k, drive in enumerate(chosen.robot.drives):
            found = [data.sensor(f"{drive}_{what}").data[0] for what in ("position", "velocity")]
            assert found == pytest.approx([q[i, k], qd[i, k]], abs=1e-12)
            assert data.sensor(f"{drive}_effort").data[0] == pytest.approx(data.ctrl[k])
        for k in range(len(chosen.robot.limb_geometry)):
            pair = [n for n in forces.names if n.startswith(f"strut{k + 1}")]
            along = [forces.index(n) for n in pair if n.endswith("elbow.x")]
            pull = data.sensor(f"strut{k + 1}_force").data[0]
            assert pull == pytest.approx(carried[i, along].sum(), rel=0.01, abs=0.05)
        tool = chosen.robot.load_carrier
        pose = next(pose for pose in kinematics.poses(z[i]) if pose.name == tool)
        assert data.sensor("tool_position").data == pytest.approx(pose.r_WB, abs=1e-12)


@pytest.mark.parametrize("case", ["irb360-6-1600", "h4-linear", *COMPOSED[1:]], ids=title)
def test_struts_are_drawn_from_joint_to_joint(case: str | Make) -> None:
    """Both of a pair have their length in every pose; nothing drawn pulls or touches."""
    chosen = the(case)
    simulation, limbs = Simulation(chosen), chosen.robot.limb_geometry
    m, data = simulation.model, simulation.data
    assert m.ntendon == sum(limb.struts for limb in limbs)
    assert not m.tendon_stiffness.any()
    assert not m.geom_contype.any()
    assert not m.geom_conaffinity.any()
    z, _, qd, qdd = states(chosen, 2)
    for i in range(len(z)):
        simulation.set(tree_motion(chosen, simulation.joints, (z[i], qd[i], qdd[i])))
        for k, limb in enumerate(limbs, 1):
            letters = ("a", "b") if limb.struts == 2 else ("",)
            lengths = [data.tendon(f"strut{k}{letter}").length[0] for letter in letters]
            assert lengths == pytest.approx([limb.strut] * limb.struts, abs=1e-12)
            ends = [data.site(f"strut{k}{letter}_seat").xpos for letter in letters]
            if limb.spacing is not None:
                assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(limb.spacing)


def test_pictures_show_the_robot() -> None:
    """Cameras look at it from near enough: all of it in view, arms and tool in the middle."""
    chosen = subject("irb360-6-1600")
    simulation = Simulation(chosen)
    m, data = simulation.model, simulation.data
    mujoco.mj_forward(m, data)
    for name in ("overview", "side", "top"):
        camera = data.camera(name)
        for geom in ("arm1", "arm2", "arm3", "base", "flange"):
            x, y, z = camera.xmat.reshape(3, 3).T @ (data.geom(geom).xpos - camera.xpos)
            assert z < 0  # it looks along its own -z
            assert np.hypot(x, y) < np.tan(np.deg2rad(20)) * -z


@pytest.mark.parametrize("case", ["irb360-6-1600", "i4/second", *COMPOSED], ids=title)
def test_bodies_of_several_joints_stand_in_their_parents_frame(case: str | Make) -> None:
    """Drake makes a body of each joint, and has all but the last in the parent's frame."""
    root = ElementTree.fromstring(mjcf(the(case)))
    several = [body for body in root.iter("body") if len(body.findall("joint")) > 1]
    assert several
    for body in several:
        moved = body.get("pos") is not None
        before_last = body.findall("joint")[:-1]
        assert not moved or all(joint.get("type") == "slide" for joint in before_last)
        assert np.fromstring(body.get("quat", "1 0 0 0"), sep=" ") == pytest.approx([1, 0, 0, 0])
    for body in root.iter("body"):
        massless = body.find("inertial") is None
        assert not massless or not body.findall("joint")


def test_nothing_level_is_too_bright_to_see() -> None:
    """From above, where the light beside the eye shines straight down, a white plate is not lost
    on a white floor: all light on what is level stays below one."""
    m = Simulation(subject("clavel-delta3")).model
    light = m.vis.headlight.ambient + m.vis.headlight.diffuse
    for way, diffuse in zip(m.light_dir, m.light_diffuse, strict=True):
        light = light + max(-way[2], 0.0) * diffuse
    assert (light > 0.7).all()
    plate = m.mat("base").rgba[:3] * light
    assert (plate < 1.0).all()
    assert len({tuple(m.mat(name).rgba) for name in ("base", "motor", "arm", "strut")}) == 4
