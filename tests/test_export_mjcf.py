"""The MJCF export, loaded and stepped in MuJoCo, against the package."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import deltaid
from composed import Make
from deltaid.errors import DeltaidError
from deltaid.exports.files import export
from deltaid.exports.mjcf import mjcf
from deltaid.exports.plain_friction import plain_friction
from deltaid.exports.tree import spanning_tree
from deltaid.model.model import Model
from deltaid.robot.friction import Stribeck
from deltaid.robot.sensors import BaseWrench
from deltaid.sensors.robot_sensors import sensor_rows
from exports import (
    COMPOSED,
    TOOLS,
    TreeMotion,
    at_home,
    composed,
    dry_friction,
    model,
    states,
    subject,
    the,
    title,
    total_mass,
    tree_motion,
    with_friction,
)
from sensor_rows import dense
from support import KINDS, along, assert_close
from sweeps import swept

CASES = swept([*KINDS, *TOOLS, *COMPOSED], "clavel-delta3", "h4/first", "i4-linear", COMPOSED[0])


class Simulation:
    """MuJoCo on an exported model."""

    def __init__(self, chosen: Model) -> None:
        self.model = mujoco.MjModel.from_xml_string(mjcf(chosen))
        self.data = mujoco.MjData(self.model)
        self.joints = [self.model.joint(j).name for j in range(self.model.njnt)]
        self.drives = [self.joints.index(drive) for drive in chosen.robot.drives]

    def set(self, motion: TreeMotion) -> None:
        self.data.qpos, self.data.qvel = motion.x, motion.v
        mujoco.mj_forward(self.model, self.data)

    def stiffen(self, impedance: float) -> None:
        self.model.eq_solimp[:, :2] = impedance

    def accelerations(self, tau: np.ndarray) -> np.ndarray:
        """Of the drives, with their torques, at the state that is set."""
        self.data.qfrc_applied[self.drives] = tau
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc[self.drives].copy()


@pytest.mark.parametrize("case", CASES, ids=title)
def test_poses_masses_and_closed_loops(case: str | Make) -> None:
    chosen = the(case)
    simulation = Simulation(chosen)
    data, kinematics = simulation.data, chosen.dynamics.kinematics
    mujoco.mj_forward(simulation.model, data)  # the model's own pose is the home pose
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-14
    assert (simulation.model.key("home").qpos == simulation.model.qpos0).all()
    home = kinematics.inverse(chosen.home[None])[0]
    assert simulation.model.qpos0[simulation.drives] == pytest.approx(home)
    for z, _, qd, qdd in zip(*states(chosen, 3), strict=True):
        simulation.set(tree_motion(chosen, simulation.joints, (z, qd, qdd)))
        assert np.abs(data.efc_pos[: data.ne]).max() < 1e-14
        assert np.abs(data.efc_vel[: data.ne]).max() < 1e-12
        for name, pose in placed(chosen, z):
            body = data.body(name)
            assert_close(body.xmat.reshape(3, 3), pose.R_WB[0], 1e-12)
            np.testing.assert_allclose(body.xpos, pose.r_WB[0], rtol=0, atol=1e-12)
    assert simulation.model.body_mass.sum() == pytest.approx(total_mass(chosen), rel=1e-14)
    heavy = simulation.model.body_mass > 0
    massless = {simulation.model.body(i).name for i in np.flatnonzero(~heavy)}
    assert all(name in ("world", "base") or name.endswith("_mount") for name in massless)
    moments = np.sort(simulation.model.body_inertia[heavy], axis=1)
    assert (moments[:, 0] > 0).all()
    assert (moments[:, 0] + moments[:, 1] > moments[:, 2]).all()


@pytest.mark.parametrize("case", TOOLS)
def test_the_weight_on_the_base_acts_at_the_centre_of_mass(case: str) -> None:
    chosen = subject(case)
    simulation, robot = Simulation(chosen), chosen.robot
    mujoco.mj_forward(simulation.model, simulation.data)
    weight = total_mass(chosen) * np.array(robot.gravity)
    plate = BaseWrench(kind="base-wrench", force_bias=0, moment_bias=0)
    still = np.zeros((1, chosen.dynamics.dof))
    rows = dense(sensor_rows(chosen.dynamics, "s", plate), (chosen.home[None], still, still))
    force, moment = (rows[0] @ np.pad(chosen.p, (0, rows.shape[2] - len(chosen.p)))).reshape(2, 3)
    assert_close(-force, weight, 1e-12)
    assert_close(-moment, np.cross(simulation.data.subtree_com[0], weight), 1e-12)


def placed(chosen: Model, z: np.ndarray) -> list:
    """The package's pose of every body of the tree, by its name there."""
    poses = list(chosen.dynamics.kinematics.poses(z[None]))
    limbs = len(chosen.robot.limb_geometry)
    names = [f"{poses[2 * i + k].name[0]}{i + 1}" for i in range(limbs) for k in (0, 1)]
    rest = [pose.name for pose in poses[2 * limbs :]]
    for part in ("SB", "MP", "HP"):
        if part in rest:
            rest = [f"{part}1", f"{part}2", *rest[2:]]
    return list(zip([*names, *rest], poses, strict=True))


@pytest.mark.parametrize("case", CASES, ids=title)
def test_inverse_dynamics_of_the_tree_projected(case: str | Make) -> None:
    chosen = the(case)
    simulation = Simulation(chosen)
    m, d = simulation.model, simulation.data
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    z, _, qd, qdd = states(chosen, 4)
    tau = model(chosen, z, qd, qdd).tau
    for i in range(len(z)):
        motion = tree_motion(chosen, simulation.joints, (z[i], qd[i], qdd[i]))
        d.qpos, d.qvel, d.qacc = motion.x, motion.v, motion.a
        mujoco.mj_inverse(m, d)
        forces = d.qfrc_inverse + m.dof_frictionloss * np.sign(motion.v)
        assert_close(motion.partial.T @ forces, tau[i], 1e-9)


@pytest.mark.parametrize("case", CASES, ids=title)
def test_accelerations_within_the_softness_of_constraints(case: str | Make) -> None:
    """What is left of the difference shrinks with the share that the constraints give way."""
    chosen = the(case).without_friction()
    simulation = Simulation(chosen)
    simulation.model.jnt_limited[:] = False
    z, _, qd, qdd = states(chosen, 4)
    expected = model(chosen, z, qd, qdd)
    gaps = []
    for impedance in (0.99, 0.999, 0.9999):
        simulation.stiffen(impedance)
        gap = []
        for i in range(len(z)):
            simulation.set(tree_motion(chosen, simulation.joints, (z[i], qd[i], qdd[i])))
            got = simulation.accelerations(expected.tau[i])
            want = expected.acceleration[i]
            gap.append(np.abs(got - want).max() / np.abs(want).max())
        gaps.append(np.array(gap))
    assert (gaps[1] < 0.13 * gaps[0]).all()
    assert (gaps[2] < 0.13 * gaps[1]).all()
    assert gaps[2].max() < (0.005 if case in KINDS else 0.1)


@pytest.mark.parametrize("name", swept([*KINDS, *TOOLS], "irb360-6-1600", "h4/first"))
def test_loops_stay_closed_as_exported(name: str) -> None:
    """A second of strong torques with the file's own step, constraints and friction."""
    chosen = subject(name)
    simulation = Simulation(chosen)
    data, gravity = simulation.data, at_home(chosen).g[0]
    effort = simulation.model.actuator_forcerange[:, 1]
    gap = moved = 0.0
    for _ in range(1000):
        wave = np.sin(2 * np.pi * 3 * data.time + np.arange(len(effort)))
        data.ctrl[:] = gravity + 0.15 * effort * wave
        mujoco.mj_step(simulation.model, data)
        gap = max(gap, np.abs(data.efc_pos[: data.ne]).max())
        moved = max(moved, np.abs(data.qpos - simulation.model.qpos0).max())
    assert moved > 0.1
    assert gap < 1e-4  # m, rad
    assert sum(warning.number for warning in data.warning) == 0


def test_friction_holds_the_robot_still_and_opposes_motion() -> None:
    chosen = subject("linear-delta")
    simulation = Simulation(chosen)
    q, gravity, loss = simulation.drives, at_home(chosen).g[0], dry_friction(chosen)
    assert simulation.model.dof_frictionloss[q] == pytest.approx(loss)
    viscous = [chosen.value(f"viscous.drive{i}") for i in (1, 2, 3)]
    assert simulation.model.dof_damping[q] == pytest.approx(viscous)
    for share, limit in ((0.5, 1e-4), (2.0, None)):
        mujoco.mj_resetDataKeyframe(simulation.model, simulation.data, 0)
        simulation.data.ctrl[:] = gravity + share * loss
        for _ in range(100):
            mujoco.mj_step(simulation.model, simulation.data)
        moved = np.abs(simulation.data.qpos[q] - simulation.model.qpos0[q]).max()
        assert moved < limit if limit else moved > 1e-3


def test_motors_act_at_the_joint_within_their_limits() -> None:
    chosen = subject("irb360-6-1600")
    simulation = Simulation(chosen)
    m, d = simulation.model, simulation.data
    efforts = [chosen.robot.drive_limits[drive].effort for drive in chosen.robot.drives]
    assert [m.actuator(i).name for i in range(m.nu)] == list(chosen.robot.drives)
    d.ctrl[:] = 1e6
    mujoco.mj_forward(m, d)
    assert d.qfrc_actuator[simulation.drives] == pytest.approx(efforts)
    assert np.count_nonzero(d.qfrc_actuator) == len(efforts)
    assert m.dof_armature[simulation.drives[3]] == chosen.value("rotor.drive4")
    for drive, limits in chosen.robot.drive_limits.items():
        assert m.joint(drive).range == pytest.approx(limits.range or (0, 0))


def test_springs_and_gravity_are_in_the_file() -> None:
    chosen = composed(COMPOSED[0])
    m = Simulation(chosen).model
    for joint in chosen.robot.joints:
        k = m.joint(joint).id
        assert m.jnt_stiffness[k] == pytest.approx(chosen.value(f"spring.{joint}"))
        assert m.qpos_spring[k] == pytest.approx(chosen.robot.spring_rest(joint))
    assert m.opt.gravity == pytest.approx(chosen.robot.gravity)


def test_friction_that_mujoco_lacks_is_refused_or_excluded() -> None:
    chosen = with_friction("drive2", load=0.1)
    with pytest.raises(DeltaidError, match=r"viscous and Coulomb friction only.*load\.drive2"):
        mjcf(chosen)
    bare = Simulation(chosen.without_friction()).model
    assert not bare.dof_damping.any()
    assert not bare.dof_frictionloss.any()


def test_friction_that_mujoco_lacks_is_approximated_with_its_error(tmp_path: Path) -> None:
    """The law by hand, least squares by NumPy."""
    chosen = with_friction("drive2", stribeck=Stribeck(coefficient=3.0, speed=0.4))
    path = tmp_path / "robot.xml"
    warning, *more = export(chosen, "mjcf", path, plain_friction=True).warnings
    assert not more
    kinematics = chosen.dynamics.kinematics
    z, _, qd, qdd = along(kinematics, np.random.default_rng(0), 2000)
    v = qd[:, 1]
    columns = np.column_stack([v, np.sign(v)])
    own = [chosen["viscous.drive2"], chosen["coulomb.drive2"]]
    friction = columns @ own
    friction += chosen["stribeck.drive2"] * np.sign(v) * np.exp(-np.abs(v) / 0.4)
    best, *_ = np.linalg.lstsq(columns, friction)
    model = mujoco.MjModel.from_xml_path(str(path))
    k = model.joint("drive2").dofadr[0]
    assert_close([model.dof_damping[k], model.dof_frictionloss[k]], best, 1e-6)
    other = model.joint("drive1").dofadr[0]
    assert model.dof_frictionloss[other] == pytest.approx(chosen["coulomb.drive1"])
    error, tau = friction - columns @ best, chosen.dynamics.torque(z, qd, qdd)[:, 1]
    rms = np.sqrt(np.mean(error**2))
    share = rms / np.sqrt(np.mean(tau**2))
    said = f"drive2 is off by {rms:.2g} N m rms ({share:.2%} of its torque), "
    assert f"{said}at most {np.abs(error).max():.2g} N m" in warning
    plain = deltaid.load("clavel-delta3")
    assert plain_friction(plain)[0] is plain


@pytest.mark.parametrize("name", swept(KINDS, "irb360-6-1600", "h4"))
def test_tree_is_as_free_as_the_robot(name: str) -> None:
    """As many independent conditions as coordinates beyond the drives: none is redundant."""
    tree, simulation = spanning_tree(subject(name)), Simulation(subject(name))
    mujoco.mj_forward(simulation.model, simulation.data)
    rows = simulation.data.ne
    assert rows == 3 * len(tree.cuts) + len(tree.couplings)
    closure = np.zeros((rows, simulation.model.nv))
    for k, e in enumerate(np.eye(simulation.model.nv)):
        out = np.zeros(simulation.data.nefc)
        mujoco.mj_mulJacVec(simulation.model, simulation.data, out, e)
        closure[:, k] = out[:rows]
    assert np.linalg.matrix_rank(closure) == rows
    assert simulation.model.nv - rows == subject(name).dynamics.dof


@pytest.mark.parametrize("name", ["irb360-6-1600", "h4"])
def test_pinocchio_has_the_bodies_at_home(name: str, tmp_path: Path) -> None:
    """Not the loops, which docs/targets.md says."""
    chosen, path = subject(name), tmp_path / "robot.xml"
    path.write_text(mjcf(chosen))
    read = pin.buildModelFromMJCF(str(path))
    tree = read[0] if isinstance(read, tuple) else read  # with constraints in newer ones
    data = tree.createData()
    pin.framesForwardKinematics(tree, data, tree.referenceConfigurations["home"])
    poses = chosen.dynamics.kinematics.poses(chosen.home)
    found = [pose for pose in poses if tree.existFrame(pose.name)]
    assert "EE" in [pose.name for pose in found]
    for pose in found:
        frame = data.oMf[tree.getFrameId(pose.name)]
        np.testing.assert_allclose(frame.translation, pose.r_WB, rtol=0, atol=1e-12)
        np.testing.assert_allclose(frame.rotation, pose.R_WB, rtol=0, atol=1e-12)
    assert pin.computeTotalMass(tree) == pytest.approx(total_mass(chosen), rel=1e-12)
