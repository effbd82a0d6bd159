"""The URDF export, loaded by Pinocchio, with the loops of the file beside it."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from command import accepted, refused
from composed import Make
from deltaid.errors import DeltaidError
from deltaid.exports.files import export
from deltaid.exports.urdf import urdf
from deltaid.model.model import Model
from deltaid.sensors.weighings import roll_pitch_yaw
from exports import (
    COMPOSED,
    TOOLS,
    at_home,
    composed,
    configuration,
    model,
    states,
    subject,
    the,
    title,
    tree_motion,
    with_friction,
)
from sessions import ROOT, blocks
from support import KINDS, assert_close
from sweeps import swept

CASES = swept([*KINDS, *TOOLS, *COMPOSED], "clavel-delta3", "h4/first", "i4-linear", COMPOSED[0])


class Tree:
    """Pinocchio on an exported model, with what the file of the loops adds.

    Without the joints of what is only drawn and, unless they are to stay, without placeholders.
    """

    def __init__(self, chosen: Model, *, placeholders: bool = False) -> None:
        export = urdf(chosen)
        whole = pin.buildModelFromXML(export.text(".urdf"))
        self.loops = json.loads(export.text(".loops.json"))
        drawn = [whole.getJointId(name) for name in self.loops["drawn_joints"]]
        self.model = pin.buildReducedModel(whole, drawn, pin.neutral(whole))
        for link in () if placeholders else self.loops["placeholder_links"]:
            joint = self.model.frames[self.model.getFrameId(link)].parentJoint
            self.model.inertias[joint] = pin.Inertia.Zero()
        self.model.gravity.linear = np.array(self.loops["gravity"])
        self.data = self.model.createData()
        joints = zip(self.model.joints, self.model.names, strict=True)
        index = {joint.idx_v: name for joint, name in list(joints)[1:]}
        self.order = [index[k] for k in range(len(index))]

    def configuration(self, x: np.ndarray) -> np.ndarray:
        return configuration(self.model, dict(zip(self.order, x, strict=True)))

    @property
    def armature(self) -> np.ndarray:
        """Of the file of the loops, by joint."""
        return np.array([self.loops["armature"].get(name, 0.0) for name in self.order])


@pytest.mark.parametrize("case", CASES, ids=title)
def test_torques_projected_and_loops_closed(case: str | Make) -> None:
    chosen = the(case)
    tree = Tree(chosen)
    z, _, qd, qdd = states(chosen, 4)
    tau = model(chosen, z, qd, qdd).tau
    springs = {name: (s["stiffness"], s["rest"]) for name, s in tree.loops["springs"].items()}
    for i in range(len(z)):
        motion = tree_motion(chosen, tree.order, (z[i], qd[i], qdd[i]))
        q = tree.configuration(motion.x)
        forces = pin.rnea(tree.model, tree.data, q, motion.v, motion.a)
        forces = forces + tree.model.damping * motion.v + tree.armature * motion.a
        forces += tree.model.friction * np.sign(motion.v)
        for name, (stiffness, rest) in springs.items():
            k = tree.order.index(name)
            forces[k] += stiffness * (motion.x[k] - rest)
        assert_close(motion.partial.T @ forces, tau[i], 1e-9)
        pin.framesForwardKinematics(tree.model, tree.data, q)
        for pair in tree.loops["coincident_frames"]:
            first, second = (
                tree.data.oMf[tree.model.getFrameId(name)].translation for name in pair["frames"]
            )
            np.testing.assert_allclose(first, second, rtol=0, atol=1e-13)
        place = {name: motion.x[k] for k, name in enumerate(tree.order)}
        for pair in tree.loops["following_joints"]:
            followed = pair["ratio"] * place[pair["follows"]]
            assert place[pair["joint"]] == pytest.approx(followed, abs=1e-13)


@pytest.mark.parametrize("name", ["clavel-delta3", "linear-delta"])
def test_example_of_the_documentation_accelerates_as_the_package(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pinocchio's constrained dynamics with the loops, of robots in which no joint follows."""
    chosen = subject(name).without_friction()
    export(chosen, "urdf", tmp_path / "irb360.urdf")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    [example] = [text for _, text in blocks(page, "python") if "pinocchio" in text]
    scope = {}
    exec(example, scope)
    assert scope["loops"]["following_joints"] == []
    found = at_home(chosen)
    want = np.linalg.solve(found.M[0], -found.g[0])  # it falls
    tree = scope["model"]
    places = [tree.joints[tree.getJointId(drive)].idx_v for drive in chosen.robot.drives]
    assert_close(scope["acceleration"][places], want, 1e-5)


@pytest.mark.parametrize("name", ["irb360-6-1600", "par4", "i4-linear"])
def test_bodies_and_home(name: str) -> None:
    chosen = subject(name)
    tree = Tree(chosen)
    home = tree.loops["home"]
    q = chosen.dynamics.kinematics.inverse(chosen.home[None])[0]
    assert [home[drive] for drive in tree.loops["drives"]] == pytest.approx(q)
    q = tree.configuration(np.array([home[name] for name in tree.order]))
    pin.framesForwardKinematics(tree.model, tree.data, q)
    poses = chosen.dynamics.kinematics.poses(chosen.home[None])
    strut, tool = poses[1], next(pose for pose in poses if pose.name == "EE")
    for link, pose in (("S1", strut), ("EE", tool)):
        frame = tree.data.oMf[tree.model.getFrameId(link)]
        np.testing.assert_allclose(frame.rotation, pose.R_WB[0], rtol=0, atol=1e-13)
        np.testing.assert_allclose(frame.translation, pose.r_WB[0], rtol=0, atol=1e-13)
    for inertia in list(tree.model.inertias)[1:]:
        if inertia.mass > 0:
            a, b, c = np.linalg.eigvalsh(inertia.inertia)
            assert a > 0
            assert c < a + b
    for drive, limits in chosen.robot.drive_limits.items():
        joint = tree.model.joints[tree.model.getJointId(drive)]
        assert tree.model.effortLimit[joint.idx_v] == limits.effort
        if limits.range:
            low, high = tree.model.lowerPositionLimit, tree.model.upperPositionLimit
            assert (low[joint.idx_q], high[joint.idx_q]) == pytest.approx(limits.range)


def test_roll_pitch_yaw() -> None:
    rng = np.random.default_rng(0)
    for rpy in [*rng.uniform(-1.5, 1.5, (20, 3)), (0.3, np.pi / 2, 0.4), (0.3, -np.pi / 2, -2.0)]:
        R = pin.rpy.rpyToMatrix(*map(float, rpy))
        np.testing.assert_allclose(pin.rpy.rpyToMatrix(*roll_pitch_yaw(R)), R, atol=1e-15)


def test_what_urdf_has_no_words_for_is_reported() -> None:
    assert urdf(subject("clavel-delta3")).warnings == ()
    armature, springs = urdf(composed(COMPOSED[0])).warnings
    assert "motors and gears of drive1, drive2, drive3, drive4 are not in the URDF" in armature
    assert "springs of drive1" in springs


def test_friction_that_urdf_lacks_is_refused(tmp_path: Path) -> None:
    chosen = with_friction("drive1", viscous_back=1.0, coulomb_back=2.0)
    with pytest.raises(DeltaidError, match=r"URDF has viscous.*viscous_back\.drive1"):
        urdf(chosen)
    export(chosen.without_friction(), "urdf", tmp_path / "bare.urdf")
    assert "dynamics" not in (tmp_path / "bare.urdf").read_text()


def test_command_writes_both_files_or_none(tmp_path: Path) -> None:
    outcome = accepted(
        "export", "irb360-6-1600", "--to", "urdf", "-o", tmp_path / "a.urdf", width=400
    )
    assert "inertia of motors and gears of drive4 are not in the URDF" in outcome.err
    assert {path.name for path in tmp_path.iterdir()} == {"a.urdf", "a.loops.json"}
    pin.buildModelFromUrdf(str(tmp_path / "a.urdf"))
    (tmp_path / "b.loops.json").mkdir()
    refusal = refused("export", "irb360-6-1600", "--to", "urdf", "-o", tmp_path / "b.urdf",
                   folder=tmp_path)  # fmt: skip
    assert "b.loops.json" in refusal
