"""Coordinates of all joints of the tree: MuJoCo and Pinocchio close the loops with them."""

import json

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from composed import Make
from deltaid.errors import DeltaidError
from deltaid.exports.mjcf import mjcf
from deltaid.exports.urdf import urdf
from deltaid.mechanism.kinematics import Kinematics
from exports import COMPOSED, states, the, title
from support import example
from test_export_urdf import configuration

CASES = ("irb360-6-1600", "linear-delta", "par4", *COMPOSED[:2])


@pytest.mark.parametrize("case", CASES, ids=title)
def test_mujoco_closes_loops_with_positions_and_rates(case: str | Make) -> None:
    chosen = the(case)
    kinematics = chosen.dynamics.kinematics
    simulated = mujoco.MjModel.from_xml_string(mjcf(chosen))
    data = mujoco.MjData(simulated)
    z, q, qd, _ = states(chosen, 3)
    found = kinematics.joint_states(q, qd)
    assert found.names[: kinematics.dof] == chosen.robot.drives
    np.testing.assert_allclose(found.position[:, : kinematics.dof], q, atol=1e-12)
    np.testing.assert_allclose(found.velocity[:, : kinematics.dof], qd, atol=1e-12)
    places = [simulated.joint(name).id for name in found.names]
    assert sorted(places) == list(range(simulated.nq))
    for i in range(len(z)):
        data.qpos[places], data.qvel[places] = found.position[i], found.velocity[i]
        mujoco.mj_forward(simulated, data)
        assert np.abs(data.efc_pos[: data.ne]).max() < 1e-12
        assert np.abs(data.efc_vel[: data.ne]).max() < 1e-11
    assert kinematics.joint_states(q).velocity is None


@pytest.mark.parametrize("case", ["irb360-6-1600", "i4/second"])
def test_pinocchio_closes_loops(case: str) -> None:
    """With the names of the URDF; also joint by joint the passive ones alone, and one sample."""
    chosen = the(case)
    kinematics, export = chosen.dynamics.kinematics, urdf(chosen)
    tree = pin.buildModelFromXML(export.text(".urdf"))
    data, loops = tree.createData(), json.loads(export.text(".loops.json"))
    z, q, qd, _ = states(chosen, 1)
    found, passive = kinematics.joint_states(q[0]), kinematics.passive_joints(z[0], qd[0])
    assert found.position.shape == (len(found.names),)
    assert passive.velocity is not None
    assert passive.names == tuple(n for n in found.names if n not in chosen.robot.drives)
    value = dict(zip(found.names, found.position, strict=True))
    assert [value[name] for name in passive.names] == pytest.approx(passive.position, abs=1e-12)
    pin.framesForwardKinematics(tree, data, configuration(tree, value))
    for pair in loops["coincident_frames"]:
        a, b = (data.oMf[tree.getFrameId(name)].translation for name in pair["frames"])
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    tool = data.oMf[tree.getFrameId("EE")]
    pose = next(pose for pose in kinematics.poses(z[0]) if pose.name == "EE")
    np.testing.assert_allclose(tool.translation, pose.r_WB, rtol=0, atol=1e-12)


def test_rates_are_derivatives() -> None:
    kinematics = the("h4").dynamics.kinematics
    z, _, qd, _ = states(the("h4"), 1)
    zd = np.linalg.solve(kinematics.jacobian(z[0]), qd[0])
    ahead, behind = (kinematics.passive_joints(z[0] + h * zd).position for h in (1e-5, -1e-5))
    rates = kinematics.passive_joints(z[0], qd[0]).velocity
    assert rates == pytest.approx((ahead - behind) / 2e-5, abs=1e-7)


def test_joints_of_a_mechanism_of_ones_own_are_not_known() -> None:
    robot = example("heli4")
    with pytest.raises(DeltaidError, match="of which only poses are known and no joints"):
        Kinematics(robot).passive_joints(robot.home)
