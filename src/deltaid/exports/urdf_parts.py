"""Drives of a URDF, with its colours and simple shapes.

Drives have `ros2_control` for ROS 2, `transmission` for Drake and ROS 1. All their quantities are
those of the joint, so every transmission has the ratio 1, and the inertia of motor and gear is that
seen from the joint.
"""

from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Ball, Rod, Shape
from deltaid.exports.text import numbers
from deltaid.exports.tree import JointForces
from deltaid.model.model import Model
from deltaid.sensors.weighings import roll_pitch_yaw

# Stands in for the driver of the robot's own controller: commands become states.
_HARDWARE = "mock_components/GenericSystem"
_SIMPLE = "transmission_interface/SimpleTransmission"


def control(
    root: ET.Element, subject: Model, home: dict[str, float], forces: dict[str, JointForces]
) -> None:
    """Interfaces and transmissions of all drives."""
    system = ET.SubElement(root, "ros2_control", name=subject.name, type="system")
    hardware = ET.SubElement(system, "hardware")
    ET.SubElement(hardware, "plugin").text = _HARDWARE
    for drive in subject.robot.drives:
        _interfaces(system, subject, drive, home[drive])
    for drive in subject.robot.drives:
        transmission = ET.SubElement(system, "transmission", name=f"{drive}_transmission")
        ET.SubElement(transmission, "plugin").text = _SIMPLE
        ET.SubElement(transmission, "actuator", name=f"{drive}_motor", role="actuator1")
        joint = ET.SubElement(transmission, "joint", name=drive, role="joint1")
        ET.SubElement(joint, "mechanical_reduction").text = "1.0"
    for drive in subject.robot.drives:
        transmission = ET.SubElement(root, "transmission", name=f"{drive}_simple")
        ET.SubElement(transmission, "type").text = _SIMPLE
        joint = ET.SubElement(transmission, "joint", name=drive)
        interface = "hardware_interface/EffortJointInterface"
        ET.SubElement(joint, "hardwareInterface").text = interface
        actuator = ET.SubElement(transmission, "actuator", name=f"{drive}_motor")
        ET.SubElement(actuator, "mechanicalReduction").text = "1"
        own = forces.get(drive)
        if own and own.armature:
            ET.SubElement(actuator, "drake:rotor_inertia", value=numbers([own.armature]))


def _interfaces(system: ET.Element, subject: Model, drive: str, home: float) -> None:
    """What may be commanded within which limits, and what is told; it starts in the home pose."""
    limits, joint = (
        subject.robot.drive_limits.get(drive),
        ET.SubElement(system, "joint", name=drive),
    )
    speed, effort = limits and limits.top_speed, limits and limits.effort
    bounds = {
        "position": limits and limits.range,
        "velocity": (-speed, speed) if speed else None,
        "effort": (-effort, effort) if effort else None,
    }
    for name, within in bounds.items():
        command = ET.SubElement(joint, "command_interface", name=name)
        for key, bound in zip(("min", "max"), within or (), strict=False):
            ET.SubElement(command, "param", name=key).text = numbers([bound])
    for name in ("position", "velocity", "effort"):
        state = ET.SubElement(joint, "state_interface", name=name)
        if name == "position":
            ET.SubElement(state, "param", name="initial_value").text = numbers([home])


def colours(root: ET.Element) -> None:
    """The materials that shapes name."""
    for name, rgba in COLOURS.items():
        material = ET.SubElement(root, "material", name=name)
        ET.SubElement(material, "color", rgba=numbers(rgba))


def visual(link: ET.Element, shape: Shape) -> None:
    """One shape on a link; cylinders of URDF stand along z about their middle, with flat ends."""
    element = ET.SubElement(link, "visual", name=shape.name)
    match shape:
        case Rod():
            along = shape.end - shape.start
            length = float(np.linalg.norm(along))
            turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
            _origin(element, 0.5 * (shape.start + shape.end), turn.as_matrix())
            values = {"radius": numbers([shape.radius]), "length": numbers([length])}
            ET.SubElement(ET.SubElement(element, "geometry"), "cylinder", values)
        case Ball():
            _origin(element, shape.centre, np.eye(3))
            geometry = ET.SubElement(element, "geometry")
            ET.SubElement(geometry, "sphere", radius=numbers([shape.radius]))
        case _:
            _origin(element, shape.centre, shape.R)
            geometry = ET.SubElement(element, "geometry")
            ET.SubElement(geometry, "box", size=numbers(2 * shape.half))
    ET.SubElement(element, "material", name=shape.colour)


def _origin(element: ET.Element, at: Float[np.ndarray, " 3"], R: Float[np.ndarray, "3 3"]) -> None:
    ET.SubElement(element, "origin", xyz=numbers(at), rpy=numbers(roll_pitch_yaw(R)))
