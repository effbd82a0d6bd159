"""deltaid: physically consistent dynamic models of Delta-like robots, identified from recordings.

    robot = deltaid.load_robot("irb360-6-1600")         # or your own YAML file
    result = deltaid.identify(robot, ["log.csv"])
    result.model.save("model.yaml")

    dynamics = deltaid.Dynamics(robot)
    tau = dynamics.inverse_dynamics(q, qd, qdd, result.model.p)

Names are imported when first used, so that `import deltaid` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from deltaid import forked as forked  # it sees to forks from now on

if TYPE_CHECKING:
    from deltaid.calibration.calibrate import Calibration, calibrate
    from deltaid.calibration.next_readings import next_readings
    from deltaid.calibration.readings import Measurements
    from deltaid.checks.check import check
    from deltaid.checks.identify import identify
    from deltaid.checks.verdicts import Verdicts
    from deltaid.control.options import ControlSettings
    from deltaid.control.simulate import Comparison, Simulation, compare_controllers, simulate
    from deltaid.control.simulation import integrate, step_through
    from deltaid.dynamics.dynamics import Dynamics
    from deltaid.dynamics.forward_dynamics import ForwardDynamics
    from deltaid.dynamics.parameters import prior_parameters
    from deltaid.errors import DeltaidError
    from deltaid.exports.files import export
    from deltaid.exports.jax_functions import JaxFunctions, jax_functions
    from deltaid.fleets.run import FleetRun, fleet
    from deltaid.identification.feed_forward import FeedForward, torque
    from deltaid.identification.generic_motion import base
    from deltaid.identification.identify import Identification
    from deltaid.identification.prediction import Validation, validate
    from deltaid.joint_forces.constraint_forces import ConstraintForces
    from deltaid.joint_forces.forces import Forces, forces
    from deltaid.mechanism.kinematics import Kinematics
    from deltaid.mechanism.limb import build_limb
    from deltaid.mechanism.own import BodyPose, MechanismParts
    from deltaid.mechanism.user_code import use_mechanism
    from deltaid.model.model import Model, load
    from deltaid.model.record import IdentifiedModel, Settings
    from deltaid.model.samples import Samples
    from deltaid.model.verdict import Grade, Proposal, Verdict
    from deltaid.motion.excitation.excite import Excitation, ExcitationSettings, Exciter, excite
    from deltaid.motion.fourier import FourierMotion
    from deltaid.motion.random_motion import random_motion
    from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
    from deltaid.online.online import Online, OnlineEstimate
    from deltaid.online.settings import OnlineSettings
    from deltaid.recording.carried import Load
    from deltaid.recording.contents import columns
    from deltaid.recording.mapping import ColumnMapping, load_mapping
    from deltaid.recording.mapping_proposal import MappingProposal
    from deltaid.recording.memory import Recording
    from deltaid.robot.description import RobotDescription
    from deltaid.robot.limbs import LimbGeometry, Limbs
    from deltaid.robot.load import catalogue, load_robot
    from deltaid.sensors.planning.offers import Offers, load_offers
    from deltaid.sensors.planning.plan import SensorPlan, sensor_plan
    from deltaid.sensors.planning.settings import PlanSettings

    __version__: str

_HOME = {
    "Calibration": "deltaid.calibration.calibrate",
    "calibrate": "deltaid.calibration.calibrate",
    "Measurements": "deltaid.calibration.readings",
    "BodyPose": "deltaid.mechanism.own",
    "ColumnMapping": "deltaid.recording.mapping",
    "ControlSettings": "deltaid.control.options",
    "ConstraintForces": "deltaid.joint_forces.constraint_forces",
    "DeltaidError": "deltaid.errors",
    "Dynamics": "deltaid.dynamics.dynamics",
    "Excitation": "deltaid.motion.excitation.excite",
    "ExcitationSettings": "deltaid.motion.excitation.excite",
    "Exciter": "deltaid.motion.excitation.excite",
    "ForwardDynamics": "deltaid.dynamics.forward_dynamics",
    "Grade": "deltaid.model.verdict",
    "Identification": "deltaid.identification.identify",
    "IdentifiedModel": "deltaid.model.record",
    "Load": "deltaid.recording.carried",
    "Model": "deltaid.model.model",
    "JaxFunctions": "deltaid.exports.jax_functions",
    "Kinematics": "deltaid.mechanism.kinematics",
    "LimbGeometry": "deltaid.robot.limbs",
    "Limbs": "deltaid.robot.limbs",
    "MechanismParts": "deltaid.mechanism.own",
    "Proposal": "deltaid.model.verdict",
    "Recording": "deltaid.recording.memory",
    "Offers": "deltaid.sensors.planning.offers",
    "Online": "deltaid.online.online",
    "OnlineEstimate": "deltaid.online.online",
    "OnlineSettings": "deltaid.online.settings",
    "PlanSettings": "deltaid.sensors.planning.settings",
    "SensorPlan": "deltaid.sensors.planning.plan",
    "RobotDescription": "deltaid.robot.description",
    "Samples": "deltaid.model.samples",
    "Settings": "deltaid.model.record",
    "Validation": "deltaid.identification.prediction",
    "Verdict": "deltaid.model.verdict",
    "Verdicts": "deltaid.checks.verdicts",
    "build_limb": "deltaid.mechanism.limb",
    "catalogue": "deltaid.robot.load",
    "check": "deltaid.checks.check",
    "MappingProposal": "deltaid.recording.mapping_proposal",
    "columns": "deltaid.recording.contents",
    "compare_controllers": "deltaid.control.simulate",
    "simulate": "deltaid.control.simulate",
    "Simulation": "deltaid.control.simulate",
    "Comparison": "deltaid.control.simulate",
    "excite": "deltaid.motion.excitation.excite",
    "export": "deltaid.exports.files",
    "forces": "deltaid.joint_forces.forces",
    "FeedForward": "deltaid.identification.feed_forward",
    "Forces": "deltaid.joint_forces.forces",
    "SensorNoise": "deltaid.motion.surrogate",
    "FleetRun": "deltaid.fleets.run",
    "fleet": "deltaid.fleets.run",
    "FourierMotion": "deltaid.motion.fourier",
    "base": "deltaid.identification.generic_motion",
    "random_motion": "deltaid.motion.random_motion",
    "simulate_recording": "deltaid.motion.surrogate",
    "surrogate_parameters": "deltaid.motion.surrogate",
    "identify": "deltaid.checks.identify",
    "integrate": "deltaid.control.simulation",
    "jax_functions": "deltaid.exports.jax_functions",
    "load": "deltaid.model.model",
    "load_offers": "deltaid.sensors.planning.offers",
    "load_mapping": "deltaid.recording.mapping",
    "load_robot": "deltaid.robot.load",
    "next_readings": "deltaid.calibration.next_readings",
    "prior_parameters": "deltaid.dynamics.parameters",
    "sensor_plan": "deltaid.sensors.planning.plan",
    "step_through": "deltaid.control.simulation",
    "use_mechanism": "deltaid.mechanism.user_code",
    "torque": "deltaid.identification.feed_forward",
    "validate": "deltaid.identification.prediction",
}

# Names of earlier versions, and what they are now.
_RENAMED = {"verdicts": "check", "write_export": "export"}

__all__ = [
    "BodyPose",
    "Calibration",
    "ColumnMapping",
    "Comparison",
    "ConstraintForces",
    "ControlSettings",
    "DeltaidError",
    "Dynamics",
    "Excitation",
    "ExcitationSettings",
    "Exciter",
    "FeedForward",
    "FleetRun",
    "Forces",
    "ForwardDynamics",
    "FourierMotion",
    "Grade",
    "Identification",
    "IdentifiedModel",
    "JaxFunctions",
    "Kinematics",
    "LimbGeometry",
    "Limbs",
    "Load",
    "MappingProposal",
    "Measurements",
    "MechanismParts",
    "Model",
    "Offers",
    "Online",
    "OnlineEstimate",
    "OnlineSettings",
    "PlanSettings",
    "Proposal",
    "Recording",
    "RobotDescription",
    "Samples",
    "SensorNoise",
    "SensorPlan",
    "Settings",
    "Simulation",
    "Validation",
    "Verdict",
    "Verdicts",
    "base",
    "build_limb",
    "calibrate",
    "catalogue",
    "check",
    "columns",
    "compare_controllers",
    "excite",
    "export",
    "fleet",
    "forces",
    "identify",
    "integrate",
    "jax_functions",
    "load",
    "load_mapping",
    "load_offers",
    "load_robot",
    "next_readings",
    "prior_parameters",
    "random_motion",
    "sensor_plan",
    "simulate",
    "simulate_recording",
    "step_through",
    "surrogate_parameters",
    "torque",
    "use_mechanism",
    "validate",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("importlib.metadata").version("deltaid")
    name = _RENAMED.get(name, name)
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    if name.startswith("_"):  # what Python itself looks for, and knows how to go without
        raise AttributeError(f"module 'deltaid' has no attribute '{name}'")
    errors = import_module("deltaid.errors")
    hint = errors.nearest(name, __all__, 0.5)
    raise errors.UnknownFunctionError(
        f"module 'deltaid' has no attribute '{name}'", cure=f"{hint}dir(deltaid) lists all names"
    )


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
