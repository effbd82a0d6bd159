"""What is seen of an MJCF model: materials, light, cameras, floor, and shapes on its bodies.

No shape has mass or touches anything: inertia is that of the `inertial` elements alone.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Ball, Rod, Shape, strut_radius, thickness
from deltaid.exports.text import element
from deltaid.exports.tree import Tree, Vector
from deltaid.model.model import Model

# Programs that draw no tendons (Drake) show each limb's struts as one line in their middle. They
# take a shape's own colour; MuJoCo takes the material's where that colour is its default, and this
# material is transparent, because MuJoCo draws the struts where they are.
_HIDDEN, _DEFAULT_COLOUR = "hidden", "0.5 0.5 0.5 1"


@dataclass(frozen=True)
class Extent:
    """Middle of what there is to see, its diagonal, and height of the floor below it [m]."""

    centre: Vector
    size: float
    floor: float


def extent(subject: Model, drawn: Iterable[Shape]) -> Extent:
    """Base, elbows and workspace with some air around."""
    s, rods = thickness(subject), [shape for shape in drawn if isinstance(shape, Rod)]
    limbs, box = subject.robot.limb_geometry, subject.robot.workspace.bounding_box
    points = [limb.base + (limb.upper_arm or 0.1 * s) * limb.R_WL[:, 0] for limb in limbs]
    points += [point for rod in rods if not rod.body for point in (rod.start, rod.end)]
    corners = np.vstack([*points, *box])
    low, high = corners.min(axis=0) - 0.15 * s, corners.max(axis=0) + 0.15 * s
    return Extent(0.5 * (low + high), float(np.linalg.norm(high - low)), low[2])


def assets(seen: Extent) -> tuple[ET.Element, ...]:
    """Textures and materials, the middle of the picture, and the light that comes with the eye."""
    return (
        element("statistic", center=seen.centre, extent=0.5 * seen.size),
        element(
            "visual",
            element("headlight", ambient="0.3 0.3 0.3", diffuse="0.2 0.2 0.2", specular="0 0 0"),
            element("map", shadowclip="2"),
            element("quality", shadowsize="4096", offsamples="8"),
            element("global", azimuth="130", elevation="-15", offwidth="1920", offheight="1440"),
        ),
        element(
            "asset",
            element("texture", type="skybox", builtin="gradient", rgb1="0.93 0.95 0.97",
                    rgb2="0.62 0.68 0.75", width="256", height="1536"),
            element("texture", name="floor", type="2d", builtin="checker", mark="edge",
                    rgb1="0.82 0.83 0.85", rgb2="0.76 0.78 0.80", markrgb="0.68 0.70 0.73",
                    width="512", height="512"),
            element("material", name="floor", texture="floor", texuniform="true",
                    texrepeat="3 3", reflectance="0"),
            element("material", name=_HIDDEN, rgba="0.5 0.5 0.5 0"),
            *(element("material", name=name, rgba=rgba, specular="0.4", shininess="0.5")
              for name, rgba in COLOURS.items()),
        ),
    )  # fmt: skip


def scene(seen: Extent) -> Iterator[ET.Element]:
    """Two lights, a floor below the workspace, and cameras from the front, the side and above."""
    centre, size = seen.centre, seen.size
    yield _light(centre + size * np.array([0.6, -0.8, 1.3]), centre, "0.5 0.5 0.5", "true")
    yield _light(centre + size * np.array([-1.0, 0.6, 0.5]), centre, "0.2 0.2 0.22", "false")
    yield element("geom", name="floor", type="plane", pos=[centre[0], centre[1], seen.floor],
                  material="floor", size=[3 * size, 3 * size, 0.05])  # fmt: skip
    for name, way, far in (
        ("overview", (0.75, -1.0, 0.35), 1.05),
        ("side", (0.0, -1.0, 0.04), 1.05),
        ("top", (0.0, -0.001, 1.0), 1.2),
    ):
        yield _camera(name, centre, far * size * np.array(way) / np.linalg.norm(way))


def _light(place: np.ndarray, at: np.ndarray, diffuse: str, shadow: str) -> ET.Element:
    way = (at - place) / np.linalg.norm(at - place)
    return element("light", pos=place, dir=way, directional="true", diffuse=diffuse,
                   specular="0.2 0.2 0.2", castshadow=shadow)  # fmt: skip


def _camera(name: str, centre: np.ndarray, away: np.ndarray) -> ET.Element:
    """A camera that looks at the middle with world z upwards; it sees along its own −z."""
    back = away / np.linalg.norm(away)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = [*right, *np.cross(back, right)]
    return element("camera", name=name, pos=centre + away, xyaxes=axes, fovy="40")


def geom(shape: Shape) -> ET.Element:
    """One shape of a body."""
    match shape:
        case Rod(start=start, end=end):
            kind = "capsule" if shape.round else "cylinder"
            form = {"type": kind, "size": shape.radius, "fromto": [*start, *end]}
        case Ball():
            form = {"type": "sphere", "size": shape.radius, "pos": shape.centre}
        case _:
            turn = scalar_first(shape.R)
            form = {"type": "box", "size": shape.half, "pos": shape.centre, "quat": turn}
    return element("geom", name=shape.name, material=shape.colour, **form)


def scalar_first(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 4"]:
    """The quaternion of a rotation as MuJoCo has it."""
    return np.roll(Rotation.from_matrix(R).as_quat(), 1)


def middle(subject: Model, body: str, length: float) -> ET.Element:
    """The line in the middle of a limb's struts, for programs that draw no tendons."""
    return element("geom", name=f"{body}_middle", type="capsule", material=_HIDDEN,
                   rgba=_DEFAULT_COLOUR, fromto=[0.0, 0.0, 0.0, length, 0.0, 0.0],
                   size=strut_radius(subject))  # fmt: skip


def struts(subject: Model, tree: Tree) -> ET.Element:
    """Every strut as a tendon without stiffness between the sites at its ends: a line to see."""
    return element(
        "tendon",
        *(
            element(
                "spatial",
                *(element("site", site=point.name) for point in (strut.first, strut.second)),
                name=strut.name,
                width=strut_radius(subject),
                material="strut",
            )
            for strut in tree.struts
        ),
    )
