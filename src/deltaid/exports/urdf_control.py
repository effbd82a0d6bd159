"""Drives of a URDF: `ros2_control` for ROS 2, `transmission` for Drake and ROS 1.

All quantities are those of the joint, so every transmission has the ratio 1, and the inertia of
motor and gear is that seen from the joint.
"""

from xml.etree import ElementTree as ET

from deltaid.exports.joint_forces import JointForces
from deltaid.exports.text import numbers
from deltaid.model.model import Model

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
