"""YAML: whatever a text is, it is read as it means or refused with a line, and runs nothing."""

import re
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import RootModel

from deltaid.errors import DescriptionError
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import parse, save_yaml
from deltaid.robot.yaml_edit import yaml_text
from deltaid.robot.yaml_tree import plain, read_tree
from descriptions import CLAVEL, refusal, replaced
from sweeps import slow

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


@pytest.mark.parametrize(
    ("model", "text", "fragment"),
    [
        (
            RobotDescription,
            replaced("struts_per_limb: 2", "struts_per_limb: true"),
            "limbs.struts_per_limb: must be a number, not true",
        ),
        (
            ColumnMapping,
            "position: {column: q, unit: deg, sign: [-1, true, 1]}",
            "line 1, position.sign[2]: must be a number, not true",
        ),
        (ColumnMapping, "load:\n  always: 1", "line 2, load.always: must be true or false, not 1"),
    ],
)
def test_booleans_are_no_numbers(model: type, text: str, fragment: str) -> None:
    assert fragment in refusal(text, model)


@pytest.mark.parametrize("value", [True, "5"])
def test_changes_in_python_are_refused_as_in_a_file(value: object) -> None:
    with pytest.raises(DescriptionError, match="platform_speed: must be a number"):
        parse(CLAVEL, RobotDescription, where="").changed(platform_speed=value)


@pytest.mark.parametrize(
    ("key", "value", "unit"),
    [
        ("platform_speed", 4000, "m/s cannot be; speeds are in metres per second"),
        ("platform_acceleration", 40000, "m/s² cannot be; accelerations are in metres per second"),
    ],
)
def test_limits_in_millimetres_are_refused(key: str, value: float, unit: str) -> None:
    with pytest.raises(DescriptionError, match=f"{key}: {value} {unit}"):
        parse(CLAVEL, RobotDescription, where="").changed(**{key: value})


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
@pytest.mark.parametrize("model", [RobotDescription, ColumnMapping, slow(IdentifiedModel)])
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
@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
def test_whatever_is_written_gives_one_message(text: str, inside: bool) -> None:
    for model in (RobotDescription, ColumnMapping):
        try:
            parse(f"name: {text}" if inside else text, model, where="x.yaml")
        except DescriptionError as error:
            assert str(error).startswith("x.yaml")  # noqa: PT017 - both ends are right


FINITE = st.floats(allow_nan=False, allow_infinity=False)
SCALARS = st.none() | st.booleans() | st.integers() | FINITE | st.text()


@given(st.recursive(SCALARS, lambda v: st.lists(v) | st.dictionaries(st.sampled_from("ab"), v)))
@settings(max_examples=40, deadline=None)
@example(["?0", ":0", "-0", "? 0", ": 0", "- 0"])
@example({"a": "?0", "b": ":0"})
def test_what_is_saved_is_read_again(tmp_path_factory, value: object) -> None:
    """The writer is the library's, the meaning of what is read is our own."""
    path = tmp_path_factory.getbasetemp() / "saved.yaml"
    save_yaml(RootModel({"key": value}), path)
    tree = read_tree(path.read_text(), "x.yaml")
    assert tree is not None
    assert repr(plain(tree, "x.yaml")) == repr({"key": value})


@pytest.mark.parametrize("text", ["é: 'x' # \"y\" 😀", "two\nlines", "\x85", "\x00"])
def test_a_long_list_of_mappings_is_a_line_an_entry(text: str) -> None:
    entries = [{"log": f"{text}{k}", "share": 1e-05, "masks": [{"k": k}, []]} for k in range(200)]
    data = {"name": "x", "recordings": entries, "after": {"fit": [1.5, True, None]}}
    written = yaml_text(data)
    tree = read_tree(written, "x.yaml")
    assert tree is not None
    assert plain(tree, "x.yaml") == data
    if text.isprintable():
        assert written.count("\n- {") == 200
        assert len(written.splitlines()) < 210
    few = {"name": "x", "recordings": entries[:49]}
    assert "- log: " in yaml_text(few)


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
