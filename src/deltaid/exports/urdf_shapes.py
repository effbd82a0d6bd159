"""Colours and simple shapes in URDF."""

from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Ball, Rod, Shape
from deltaid.exports.text import numbers
from deltaid.sensors.weighings import roll_pitch_yaw


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
