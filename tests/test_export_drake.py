"""The MJCF export in Drake, where it is installed (`pip install drake`): loops hold, same path."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from deltaid.control.simulation import integrate
from deltaid.export.mjcf import mjcf
from deltaid.export.spanning_tree import spanning_tree
from exports import subject

pytest.importorskip("pydrake.multibody.parsing", reason="Drake is not installed")
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

_STEP, _END = 1e-4, 0.15


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "linear-delta", "par4"])
def test_the_same_path_with_loops_closed(name: str) -> None:
    """Constant torques from home; joints that follow others are added by hand, as documented."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    chosen = subject(name).without_friction()
    tree, forward, dof = spanning_tree(chosen), chosen.forward, chosen.dynamics.dof
    plant = MultibodyPlant(_STEP)
    Parser(plant).AddModelsFromString(mjcf(chosen), "xml")
    for coupling in tree.couplings:
        joints = (plant.GetJointByName(n) for n in (coupling.joint, coupling.follows))
        plant.AddCouplerConstraint(*joints, coupling.ratio)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    bodies = chosen.dynamics.kinematics.mechanism.bodies
    mass = sum(body.count * chosen.body(body.name)[0] for body in bodies)
    assert plant.CalcTotalMass(context) == pytest.approx(mass, rel=1e-12)
    drives = [plant.GetJointByName(drive) for drive in chosen.robot.drives]
    limits = [plant.GetJointActuatorByName(drive.name()).effort_limit() for drive in drives]
    home = forward.drive_coordinates(chosen.home[None])[0]
    still = np.zeros((1, dof))
    tau = chosen.dynamics.inverse_dynamics(home[None], still, still, chosen.p)[0]
    tau = tau + 0.05 * np.array(limits) * np.array([1.0, -0.5, 0.3, 0.6])[:dof]
    plant.get_actuation_input_port().FixValue(context, tau)
    Simulator(plant, context).AdvanceTo(_END)
    found = np.array([drive.GetOnePosition(context) for drive in drives])
    start = forward.task_velocity(chosen.home[None], still)
    times = np.array([0.0, _END])
    path = integrate(forward, chosen.p, chosen.home[None], start, times, lambda *_: tau[None])
    want = forward.drive_coordinates(path.z[-1])[0]
    assert np.abs(want - home).max() > 0.03
    assert np.abs(found - want).max() < 2e-3 * np.abs(want - home).max()
    for cut in tree.cuts:
        ends = [
            plant.GetBodyByName(end.body).body_frame().CalcPoseInWorld(context) @ end.position
            for end in (cut.first, cut.second)
        ]
        np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-6)
