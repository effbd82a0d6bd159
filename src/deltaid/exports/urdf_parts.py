"""Drives of a URDF, with its colours and simple shapes.

Drives have `ros2_control` for ROS 2, `transmission` for Drake and ROS 1. All their quantities are
those of the joint, so every transmission has the ratio 1, and the inertia of motor and gear is that
seen from the joint.
"""

from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Ball, Rod, Shape
from deltaid.exports.plain_friction import JointForces
from deltaid.exports.text import element, numbers
from deltaid.model.model import Model
from deltaid.sensors.weighings import roll_pitch_yaw

# Stands in for the driver of the robot's own controller: commands become states.
_HARDWARE = "mock_components/GenericSystem"
_SIMPLE = "transmission_interface/SimpleTransmission"


def control(
    subject: Model, home: dict[str, float], forces: dict[str, JointForces]
) -> Iterator[ET.Element]:
    """Interfaces and transmissions of all drives."""
    drives = subject.robot.drives
    yield element(
        "ros2_control",
        element("hardware", element("plugin", text=_HARDWARE)),
        *(_interfaces(subject, drive, home[drive]) for drive in drives),
        *(
            element(
                "transmission",
                element("plugin", text=_SIMPLE),
                element("actuator", name=f"{drive}_motor", role="actuator1"),
                element(
                    "joint",
                    element("mechanical_reduction", text="1.0"),
                    name=drive,
                    role="joint1",
                ),
                name=f"{drive}_transmission",
            )
            for drive in drives
        ),
        name=subject.name,
        type="system",
    )
    for drive in drives:
        interface = element("hardwareInterface", text="hardware_interface/EffortJointInterface")
        motor = element("actuator", element("mechanicalReduction", text="1"), name=f"{drive}_motor")
        own = forces.get(drive)
        if own and own.armature:
            motor.append(element("drake:rotor_inertia", value=own.armature))
        yield element(
            "transmission",
            element("type", text=_SIMPLE),
            element("joint", interface, name=drive),
            motor,
            name=f"{drive}_simple",
        )


def _interfaces(subject: Model, drive: str, home: float) -> ET.Element:
    """What may be commanded within which limits, and what is told; it starts in the home pose."""
    limits = subject.robot.limits_of(drive)
    speed, effort = limits.top_speed, limits.effort
    bounds = {
        "position": limits.range,
        "velocity": (-speed, speed) if speed else None,
        "effort": (-effort, effort) if effort else None,
    }
    commands = [
        element(
            "command_interface",
            *(
                element("param", name=key, text=numbers([bound]))
                for key, bound in zip(("min", "max"), within or (), strict=False)
            ),
            name=name,
        )
        for name, within in bounds.items()
    ]
    start = element("param", name="initial_value", text=numbers([home]))
    states = [
        element("state_interface", *([start] if name == "position" else []), name=name)
        for name in bounds
    ]
    return element("joint", *commands, *states, name=drive)


def colours() -> Iterator[ET.Element]:
    """The materials that shapes name."""
    for name, rgba in COLOURS.items():
        yield element("material", element("color", rgba=rgba), name=name)


def visual(shape: Shape) -> ET.Element:
    """One shape on a link; cylinders of URDF stand along z about their middle, with flat ends."""
    match shape:
        case Rod():
            along = shape.end - shape.start
            length = float(np.linalg.norm(along))
            turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
            centre, R = 0.5 * (shape.start + shape.end), turn.as_matrix()
            form = element("cylinder", radius=shape.radius, length=length)
        case Ball():
            centre, R = shape.centre, np.eye(3)
            form = element("sphere", radius=shape.radius)
        case _:
            centre, R = shape.centre, shape.R
            form = element("box", size=2 * shape.half)
    return element(
        "visual",
        element("origin", xyz=centre, rpy=roll_pitch_yaw(R)),
        element("geometry", form),
        element("material", name=shape.colour),
        name=shape.name,
    )
