"""Mistakes at a prompt: one message, with the names there are and the cure; no traceback."""

import copy
import json
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

import deltaid
from deltaid.errors import UnknownNameError, nearest
from logs import arrays, recorded

NAME = "clavel-delta3"
FRAME = recorded(1200)
ARRAYS = arrays(FRAME)
ROBOT = deltaid.load_robot(NAME)
MOTION = deltaid.random_motion(deltaid.Kinematics(ROBOT), np.random.default_rng(0))


# What is done, what the message says, and its cure.
MISTAKES: dict[str, tuple[Callable[[], object], str, str]] = {
    "a parameter's usual name": (
        lambda: deltaid.load(NAME)["P.mass"], "has no parameter 'P.mass'", "did you mean P.m?"),
    "a parameter's name elsewhere": (
        lambda: deltaid.load(NAME)["S.inertia"], "no parameter 'S.inertia'", "did you mean S.Izz?"),
    "a drive": (
        lambda: deltaid.load(NAME)["viscous.drive9"], "no parameter 'viscous.drive9'",
        "there are: viscous.drive1, viscous.drive2, viscous.drive3"),
    "a body": (lambda: deltaid.load(NAME).body("EE"), "has no body 'EE'", "there are: U, S, P"),
    "a robot": (lambda: deltaid.Kinematics("clavl"), "catalogue robot called 'clavl'",
                "did you mean clavel-delta3?"),
    "a channel": (lambda: deltaid.ConstraintForces(NAME).index("strut1.elbw.x"),
                  "has no channel", "did you mean strut1.elbow.x?"),
    "a controller": (lambda: deltaid.simulate(NAME, ARRAYS, controller="computed torque"),
                     "has no controller", "did you mean computed-torque?"),
    "a length of no time": (lambda: deltaid.simulate(NAME, MOTION, duration=-1.0),
                            "duration: must be a positive number", ""),
    "a length of a recording": (lambda: deltaid.simulate(NAME, ARRAYS, duration=1.0),
                                "duration: is of a motion in memory", "leave it out"),
    "no starts": (lambda: deltaid.ExcitationSettings(starts=0), "starts is 0", "at least 1"),
    "half a harmonic": (lambda: deltaid.excite(NAME, harmonics=2.5),
                        "ExcitationSettings.harmonics: must be a whole number, not 2.5", ""),
    "text for a number": (lambda: deltaid.excite(NAME, duration="a"),
                          "ExcitationSettings.duration: must be a number, not 'a'", ""),
    "a negative weight": (lambda: deltaid.excite(NAME, velocity_weight=-1.0),
                          "ExcitationSettings.velocity_weight: must lie between 0", ""),
    "a load where there is none": (lambda: deltaid.load(NAME).with_load("nope"),
                                   "has no load 'nope'\n  → there are: none", ""),

    "a setting": (lambda: deltaid.Settings(metod="conic"), "metod: unknown key", "its keys are: m"),
    "a setting's value": (lambda: deltaid.identify(NAME, FRAME, settings={"method": "ols"}),
                          "method: must be 'conic' or 'log-cholesky', not \"ols\"", "its keys are"),
    "a key of a mapping": (lambda: deltaid.ColumnMapping(tme="t"), "did you mean time?", "keys"),
    "a key of a description": (lambda: ROBOT.changed(nme="x"), "did you mean name?", "schema"),
    "a description changed in place": (
        lambda: ROBOT.rotor_inertia.update(drive1=5.0), "cannot be changed in place", "changed("),
    "half a robot": (lambda: deltaid.load({"name": "x"}), "robot: ", "is missing"),
    "a robot that no file could hold": (
        lambda: deltaid.load({"name": object()}), "no file could hold", "use text, numbers"),
    "a column": (lambda: deltaid.validate(NAME, FRAME.rename({"q2": "joint2"})),
                 "has no column q2; its columns are t, q1, joint2",
                 "columns=deltaid.ColumnMapping"),
    "a column that is nearly right": (
        lambda: deltaid.validate(NAME, FRAME.rename({"tau2": "tau_2"})),
        "has no column tau2", "did you mean tau_2?"),

    "arrays on their side": (lambda: deltaid.validate(NAME, ARRAYS | {"q": ARRAYS["q"].T}),
                             "has shape (3, 1200), but others have 1200 rows", "q.T"),
    "samples on their side": (lambda: deltaid.Kinematics(NAME).forward(np.zeros((3, 50))),
                              "q: expected arrays of shape (samples, 3), got (3, 50)", "q.T"),
    "text for a sample": (lambda: deltaid.Kinematics(NAME).inverse("home"),
                          "z: holds <U4, not numbers", "shape (3,)"),
    "samples that do not fit": (
        lambda: deltaid.Dynamics(NAME).terms(np.zeros((5, 3)), np.zeros((4, 3))),
        "qd: has 4 samples, but q has 5", "one row a sample"),
    "parameters of another robot": (
        lambda: deltaid.Dynamics(NAME).mass_matrix(np.zeros(3), np.zeros(70)),
        "p has shape (70,), but the robot has 36 parameters", "layout.names"),
    "time that runs backwards": (lambda: deltaid.validate(NAME, ARRAYS | {"t": ARRAYS["t"][::-1]}),
                                 "column t runs backwards", "sampling rate"),
    "time in milliseconds": (lambda: deltaid.validate(NAME, ARRAYS | {"t": 1e3 * ARRAYS["t"]}),
                             "a sampling rate of 1 Hz", "unit: ms"),
    "angles in degrees": (lambda: deltaid.validate(NAME, ARRAYS | {"q": np.rad2deg(ARRAYS["q"])}),
                          "column q[0] is", "unit"),

}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_message_with_its_cure(mistake: str) -> None:
    do, what, cure = MISTAKES[mistake]
    with pytest.raises(deltaid.DeltaidError) as caught:
        do()
    text = str(caught.value)
    assert what in text
    assert cure in text
    assert caught.value.__cause__ is None or caught.value.__suppress_context__
    assert "Traceback" not in text
    assert "pydantic" not in text


def test_the_errors_are_also_those_that_python_knows() -> None:
    with pytest.raises(KeyError):
        _ = deltaid.load(NAME)["P.mass"]
    with pytest.raises(AttributeError):
        _ = deltaid.identfy
    assert not hasattr(deltaid, "_repr_html_")
    error = UnknownNameError("has no x", where="here", cure="there are: y")
    assert str(pickle.loads(pickle.dumps(error))) == str(copy.copy(error)) == str(error)


def test_a_column_that_is_asked_for_itself_is_not_meant() -> None:
    with pytest.raises(deltaid.DeltaidError, match="has no column tau2") as caught:
        deltaid.validate(NAME, FRAME.rename({"tau2": "torque2"}))
    assert "did you mean" not in str(caught.value)


def test_parameters_of_a_model_do_not_change_in_place() -> None:
    given = deltaid.prior_parameters(ROBOT)
    model = deltaid.Model(ROBOT, given)
    given[0] = 7.0
    assert model.p[0] != 7.0
    for p in (model.p, model.dynamics.p):
        with pytest.raises(ValueError, match="read-only"):
            p[0] = 7.0


def test_dictionaries_of_a_description_are_copied_like_others() -> None:
    laws = ROBOT.friction
    assert pickle.loads(pickle.dumps(laws)) == copy.deepcopy(laws) == dict(laws)
    assert (laws | {"drive1": None})["drive1"] is None


def test_the_nearest_name() -> None:
    assert nearest("VISCOUS.Drive1", ["viscous.drive1", "P.m"]) == "did you mean viscous.drive1? "
    assert nearest("zzz", ["viscous.drive1", "P.m"]) == ""


# At a prompt, where no types are checked: what is typed, and what the message says.
TYPED = {
    "deltaid.load('clavel-delta3')['P.mass']": ("no parameter 'P.mass'", "did you mean P.m?"),
    "deltaid.identfy": ("no attribute 'identfy'", "did you mean identify?"),
    "deltaid.export('h4', 'cc', 'x/')": ("has no target 'cc'", "there are: c, st"),
    "deltaid.ExcitationSettings('d-optimal')": ("has no criterion 'd-optimal'", "a-optimal"),
    "deltaid.load(3)": ("a int is no robot", "or a dictionary"),
    "deltaid.identify('h4', None)": ("a NoneType is no recording", "a dictionary of arrays"),
    "deltaid.identify('h4', [], settings=1)": ("a int is no settings", "deltaid.Settings"),
    "deltaid.check('h4', ['x'], columns=3)": ("a int is no mapping", "of the same keys"),
}  # fmt: skip
SESSION = """
import json, sys
from IPython.core.completer import provisionalcompleter
from IPython.core.interactiveshell import InteractiveShell

shell = InteractiveShell.instance(colors="nocolor")
shell.run_cell("import deltaid; robot = deltaid.load_robot('clavel-delta3')")
for line in json.loads(sys.argv[1]):
    print("typed", line)
    shell.run_cell("x = 1\\n" + line)
for text in ("deltaid.", "deltaid.load", "robot."):
    with provisionalcompleter():
        found = [entry.text.lstrip(".") for entry in shell.Completer.completions(text, len(text))]
    print("completed", text, *found)
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What IPython prints."""
    # IPython and what it completes by keep files of their own; a home may be read-only.
    folder = str(tmp_path_factory.mktemp("ipython"))
    home = {"IPYTHONDIR": folder, "XDG_CACHE_HOME": folder}
    command = [sys.executable, "-c", SESSION, json.dumps(list(TYPED))]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=os.environ | home
    )
    return done.stdout


@pytest.mark.slow
def test_ipython_shows_the_line_and_the_message(session: str) -> None:
    _, *parts = re.split(r"^typed .*\n", session.partition("completed")[0], flags=re.MULTILINE)
    for (line, (what, cure)), shown in zip(TYPED.items(), parts, strict=True):
        first, message, *rest = shown.strip().splitlines()
        assert first == f"----> 2 {line}"
        assert re.match(r"\w+Error: ", message)
        assert what in message
        assert cure in rest[0]
        assert len(rest) == 1, shown


@pytest.mark.slow
def test_ipython_completes_names_of_our_own(session: str) -> None:
    lines = [line.split()[1:] for line in session.splitlines() if line.startswith("completed")]
    found = {text: {name.rpartition(".")[2] for name in names} for text, *names in lines}
    assert found["deltaid."] - {"__version__"} == set(deltaid.__all__)
    assert found["deltaid.load"] == {"load", "load_mapping", "load_offers", "load_robot"}
    assert {"plot", "report", "changed", "workspace"} <= found["robot."]
    assert not {name for name in found["robot."] if name.startswith("model_")}
