"""MJCF and URDF in Drake, where it has a wheel: loops hold, same path."""

import json
import logging
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltaid.control.simulation import integrate
from deltaid.exports.files import export
from deltaid.exports.mjcf import mjcf
from deltaid.exports.tree import spanning_tree
from deltaid.exports.urdf import urdf
from deltaid.model.model import Model
from exports import subject, total_mass
from sessions import ROOT
from sweeps import swept

pytest.importorskip("pydrake.multibody.parsing", reason="Drake is not installed")
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

_STEP, _END = 1e-4, 0.15


@pytest.fixture(autouse=True)
def _quiet() -> None:
    logging.getLogger("drake").setLevel(logging.ERROR)


def torques(chosen: Model) -> np.ndarray:
    """What holds the robot at home, and a push."""
    home = chosen.dynamics.kinematics.inverse(chosen.home)
    efforts = np.array([chosen.robot.drive_limits[drive].effort for drive in chosen.robot.drives])
    push = 0.05 * efforts * np.array([1.0, -0.5, 0.3, 0.6])[: len(home)]
    return push + chosen.dynamics.inverse_dynamics(home, 0 * home, 0 * home, chosen.p)


def same_path(plant: Any, context: Any, chosen: Model) -> None:
    """The package's forward dynamics beside Drake's steps."""
    forward, tau = chosen.forward, torques(chosen)
    Simulator(plant, context).AdvanceTo(_END)
    joints = [plant.GetJointByName(drive) for drive in chosen.robot.drives]
    found = np.array([joint.GetOnePosition(context) for joint in joints])
    start, times = np.zeros((1, len(tau))), np.array([0.0, _END])
    path = integrate(forward, chosen.p, chosen.home[None], start, times, lambda *_: tau[None])
    home, want = forward.drive_coordinates(np.array([chosen.home, path.z[-1].ravel()]))
    assert np.abs(want - home).max() > 0.03
    assert np.abs(found - want).max() < 1e-3 * np.abs(want - home).max()


@pytest.mark.parametrize(
    "name", swept(["clavel-delta3", "irb360-6-1600", "linear-delta", "par4"], "clavel-delta3")
)
def test_mjcf(name: str) -> None:
    """Its loops hold as loaded; joints that follow others are added by hand, as documented."""
    chosen = subject(name).without_friction()
    tree, plant = spanning_tree(chosen), MultibodyPlant(_STEP)
    Parser(plant).AddModelsFromString(mjcf(chosen), "xml")
    for coupling in tree.couplings:
        joints = (plant.GetJointByName(n) for n in (coupling.joint, coupling.follows))
        plant.AddCouplerConstraint(*joints, coupling.ratio)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.CalcTotalMass(context) == pytest.approx(total_mass(chosen), rel=1e-12)
    plant.get_actuation_input_port().FixValue(context, torques(chosen))
    same_path(plant, context, chosen)
    for cut in tree.cuts:
        ends = [
            plant.GetBodyByName(end.body).body_frame().CalcPoseInWorld(context) @ end.position
            for end in (cut.first, cut.second)
        ]
        np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", swept(["irb360-6-1600", "i4-linear"], "irb360-6-1600"))
def test_urdf(name: str) -> None:
    """Motors, limits and joints that follow are read; loops are closed by the file beside it."""
    chosen = subject(name).without_friction()
    export, plant = urdf(chosen), MultibodyPlant(_STEP)
    loops = json.loads(export.text(".loops.json"))
    Parser(plant).AddModelsFromString(export.text(".urdf"), "urdf")
    assert plant.num_constraints() == len(loops["following_joints"]) + len(loops["drawn_joints"])
    for pair in loops["coincident_frames"]:
        a, b = (plant.GetFrameByName(frame) for frame in pair["frames"])
        p, r = (frame.GetFixedPoseInBodyFrame().translation() for frame in (a, b))
        plant.AddBallConstraint(a.body(), p, b.body(), r)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    for joint, x in loops["home"].items():
        q[plant.GetJointByName(joint).position_start()] = x
    for joint in loops["drawn_joints"]:
        tilt = loops["home"][f"limb{joint[len('strut')]}_tilt"]
        q[plant.GetJointByName(joint).position_start()] = tilt
    plant.SetPositions(context, q)
    motors = {d: plant.GetJointActuatorByName(f"{d}_motor") for d in chosen.robot.drives}
    inputs = np.zeros(plant.num_actuators())
    for tau, (drive, motor) in zip(torques(chosen), motors.items(), strict=True):
        assert motor.effort_limit() == chosen.robot.drive_limits[drive].effort
        assert motor.default_rotor_inertia() == chosen.value(f"rotor.{drive}")
        inputs[motor.input_start()] = tau
    plant.get_actuation_input_port().FixValue(context, inputs)
    same_path(plant, context, chosen)


@pytest.mark.slow
def test_the_example_holds_the_loops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    export(subject("par4").without_friction(), "urdf", tmp_path / "robot.urdf")
    monkeypatch.chdir(tmp_path)
    scope = runpy.run_path(str(ROOT / "examples" / "in_drake.py"))
    assert "drive4" in capsys.readouterr().out
    plant, context = scope["plant"], scope["context"]
    for pair in scope["loops"]["coincident_frames"]:
        a, b = (plant.GetFrameByName(n).CalcPoseInWorld(context) for n in pair["frames"])
        np.testing.assert_allclose(a.translation(), b.translation(), rtol=0, atol=1e-4)
