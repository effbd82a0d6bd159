"""What simulators show of a robot: shapes stand where its joints are."""

from collections import Counter
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import Ball, BoxShape, Rod, Shape, shapes, strut_radius, thickness
from deltaid.exports.tree import Tree, drawn_spacing, spanning_tree
from deltaid.exports.urdf import urdf
from deltaid.model.model import Model
from deltaid.robot.load import load_robot
from exports import disturbed, states, subject, tree_motion
from joint_places import prior_oracle, tool_point
from test_export_mjcf import Simulation

ROBOTS = ("irb360-6-1600", "linear-delta-45", "h4/second", "par4", "i4", "unlike limbs")


@cache
def model_of(name: str) -> Model:
    """Of the catalogue; or of limbs with struts of their own, so far apart; or with single ones."""
    if name not in ("unlike limbs", "single struts"):
        return subject(name)
    robot = load_robot("clavel-delta3")
    limbs = {"strut": (1.05, 1.06, 1.07), "strut_spacing": 0.09, "base_radius": None,
             "base_points": ((0.35, 0.0, 0.0), (-0.15, 0.29, 0.0), (-0.16, -0.3, 0.0))}  # fmt: skip
    if name == "single struts":
        limbs = {"strut": (1.05, 1.06, 1.07), "struts_per_limb": 1}
    return disturbed(robot.changed(limbs=robot.limbs.changed(**limbs)))


@cache
def shown(name: str) -> tuple[Model, Tree, dict[str, Shape], np.ndarray, np.ndarray]:
    """A robot, its tree, its shapes by name; and a pose, z and q."""
    chosen = model_of(name)
    tree = spanning_tree(chosen)
    found = shapes(chosen, tree)
    assert max(Counter(shape.name for shape in found).values()) == 1
    z, q, _, _ = states(chosen, 1, seed=2)
    return chosen, tree, {shape.name: shape for shape in found}, z[0], q[0]


@cache
def frames(name: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """R and r of each body of the tree in the world; of the world itself under no name."""
    chosen, tree, _, z, _ = shown(name)
    known, found = [body.name for body in tree.bodies], {"": (np.eye(3), np.zeros(3))}
    seen = Counter[str]()
    for pose in chosen.dynamics.kinematics.poses(z[None]):
        seen[pose.name] += 1
        own = pose.name if pose.name in known else f"{pose.name}{seen[pose.name]}"
        found[own] = pose.R_WB[0], pose.r_WB[0]
    assert set(known) <= set(found)
    return found


def placed(name: str, body: str, *points: np.ndarray) -> np.ndarray:
    R, r = frames(name)[body]
    return np.array([r + R @ point for point in points])


def ends(name: str, shape: Shape) -> np.ndarray:
    """Both ends of a rod, in the world."""
    assert isinstance(shape, Rod)
    return placed(name, shape.body, shape.start, shape.end)


@pytest.mark.parametrize("name", ROBOTS)
def test_limbs_are_drawn_from_joint_to_joint(name: str) -> None:
    chosen, tree, found, z, q = shown(name)
    s, oracle = thickness(chosen), prior_oracle(chosen.robot)
    for i, limb in enumerate(chosen.robot.limb_geometry):
        n, joint, y = i + 1, oracle.limbs[i].tip(q[i]), limb.R_WL[:, 1]
        seat = oracle.held(z)[i]
        if limb.drive == "rotary":
            np.testing.assert_allclose(ends(name, found[f"arm{n}"]), [limb.base, joint], atol=1e-9)
            motor = ends(name, found[f"motor{n}"])
            np.testing.assert_allclose(motor, limb.base + 0.07 * s * np.array([-y, y]), atol=1e-9)
        else:
            carriage = found[f"carriage{n}"]
            assert isinstance(carriage, BoxShape)
            np.testing.assert_allclose(placed(name, carriage.body, carriage.centre), [joint])
            along = limb.R_WL @ limb.rail
            standing = placed(name, carriage.body, carriage.R[:, 2]) - joint
            np.testing.assert_allclose(standing, [along], atol=1e-9)
            rail, limits = ends(name, found[f"rail{n}"]), chosen.robot.drive_limits[f"drive{n}"]
            beside = rail - limb.base - np.outer(limits.range, along)
            np.testing.assert_allclose(beside[0], beside[1], atol=1e-9)
            assert np.linalg.norm(beside[0]) == pytest.approx(0.035 * s)
            assert beside[0] @ along == pytest.approx(0.0, abs=1e-9)
            assert beside[0] @ limb.R_WL[:, 0] > 0  # behind: farther out than the carriages
        spoke = [seat - limb.attachment, seat]
        np.testing.assert_allclose(ends(name, found[f"limb{n}_spoke"]), spoke, atol=1e-9)
        pair = [strut for strut in tree.struts if strut.body == f"S{n}"]
        side = 0.5 * (limb.spacing or drawn_spacing(chosen.robot)) * y
        sides = {"a": side, "b": -side}
        assert [strut.name for strut in pair] == [f"strut{n}a", f"strut{n}b"]
        for strut in pair:
            side = sides[strut.name[-1]]
            for point, expected in ((strut.first, joint + side), (strut.second, seat + side)):
                ball = found[point.name]
                assert isinstance(ball, Ball)
                here = placed(name, point.body, point.position)
                np.testing.assert_allclose(here, [expected], atol=1e-9)
                np.testing.assert_array_equal(ball.centre, point.position)
                assert ball.body == point.body
        both = np.array([sides["a"], sides["b"]])
        upper, lower = (f"strut{n}a_{part.body}_bar" for part in (pair[0].first, pair[0].second))
        np.testing.assert_allclose(ends(name, found[upper]), joint + both, atol=1e-9)
        np.testing.assert_allclose(ends(name, found[lower]), seat + both, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_platform_and_tool_are_drawn_where_they_are(name: str) -> None:
    chosen, _, found, z, _ = shown(name)
    s, parts, tool = thickness(chosen), prior_oracle(chosen.robot).parts(z), tool_point
    up = np.array([0.0, 0.0, s])
    at = tool(chosen.robot, z)
    flange, tip = ends(name, found["flange"]), ends(name, found["tip"])
    np.testing.assert_allclose(flange, [at, at - 0.045 * up], atol=1e-9)
    np.testing.assert_allclose(tip, [at - 0.045 * up, at - 0.075 * up], atol=1e-9)
    kind = chosen.robot.platform.kind
    if kind == "rigid":
        plate = ends(name, found["platform"])
        np.testing.assert_allclose(plate, [at - 0.012 * up, at + 0.012 * up], atol=1e-9)
        return
    for k, part in enumerate(parts, 1):
        hub = ends(name, found[f"{chosen.robot.platform.bodies[0]}{k}_hub"])
        np.testing.assert_allclose(hub, [part - 0.012 * up, part + 0.012 * up], atol=1e-9)
    if kind == "i4":  # a rack along the slide
        rack, way = ends(name, found["rack"]), parts[0] - parts[1]
        np.testing.assert_allclose(rack.mean(axis=0), parts[0] + 0.014 * up, atol=1e-9)
        np.testing.assert_allclose(np.cross(rack[1] - rack[0], way), 0.0, atol=1e-9)
        return
    middle = ends(name, found["middle"])
    np.testing.assert_allclose(middle, np.array(parts[::-1]) + 0.014 * up, atol=1e-9)


def test_a_telescope_is_drawn_along_itself() -> None:
    """Both halves are a little shorter than it ever is, so that neither sticks out."""
    name = "irb360-6-1600"
    chosen, _, found, z, _ = shown(name)
    bar = chosen.robot.telescope
    top, bottom = np.array(bar.base_joint), z[:3] + bar.platform_joint
    down = (bottom - top) / np.linalg.norm(bottom - top)
    length = 0.97 * bar.stroke[0]
    upper, lower = ends(name, found["bar_upper"]), ends(name, found["bar_lower"])
    np.testing.assert_allclose(upper, [top, top + length * down], atol=1e-9)
    np.testing.assert_allclose(lower, [bottom, bottom - length * down], atol=1e-9)


@pytest.mark.parametrize("name", ["unlike limbs", "h4-linear"])
def test_a_base_holds_motors_or_ends_of_rails(name: str) -> None:
    chosen, _, found, _, _ = shown(name)
    s, bases = thickness(chosen), np.array([limb.base for limb in chosen.robot.limb_geometry])
    if name == "unlike limbs":
        plate = found["base"]
        assert isinstance(plate, Rod)
        up = np.array([[0.0, 0.0, 0.06 * s], [0.0, 0.0, 0.08 * s]])
        np.testing.assert_allclose(ends(name, plate), bases.mean(axis=0) + up, atol=1e-9)
        assert plate.radius > np.linalg.norm(bases - bases.mean(axis=0), axis=1).max()
        return
    rails = np.array([ends(name, found[f"rail{n}"]) for n in (1, 2, 3, 4)])
    for end in (0, 1):
        bars = np.array([ends(name, found[f"frame{end + 1}_{k}"]) for k in (1, 2, 3, 4)])
        for rail in rails:  # each corner is the end of two bars
            near = np.linalg.norm(bars.reshape(-1, 3) - rail[end], axis=1) < 1e-9
            assert near.sum() == 2
        around = ConvexHull(rails[:, end, :2]).area  # of a plane figure: its circumference
        assert np.linalg.norm(np.diff(bars, axis=1), axis=2).sum() == pytest.approx(around)


@pytest.mark.parametrize("name", ["irb360-6-1600", "linear-delta-45"])
def test_programs_without_tendons_show_a_line_in_the_middle_of_each_pair(name: str) -> None:
    chosen, _, _, z, q = shown(name)
    simulation = Simulation(chosen)
    none = np.zeros_like(q)
    simulation.set(tree_motion(chosen, simulation.joints, (z, none, none)))
    oracle = prior_oracle(chosen.robot)
    for i, limb in enumerate(oracle.limbs):
        geom = simulation.data.geom(f"S{i + 1}_middle")
        radius, half = simulation.model.geom(f"S{i + 1}_middle").size[:2]
        axis = half * geom.xmat.reshape(3, 3)[:, 2]
        joint, seat = limb.tip(q[i]), oracle.held(z)[i]
        line = sorted([(geom.xpos - axis).tolist(), (geom.xpos + axis).tolist()])
        np.testing.assert_allclose(line, sorted([joint.tolist(), seat.tolist()]),
                                   atol=1e-9)  # fmt: skip
        assert radius == pytest.approx(strut_radius(chosen))
        ball, site = (
            lookup(f"strut{i + 1}a_seat") for lookup in (simulation.data.geom, simulation.data.site)
        )
        np.testing.assert_allclose(ball.xpos, site.xpos, atol=1e-12)
    if name == "irb360-6-1600":  # a box
        mark, geom = shown(name)[2]["mark"], simulation.model.geom("mark")
        assert isinstance(mark, BoxShape)
        np.testing.assert_allclose(geom.pos, mark.centre, atol=1e-12)
        np.testing.assert_allclose(geom.size, mark.half, atol=1e-12)


def visuals(root: ElementTree.Element, link: str) -> dict[str, ElementTree.Element]:
    found = root.findall(f"link[@name='{link}']/visual")
    return {visual.get("name", ""): visual for visual in found}


def origin(element: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
    """R and r of what stands somewhere."""
    place = element.find("origin")
    rpy, xyz = (np.array(place.get(key, "").split(), dtype=float) for key in ("rpy", "xyz"))
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def numbers(element: ElementTree.Element, path: str, key: str) -> list[float]:
    found = element.find(f"geometry/{path}")
    return [float(x) for x in found.get(key, "").split()]


@pytest.mark.parametrize("name", ["linear-delta-45", "unlike limbs"])
def test_urdf_has_the_same_shapes(name: str) -> None:
    """Its cylinders stand along z about their middle."""
    chosen, _, found, _, _ = shown(name)
    root = ElementTree.fromstring(urdf(chosen).text(".urdf"))
    for shape in found.values():
        element = visuals(root, shape.body or "base")[shape.name]
        R, r = origin(element)
        match shape:
            case Rod():
                length, radius = (numbers(element, "cylinder", k)[0] for k in ("length", "radius"))
                line = [r - 0.5 * length * R[:, 2], r + 0.5 * length * R[:, 2]]
                np.testing.assert_allclose(line, [shape.start, shape.end], atol=1e-9)
                assert radius == pytest.approx(shape.radius)
            case Ball():
                np.testing.assert_allclose(r, shape.centre, atol=1e-12)
                assert numbers(element, "sphere", "radius") == pytest.approx([shape.radius])
            case _:
                np.testing.assert_allclose(r, shape.centre, atol=1e-12)
                np.testing.assert_allclose(R, shape.R, atol=1e-9)
                np.testing.assert_allclose(numbers(element, "box", "size"), 2 * shape.half)


@pytest.mark.parametrize("name", ["unlike limbs", "single struts"])
def test_urdf_draws_each_strut_along_its_own_x_axis(name: str) -> None:
    """One of a pair on a link of its own beside the middle, a single one on the body that it is."""
    chosen = model_of(name)
    root = ElementTree.fromstring(urdf(chosen).text(".urdf"))
    for n, limb in enumerate(chosen.robot.limb_geometry, 1):
        for letter, side in (("a", 0.045), ("b", -0.045)) if limb.struts == 2 else (("", 0.0),):
            link = f"strut{n}{letter}" if letter else f"S{n}"
            drawn = visuals(root, link)[f"strut{n}{letter}"]
            (R, r), half = origin(drawn), 0.5 * limb.strut * np.eye(3)[0]
            assert numbers(drawn, "cylinder", "length") == pytest.approx([limb.strut])
            np.testing.assert_allclose(r, half, atol=1e-12)
            np.testing.assert_allclose(np.abs(R[:, 2]), np.eye(3)[0], atol=1e-9)
            if letter:
                joint = root.find(f"joint[@name='{link}_tilt']")
                assert joint is not None
                np.testing.assert_allclose(origin(joint)[1], [0.0, side, 0.0], atol=1e-12)
