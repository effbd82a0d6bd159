"""A robot in Drake: its URDF, with the loops closed by the file beside it.

    deltaid export irb360-6-1600 --to urdf -o robot.urdf
    python in_drake.py

Drake reads motors, limits and joints that follow others from the URDF.
"""

import json
from pathlib import Path

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

plant = MultibodyPlant(time_step=1e-3)  # discrete: Drake has loops and joints that follow there
Parser(plant).AddModels("robot.urdf")
loops = json.loads(Path("robot.loops.json").read_text())
for pair in loops["coincident_frames"]:
    a, b = (plant.GetFrameByName(name) for name in pair["frames"])
    at_a, at_b = (frame.GetFixedPoseInBodyFrame().translation() for frame in (a, b))
    plant.AddBallConstraint(a.body(), at_a, b.body(), at_b)
plant.mutable_gravity_field().set_gravity_vector(loops["gravity"])
plant.Finalize()

simulator = Simulator(plant)
context = simulator.get_mutable_context()
q = plant.GetPositions(context)
home = loops["home"] | {
    joint: loops["home"][f"limb{joint[len('strut')]}_tilt"] for joint in loops["drawn_joints"]
}
for joint, x in home.items():
    q[plant.GetJointByName(joint).position_start()] = x
plant.SetPositions(context, q)

plant.get_actuation_input_port().FixValue(context, [0.0] * plant.num_actuators())  # N m or N
simulator.AdvanceTo(0.1)
for drive in loops["drives"]:
    print(drive, plant.GetJointByName(drive).GetOnePosition(context))
