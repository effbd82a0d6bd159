"""What is seen of an MJCF model: materials, light, cameras, floor, and shapes on its bodies.

No shape has mass or touches anything: inertia is that of the `inertial` elements alone.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Ball, Rod, Shape, strut_radius, thickness
from deltaid.exports.text import numbers
from deltaid.exports.tree import Tree, Vector
from deltaid.model.model import Model

# Programs that draw no tendons (Drake) show each limb's struts as one line in their middle. They
# take a shape's own colour; MuJoCo takes the material's where that colour is its default, and this
# material is transparent, because MuJoCo draws the struts where they are.
_HIDDEN, _DEFAULT_COLOUR = "hidden", "0.5 0.5 0.5 1"


@dataclass(frozen=True)
class Extent:
    """Lowest and highest corner of what there is to see [m]."""

    low: Vector
    high: Vector


def extent(subject: Model, drawn: Iterable[Shape]) -> Extent:
    """Base, elbows and workspace with some air around."""
    s, world = thickness(subject), [shape for shape in drawn if not shape.body]
    limbs, box = subject.robot.limb_geometry, subject.robot.workspace.bounding_box
    points = [limb.base + (limb.upper_arm or 0.1 * s) * limb.R_WL[:, 0] for limb in limbs]
    points += [point for rod in world if isinstance(rod, Rod) for point in (rod.start, rod.end)]
    corners = np.vstack([*points, *box])
    return Extent(corners.min(axis=0) - 0.15 * s, corners.max(axis=0) + 0.15 * s)


def assets(root: ET.Element, seen: Extent) -> None:
    """Textures and materials, the middle of the picture, and the light that comes with the eye."""
    low, high = seen.low, seen.high
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    ET.SubElement(root, "statistic", center=numbers(centre), extent=numbers([0.5 * size]))
    visual = ET.SubElement(root, "visual")
    ET.SubElement(
        visual, "headlight", ambient="0.3 0.3 0.3", diffuse="0.2 0.2 0.2", specular="0 0 0"
    )
    ET.SubElement(visual, "map", shadowclip="2")
    ET.SubElement(visual, "quality", shadowsize="4096", offsamples="8")
    ET.SubElement(visual, "global", azimuth="130", elevation="-15", offwidth="1920",
                  offheight="1440")  # fmt: skip
    asset = ET.SubElement(root, "asset")
    ET.SubElement(asset, "texture", type="skybox", builtin="gradient", rgb1="0.93 0.95 0.97",
                  rgb2="0.62 0.68 0.75", width="256", height="1536")  # fmt: skip
    ET.SubElement(asset, "texture", name="floor", type="2d", builtin="checker", mark="edge",
                  rgb1="0.82 0.83 0.85", rgb2="0.76 0.78 0.80", markrgb="0.68 0.70 0.73",
                  width="512", height="512")  # fmt: skip
    ET.SubElement(asset, "material", name="floor", texture="floor", texuniform="true",
                  texrepeat="3 3", reflectance="0")  # fmt: skip
    ET.SubElement(asset, "material", name=_HIDDEN, rgba="0.5 0.5 0.5 0")
    for name, rgba in COLOURS.items():
        ET.SubElement(asset, "material", name=name, rgba=numbers(rgba), specular="0.4",
                      shininess="0.5")  # fmt: skip


def scene(world: ET.Element, seen: Extent) -> None:
    """Two lights, a floor below the workspace, and cameras from the front, the side and above."""
    low, high = seen.low, seen.high
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    _light(world, centre + size * np.array([0.6, -0.8, 1.3]), centre, "0.5 0.5 0.5", "true")
    _light(world, centre + size * np.array([-1.0, 0.6, 0.5]), centre, "0.2 0.2 0.22", "false")
    floor = [centre[0], centre[1], low[2]]
    ET.SubElement(world, "geom", name="floor", type="plane", pos=numbers(floor), material="floor",
                  size=numbers([3 * size, 3 * size, 0.05]))  # fmt: skip
    for name, way, far in (
        ("overview", (0.75, -1.0, 0.35), 1.05),
        ("side", (0.0, -1.0, 0.04), 1.05),
        ("top", (0.0, -0.001, 1.0), 1.2),
    ):
        _camera(world, name, centre, far * size * np.array(way) / np.linalg.norm(way))


def _light(world: ET.Element, place: np.ndarray, at: np.ndarray, diffuse: str, shadow: str) -> None:
    way = (at - place) / np.linalg.norm(at - place)
    ET.SubElement(world, "light", pos=numbers(place), dir=numbers(way), directional="true",
                  diffuse=diffuse, specular="0.2 0.2 0.2", castshadow=shadow)  # fmt: skip


def _camera(world: ET.Element, name: str, centre: np.ndarray, away: np.ndarray) -> None:
    """A camera that looks at the middle with world z upwards; it sees along its own −z."""
    back = away / np.linalg.norm(away)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = numbers([*right, *np.cross(back, right)])
    ET.SubElement(world, "camera", name=name, pos=numbers(centre + away), xyaxes=axes, fovy="40")


def draw(element: ET.Element, shape: Shape) -> None:
    """One shape as a geom."""
    values = {"name": shape.name, "material": shape.colour}
    match shape:
        case Rod():
            kind = "capsule" if shape.round else "cylinder"
            values |= {"type": kind, "size": numbers([shape.radius])}
            values |= {"fromto": numbers([*shape.start, *shape.end])}
        case Ball():
            values |= {"type": "sphere", "size": numbers([shape.radius])}
            values |= {"pos": numbers(shape.centre)}
        case _:
            quat = np.roll(Rotation.from_matrix(shape.R).as_quat(), 1)  # the scalar first
            values |= {"type": "box", "size": numbers(shape.half)}
            values |= {"pos": numbers(shape.centre), "quat": numbers(quat)}
    ET.SubElement(element, "geom", values)


def draw_middle(element: ET.Element, subject: Model, body: str, length: float) -> None:
    """The line in the middle of a limb's struts, for programs that draw no tendons."""
    ET.SubElement(element, "geom", name=f"{body}_middle", type="capsule", material=_HIDDEN,
                  rgba=_DEFAULT_COLOUR, fromto=numbers([0.0, 0.0, 0.0, length, 0.0, 0.0]),
                  size=numbers([strut_radius(subject)]))  # fmt: skip


def struts(root: ET.Element, subject: Model, tree: Tree) -> None:
    """Every strut as a tendon without stiffness between the sites at its ends: a line to see."""
    tendons = ET.SubElement(root, "tendon")
    for strut in tree.struts:
        width = numbers([strut_radius(subject)])
        spatial = ET.SubElement(tendons, "spatial", name=strut.name, width=width, material="strut")
        for point in (strut.first, strut.second):
            ET.SubElement(spatial, "site", site=point.name)
