"""Descriptions: whatever a user writes gives a valid robot or one message with line and key."""

import copy
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import RootModel
from ruamel.yaml import YAML

from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import consistency
from deltaid.robot.load import catalogue, catalogue_text, load_robot, load_yaml, parse, save_yaml
from deltaid.robot.yaml_tree import plain, read_tree
from json_schema import violations

CLAVEL = catalogue_text("clavel-delta3")
TREES = {name: YAML(typ="safe", pure=True).load(catalogue_text(name)) for name in catalogue()}
DELETE = "\x00delete"


def refusal(text: str, model: type = RobotDescription) -> str:
    """The message with which a text is refused."""
    with pytest.raises(DescriptionError) as caught:
        parse(text, model, where="robot.yaml")
    assert str(caught.value).startswith("robot.yaml")
    return str(caught.value)


def replaced(old: str, new: str, text: str = CLAVEL) -> str:
    assert old in text
    return text.replace(old, new, 1)


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
@settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
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
    (
        "strut: 1.055",
        "strut: '1.055'",
        'line 10, limbs.strut: must be a number or a list, not "1.055"',
    ),
    (
        "strut: 1.055",
        "strut: 1,055",
        'line 10, limbs.strut: must be a number or a list, not "1,055"',
    ),
    ("strut: 1.055", "strut: true", "line 10, limbs.strut: must be a number or a list, not true"),
    ("strut: 1.055", "strut:", "line 10, limbs.strut: must be a number or a list, not null"),
    ("strut: 1.055", "strut: -1.055", "line 10, limbs.strut: must be greater than 0"),
    ("strut: 1.055", "strut: 1055", "line 10, limbs.strut: 1055 m cannot be; lengths are in met"),
    ("strut: 1.055", "strut: .nan", "line 10, limbs.strut: must be a finite number"),
    ("strut: 1.055", "strut: .inf", "line 10, limbs.strut: must be a finite number"),
    ("strut: 1.055", "struts: 1.055", "line 10, limbs.struts: unknown key; did you mean strut?"),
    ("friction:", "fricton:", "fricton: unknown key; did you mean friction?"),
    ("name: clavel-delta3", "name: a\n3: b", "line 3, 3: unknown key"),
    ("name: clavel-delta3", "name: ''", "line 2, name: must not be empty"),
    ("name: clavel-delta3", "name: a\ngravity: [0, 0, -9810]", "gravity: 9810 m/s² cannot be; gr"),
    ("name: clavel-delta3", "name: a\ngravity: [0, 0, 0]", "gravity: is zero; give the vector"),
    ("  strut: 1.055\n", "", "line 5, limbs.strut: is missing"),
    ("0.420\n", "0.042\n", "line 5, limbs: the limbs cannot close", "strut: 1.055", "strut: 0.12"),
    ("[0, 120, 240]", "[0, 120]", "has 2 limbs, but a platform of kind rigid needs 3"),
    ("[0, 120, 240]", "[0, 72, 144, 216, 288]", "azimuth_deg: must have at most 4 entries, not 5"),
    ("[0, 120, 240]", "[0, 120, 120]", "line 5, limbs: two limbs point the same way"),
    ("[0, 120, 240]", "[0, 2.094, 4.189]", "limbs: all limbs point the same way within 4.19°; azi"),
    ("[0, 120, 240]", "120", "line 6, limbs.azimuth_deg: must be a list, not 120"),
    ("centre: [0, 0, 0], mass: 1.0", "centre: [0, 0], mass: 1.0", "centre: has no entry 3"),
    ("centre: [0, 0, 0], mass: 1.0", "centre: [0, 0, 0]", "give either mass or density"),
    ("mass: 1.0", "mass: -1.0", "line 30, bodies.P.prior.0.mass: must be greater than 0, not -1"),
    ("shape: point_mass", "shape: ball", "'ball' is no 'shape'; choose from 'hollow_cylinder'"),
    ("inner_radius: 0.036", "inner_radius: 0.36", "inner_radius: must be smaller than outer"),
    ("free: [m]", "free: [mass]", "line 31, bodies.P.free.0: must be 'm', 'mcx'"),
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


SYNTAX = [
    (replaced("strut: 1.055", "strut 1.055"), r"robot.yaml, line 1\d: is not valid YAML"),
    (replaced("  strut: 1.055", "\tstrut: 1.055"), r"robot.yaml, line \d+: is not valid YAML"),
    (CLAVEL + "name: twice\n", r"robot.yaml, line \d+: is not valid YAML: found duplicate key"),
    (CLAVEL + "---\n" + CLAVEL, r"robot.yaml, line \d+: is not valid YAML"),
    ("limbs: [1, 2", "robot.yaml, line 1: is not valid YAML"),
    ("name: *nothing", "robot.yaml, line 1: is not valid YAML"),
    ("name: \x00", r"robot.yaml, line 1: is not valid YAML: character U\+0000"),
    ("", "robot.yaml: is empty"),
    ("# nothing", "robot.yaml: is empty"),
    ("- 1\n- 2", "robot.yaml: does not hold keys with values"),
    ("t,q1,q2\n0,1,2\n", "robot.yaml: does not hold keys with values"),
]


@pytest.mark.parametrize(("text", "pattern"), SYNTAX)
def test_syntax_errors_have_a_line(text: str, pattern: str) -> None:
    assert re.match(pattern, refusal(text))


@pytest.mark.parametrize(
    "tag",
    ["!!python/object/apply:os.mkdir", "!!python/object/new:os.mkdir", "!!python/name:os.x", "!x"],
)
def test_tags_never_execute(tmp_path: Path, monkeypatch, tag: str) -> None:
    monkeypatch.chdir(tmp_path)
    for value in (f"{tag} [pwned]", f"{tag} {{a: pwned}}", f"{tag} pwned"):
        message = refusal(replaced("strut: 1.055", f"strut: {value}"))
        assert "line 10" in message
        assert "has the tag" in message
    refusal(f"{tag}\n{CLAVEL}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", ["!!binary aGVsbG8=", "!!set {a, b}", "!!omap [a: 1]"])
def test_other_types_are_refused(value: str) -> None:
    text = replaced("title: Clavel's 3-DOF Delta", f"title: {value}")
    assert "line 3: has the tag tag:yaml.org,2002:" in refusal(text)


STUMBLING_BLOCKS = [
    ("!!bool foo", "line 10: has the tag"),
    ("!!int ''", "line 10: has the tag"),
    ("0x_", 'limbs.strut: must be a number or a list, not "0x_"'),
    ("+_", 'limbs.strut: must be a number or a list, not "+_"'),
    ("1_000", 'limbs.strut: must be a number or a list, not "1_000"'),
    ("9" * 5000, "limbs.strut: must be a finite number"),
    ("-" + "9" * 5000, "limbs.strut: must be "),
    ("0x" + "f" * 5000, "limbs.strut: must be a finite number"),
    ('"\\UFFFFFFFF"', "is not valid YAML"),
    ('"\\ud800"', "line 10: is not valid YAML: half a character"),
    ("&a {<<: *a}", "line 10: is not valid YAML: *a is not there before this line"),
    ("{[1]: 2}", "line 10: has a key that is not a word"),
    ("[&a [1], {*a : 2}]", "line 10: has a key that is not a word"),
    ("{<<: 3}", "line 10: merges (<<) what has no keys"),
    ("\x07", "line 10: is not valid YAML: character U+0007 cannot be in it"),
]


@pytest.mark.parametrize(("value", "fragment"), STUMBLING_BLOCKS)
@pytest.mark.parametrize("model", [RobotDescription, ColumnMapping, IdentifiedModel])
def test_values_at_which_a_reader_may_stumble(model: type, value: str, fragment: str) -> None:
    message = refusal(replaced("strut: 1.055", f"strut: {value}"), model)
    assert len(message) < 1500
    if model is RobotDescription:
        assert fragment in message


WORDS = r"""a  b:  -  :  ?  &x  *x  <<  !!int  !!bool  !  |  >  {  }  [  ]  ,  #  '  "  %YAML 1.1
  %TAG ! x  ---  ...  \U  FFFFFFFF  \x  0x  0o  _  +  1e  .inf  2025-11-20  ~  @  `"""
SPACES = (" ", "\n", "\n  ", "\t", "\ufeff", "\x85", "\u2028", "\x00")
TEXTS = st.lists(st.sampled_from([*re.split(r"\s\s+", WORDS), *SPACES]), max_size=20).map("".join)


@given(TEXTS | st.text(max_size=20), st.booleans())
@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
def test_whatever_is_written_gives_one_message(text: str, inside: bool) -> None:
    for model in (RobotDescription, ColumnMapping):
        try:
            parse(f"name: {text}" if inside else text, model, where="x.yaml")
        except DescriptionError as error:
            assert str(error).startswith("x.yaml")  # noqa: PT017 - both ends are right


FINITE = st.floats(allow_nan=False, allow_infinity=False)


SCALARS = st.none() | st.booleans() | st.integers() | FINITE | st.text()


@given(st.recursive(SCALARS, lambda v: st.lists(v) | st.dictionaries(st.sampled_from("ab"), v)))
@settings(max_examples=100, deadline=None)
@example(["?0", ":0", "-0", "? 0", ": 0", "- 0"])
@example({"a": "?0", "b": ":0"})
def test_what_is_saved_is_read_again(tmp_path_factory, value: object) -> None:
    """The writer is the library's, the meaning of what is read is our own."""
    path = tmp_path_factory.getbasetemp() / "saved.yaml"
    save_yaml(RootModel({"key": value}), path)
    tree = read_tree(path.read_text(), "x.yaml")
    assert tree is not None
    assert repr(plain(tree, "x.yaml")) == repr({"key": value})


def test_as_many_keys_as_a_file_may_hold_are_refused_at_once() -> None:
    text = "\n".join(f"k{i}: {i}" for i in range(80_000))
    start = time.process_time()
    assert "has too many entries or levels" in refusal(text)
    assert time.process_time() - start < 4  # half a second where types are not checked


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [bomb(12), "a: &a [*a]", "a: &a {b: *a}", "a: " + "[" * 5000, "a: " + "{a: " * 2000, "[" * 99],
)
def test_bombs_do_not_hang(text: str) -> None:
    start = time.monotonic()
    refusal(text)
    assert time.monotonic() - start < 5


def test_anchors_and_merges_work() -> None:
    text = replaced(
        "drive1: {viscous: 1.5, coulomb: 5.0}", "drive1: &f {viscous: 1.5, coulomb: 5.0}"
    )
    text = replaced("drive2: {viscous: 1.5, coulomb: 5.0}", "drive2: *f", text)
    text = replaced("drive3: {viscous: 1.5, coulomb: 5.0}", "drive3: {<<: *f, coulomb: 6}", text)
    robot = parse(text, RobotDescription, where="robot.yaml")
    assert robot.friction["drive2"] == robot.friction["drive1"]
    assert robot.friction["drive3"].coulomb == 6
    wrong = replaced("coulomb: 6", "coulomb: x", text)
    assert "friction.drive3.coulomb: must be a number" in refusal(wrong)


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
    with pytest.raises(DescriptionError, match="the catalogue has: clavel-delta3, h4, h4-linear"):
        load_robot(name)


def test_byte_order_mark_and_windows_lines(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + CLAVEL.replace("\n", "\r\n").encode())
    assert load_robot(path) == load_robot("clavel-delta3")


@pytest.mark.parametrize("name", catalogue())
def test_schema_fits_the_catalogue(name: str) -> None:
    schema = RobotDescription.model_json_schema()
    assert violations(TREES[name], schema) == []
    for key, value in (("limbs", 3), ("nmae", "x"), ("platform_speed", 0), ("name", "")):
        assert violations(TREES[name] | {key: value}, schema)
    broken = {key: value for key, value in TREES[name].items() if key != "workspace"}
    assert violations(broken, schema) == [".workspace: is missing"]


def test_schema_of_mappings() -> None:
    schema = ColumnMapping.model_json_schema()
    columns = [{"column": "a", "unit": "deg", "sign": -1}]
    assert violations({"position": columns, "time": {"unit": "ms"}}, schema) == []
    assert violations({"position": [{"column": "a", "unit": "deg", "sign": 2}]}, schema)
    assert IdentifiedModel.model_json_schema()["required"][0] == "deltaid"
