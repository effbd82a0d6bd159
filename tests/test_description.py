"""Descriptions: whatever a user writes gives a valid robot or one message with line and key."""

import copy
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator as Schema
from ruamel.yaml import YAML

from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import consistency
from deltaid.robot.load import catalogue, catalogue_text, load_robot, load_yaml, parse
from descriptions import CLAVEL, refusal, replaced

TREES = {name: YAML(typ="safe", pure=True).load(catalogue_text(name)) for name in catalogue()}
DELETE = "\x00delete"


def paths(node: object, path: tuple = ()) -> list[tuple]:
    """Paths of all nodes of a tree but the root."""
    keys = node.keys() if isinstance(node, dict) else range(len(node))
    found = []
    for key in keys:
        found.append((*path, key))
        if isinstance(node[key], dict | list):
            found += paths(node[key], (*path, key))
    return found


NUMBERS = st.one_of(
    st.sampled_from([0, -1, 1e308, -1e308, 1e-320, np.nan, np.inf, -np.inf, 10**400, 420.0, 1e-7]),
    st.floats(),
    st.integers(),
)
VALUES = st.one_of(
    NUMBERS,
    st.sampled_from([DELETE, None, True, "", "0.5 m", "0,5", "x", "1e-3", "2025-11-20"]),
    st.text(max_size=5),
    st.lists(NUMBERS, max_size=4),
    st.dictionaries(st.sampled_from(["x", "shape", "mass", "radius"]), NUMBERS, max_size=2),
)


@st.composite
def mutations(draw: st.DrawFn) -> dict:
    """A catalogue robot with up to three nodes replaced, deleted, scaled or added."""
    tree = copy.deepcopy(TREES[draw(st.sampled_from(sorted(TREES)))])
    tree.pop("sources")
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(paths(tree)))
        parent = tree
        for key in path[:-1]:
            parent = parent[key]
        old = parent[path[-1]]
        value = draw(VALUES)
        if isinstance(old, int | float) and abs(old) < 1e6 and draw(st.booleans()):
            value = old * draw(st.sampled_from([-1, 0.001, 0.5, 2, 1000, 1e6]))
        elif isinstance(old, list) and draw(st.booleans()):
            value = old[:-1] if draw(st.booleans()) else [*old, value]
        elif isinstance(old, dict) and draw(st.booleans()):
            value = old | {draw(st.sampled_from(["extra", "mass", "m"])): value}
        if value == DELETE:
            del parent[path[-1]]
        else:
            parent[path[-1]] = value
    return tree


def written(tree: dict) -> str:
    """A tree as YAML in JSON's style, one key a line."""
    text = json.dumps(tree, indent=1)
    for name, number in (("NaN", ".nan"), ("-Infinity", "-.inf"), ("Infinity", ".inf")):
        text = re.sub(rf"(?<![\w\"]){name}\b", number, text)
    return text


@given(mutations())
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
def test_mutated_descriptions(tree: dict) -> None:
    robot = refused = None
    try:
        robot = parse(written(tree), RobotDescription, where="robot.yaml")
    except DescriptionError as error:
        refused = str(error)
    if robot is None:
        assert refused is not None
        assert re.match(r"robot\.yaml: line \d+, [^:]+: \S", refused)
        return
    assert np.all(np.isfinite(prior_parameters(robot)))


MISTAKES = [
    (
        "strut: 1.055",
        "strut: 1.055 m",
        'line 10, limbs.strut: must be a number or a list, not "1.055 m"',
    ),
    ("strut: 1.055", "strut: true", "line 10, limbs.strut: must be a number or a list, not true"),
    ("strut: 1.055", "strut:", "line 10, limbs.strut: must be a number or a list, not null"),
    ("strut: 1.055", "strut: -1.055", "line 10, limbs.strut: must be greater than 0"),
    ("strut: 1.055", "strut: 1055", "line 10, limbs.strut: 1055 m cannot be; lengths are in met"),
    ("strut: 1.055", "strut: .nan", "line 10, limbs.strut: must be a finite number"),
    ("strut: 1.055", "struts: 1.055", "line 10, limbs.struts: unknown key; did you mean strut?"),
    ("strut: 1.055", "STRUT: 1.055", "line 10, limbs.STRUT: unknown key; did you mean strut?"),
    ("friction:", "fricton:", "fricton: unknown key; did you mean friction?"),
    ("name: clavel-delta3", "name: a\n3: b", "line 3, 3: unknown key"),
    ("name: clavel-delta3", "name: ''", "line 2, name: must not be empty"),
    ("name: clavel-delta3", "name: a\ngravity: [0, 0, -9810]", "gravity: 9810 m/s² cannot be; gr"),
    ("name: clavel-delta3", "name: a\ngravity: [0, 0, 0]", "line 3, gravity: is zero; give the"),
    ("  strut: 1.055\n", "", "line 5, limbs.strut: is missing"),
    ("0.420\n", "0.042\n", "line 5, limbs: the limbs cannot close", "strut: 1.055", "strut: 0.12"),
    ("[0, 120, 240]", "[0, 120]", "has 2 limbs, but a platform of kind rigid needs 3"),
    ("[0, 120, 240]", "[0, 72, 144, 216, 288]", "azimuth_deg: must have at most 4 entries, not 5"),
    ("[0, 120, 240]", "[0, 120, 120]", "line 5, limbs: two limbs point the same way"),
    ("[0, 120, 240]", "[0, 2.094, 4.189]", "limbs: all limbs point the same way within 4.19°; azi"),
    ("[0, 120, 240]", "120", "line 6, limbs.azimuth_deg: must be a list, not 120"),
    ("centre: [0, 0, 0], mass: 1.0", "centre: [0, 0], mass: 1.0", "centre: has no entry 3"),
    (
        "centre: [0, 0, 0], mass: 1.0",
        "centre: [0, 0, 0]",
        "gives none of them: give one of mass, density",
    ),
    ("mass: 1.0", "mass: -1.0", "line 30, bodies.P.prior[1].mass: must be greater than 0, not -1"),
    ("shape: point_mass", "shape: ball", "'ball' is no 'shape'; choose from 'hollow_cylinder'"),
    ("inner_radius: 0.036", "inner_radius: 0.36", "inner_radius: must be smaller than outer"),
    ("free: [m]", "free: [mass]", "line 31, bodies.P.free[1]: must be 'm', 'mcx'"),
    ("free: [m]", "free: [m, m]", "line 31, bodies.P.free: names an entry twice"),
    ("  drive3: {viscous: 1.5", "  drive4: {viscous: 1.5", "friction: has unknown drive4; choose"),
    ("[-45, 85]", "[85, -45]", "drive_limits.drive1.angle_deg: must be given as [lowest, highest]"),
    ("z: [-1.15, -0.80]", "z: [-0.80, -1.15]", "workspace.z: must be given as [lowest, highest]"),
    ("shape: cylinder", "shape: sphere", "'sphere' is no 'shape'; choose from 'cylinder'"),
    ("bodies:\n  U:", "bodies:\n  X:", "line 13, bodies: lacks U and has unknown X"),
    ("name: clavel-delta3", "name: 3", "line 2, name: must be text; put it in quotes, not 3"),
]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake: tuple[str, ...]) -> None:
    old, new, fragment, *more = mistake
    text = replaced(*more, text=replaced(old, new)) if more else replaced(old, new)
    message = refusal(text)
    assert fragment in message
    assert "deltaid schema robot" in message


def test_many_mistakes_make_no_endless_message() -> None:
    message = refusal(CLAVEL.replace(": 0.", ": x0.").replace("mass", "masse"))
    assert re.search(r"; and \d+ more\n", message)
    assert len(message) < 1000


PRIOR = CLAVEL[CLAVEL.index("    prior:\n      - {shape: hollow_cylinder, axis: z") :]
PRIOR = PRIOR[: PRIOR.index("    free")]


def with_platform(mass: float, first: list, inertia: dict) -> str:
    explicit = {"mass": mass, "first_moment": first, "inertia": inertia}
    return replaced(PRIOR, f"    prior: {json.dumps(explicit)}\n")


@pytest.mark.parametrize(
    ("mass", "first", "inertia", "fragment"),
    [
        (1, [0, 0, 0], {"xx": 1, "yy": 1, "zz": 3}, "the prior is not a physical body"),
        (1, [0, 0, 1], {"xx": 0.5, "yy": 0.5, "zz": 1}, "about its centre of mass"),
        (1, [0, 0, 0], {"xx": 1, "yy": 1, "zz": 1, "xy": 2}, "the prior is not a physical body"),
        (0, [0, 0, 0], {"xx": 1, "yy": 1, "zz": 1}, "mass: must be greater than 0"),
        (1, [0, 0], {"xx": 1, "yy": 1}, "first_moment: has no entry 3"),
        (1e9, [0, 0, 0], {"xx": 1, "yy": 1, "zz": 1}, "1e+09 kg cannot be"),
    ],
)
def test_impossible_bodies(mass, first, inertia, fragment) -> None:
    assert fragment in refusal(with_platform(mass, first, inertia))


@pytest.mark.parametrize(
    ("mass", "first", "inertia"),
    [
        (2, [0, 0, 0], {"xx": 0.02, "yy": 0.03, "zz": 0.05}),  # plate
        (2, [0, 0, 0.4], {"xx": 0.12, "yy": 0.12, "zz": 0}),  # rod along z
        (2, [0.2, 0.4, 0], {"xx": 0.08, "yy": 0.02, "zz": 0.1, "xy": -0.04}),  # point
        (2, [0, 0, 0], {"xx": 0, "yy": 0, "zz": 0}),  # point at the origin
    ],
)
def test_bodies_without_thickness(mass, first, inertia) -> None:
    robot = parse(with_platform(mass, first, inertia), RobotDescription, where="robot.yaml")
    solid = robot.bodies["P"].reduced_prior()
    assert consistency(solid) > 0
    given_moments = np.array([inertia[k] for k in ("xx", "yy", "zz")])
    assert np.abs(solid[4:7] - given_moments).max() <= 2e-6 * max(given_moments.max(), 1.0)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    cases = {
        "folder": (tmp_path, "is a folder"),
        "missing": (tmp_path / "x.yaml", "no such file"),
        "name": (tmp_path / ("x" * 300), "cannot be read"),
    }
    for path, fragment in cases.values():
        with pytest.raises(DescriptionError, match=fragment):
            load_yaml(path, RobotDescription)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(CLAVEL.replace("Clavel's", "Müllers").encode("cp1252"))
    with pytest.raises(DescriptionError, match="line 1: is not text in UTF-8"):
        load_yaml(latin, RobotDescription)
    large = tmp_path / "log.csv"
    large.write_text("1,2,3\n" * 200_000)
    with pytest.raises(DescriptionError, match="is too large"):
        load_yaml(large, RobotDescription)


@pytest.mark.parametrize("name", ["clavel", "CLAVEL-DELTA3", "x" * 5000, "", "a\0b"])
def test_unknown_robots(name: str) -> None:
    with pytest.raises(
        DescriptionError, match="the catalogue has: abb-irb360-1-1130, anycubic-kossel, clavel"
    ):
        load_robot(name)


def test_byte_order_mark_and_windows_lines(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + CLAVEL.replace("\n", "\r\n").encode())
    assert load_robot(path) == load_robot("clavel-delta3")


@pytest.mark.parametrize("name", catalogue())
def test_schema_fits_the_catalogue(name: str) -> None:
    schema = Schema(RobotDescription.model_json_schema())
    assert schema.is_valid(TREES[name])
    for key, value in (("limbs", 3), ("nmae", "x"), ("platform_speed", 0), ("name", "")):
        assert not schema.is_valid(TREES[name] | {key: value})
    broken = {key: value for key, value in TREES[name].items() if key != "workspace"}
    (missing,) = schema.iter_errors(broken)
    assert missing.message == "'workspace' is a required property"


def test_schema_of_mappings() -> None:
    schema = Schema(ColumnMapping.model_json_schema())
    columns = [{"column": "a", "unit": "deg", "sign": -1}]
    assert schema.is_valid({"position": columns, "time": {"unit": "ms"}})
    assert not schema.is_valid({"position": [{"column": "a", "unit": "deg", "sign": 2}]})
    assert IdentifiedModel.model_json_schema()["required"][0] == "deltaid"
