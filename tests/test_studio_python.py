"""The Python that the studio shows for a step: run, it makes the files that the command makes."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from command import accepted, run
from deltaid.errors import DeltaidError
from deltaid.model.model import load
from deltaid.model.record import Settings
from deltaid.robot.load import load_robot
from deltaid.studio.drafting.interview import drafted, new_step
from deltaid.studio.plan import Plan, Used
from deltaid.studio.steps import (
    Step,
    along_step,
    check_step,
    excite_step,
    export_step,
    fit_step,
    insisting,
    show_step,
    validate_step,
)
from foreign_logs import foreign
from logs import recorded

ROBOT, MOTION, MAPPING = "clavel-delta3", "at/motion.csv", "mapping.yaml"
LOG = Used(file="log.csv", mapping=MAPPING)
TEST = Used(file="test.csv", mapping=MAPPING, use="verify")
QUICK = Settings(friction="described", lag="none", compliance="none", effects="none", events=False)
PLAN = Plan(robot=ROBOT, recordings=(LOG, TEST), settings=QUICK)
SLOW = pytest.mark.slow
EXCITE = excite_step(ROBOT, MOTION, "at", duration=2.0, starts=1)
_MAPPING = """\
time: {column: 'Timestamp [ms]', unit: ms}
position: {columns: [Axis1.ActPos, Axis2.ActPos, Axis3.ActPos], unit: deg}
torque: {columns: [Axis1.ActTorque, Axis2.ActTorque, Axis3.ActTorque], unit: N m}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings with their mapping, and a motion."""
    place = tmp_path_factory.mktemp("python")
    (place / "at").mkdir()
    foreign(place / "log.csv", recorded(1500))
    foreign(place / "test.csv", recorded(900))
    (place / MAPPING).write_text(_MAPPING)
    with contextlib.chdir(place):
        accepted(*EXCITE.arguments)
    return place


def _steps() -> Iterator[object]:
    yield pytest.param(show_step(ROBOT, "at/robot.html"), marks=SLOW)
    yield check_step(PLAN, "at")
    yield fit_step(PLAN, "at")
    yield pytest.param(fit_step(PLAN.changed(settings=Settings()), "at"), marks=SLOW)
    yield pytest.param(validate_step(ROBOT, LOG, "at"), marks=SLOW)
    yield EXCITE
    yield pytest.param(along_step("simulate", ROBOT, MOTION, None, "at", "pd"), marks=SLOW)
    yield pytest.param(along_step("simulate", ROBOT, "log.csv", MAPPING, "at"), marks=SLOW)
    yield along_step("torque", ROBOT, "log.csv", MAPPING, "at")
    yield pytest.param(along_step("torque", ROBOT, MOTION, None, "at", True), marks=SLOW)
    yield along_step("forces", ROBOT, MOTION, None, "at", 0.1)
    yield along_step("forces", ROBOT, "log.csv", MAPPING, "at")
    for form in ("c", "mjcf", "urdf", "casadi", "npz"):
        yield export_step(ROBOT, form, f"at/{form}/")
    yield export_step(ROBOT, "mjcf", "at/plain/", plain_friction=True)
    yield export_step(ROBOT, "urdf", "at/none/", without_friction=True)
    yield export_step(ROBOT, "c", "at/online/", functions=("online",), single=True)


@pytest.mark.slow
@pytest.mark.parametrize("step", list(_steps()), ids=lambda step: " ".join(step.arguments[:3]))
def test_the_python_of_a_step_makes_what_its_command_makes(folder: Path, step: Step) -> None:
    if step is not EXCITE:  # which the folder has been made by
        with contextlib.chdir(folder):
            assert run(*step.arguments).code in (0, 3, 4)
    made = _data(folder, step)
    assert made or step.kind in ("show", "check", "validate")
    for path in made:
        path.unlink()
    with contextlib.chdir(folder):
        exec(compile(step.python, step.kind, "exec"), {})
    again = _data(folder, step)
    assert set(again) == set(made)
    for path, data in made.items():
        if step.kind == "fit":
            path.with_suffix(".first.yaml").write_bytes(data)
            assert load(path).p == pytest.approx(load(path.with_suffix(".first.yaml")).p, rel=1e-9)
        else:
            assert again[path] == data, path


def _data(folder: Path, step: Step) -> dict[Path, bytes]:
    """What a step has written, without pages, which hold the time."""
    words = step.arguments
    if "--output" not in words:
        return {}
    place = folder / words[words.index("--output") + 1]
    files = place.iterdir() if place.is_dir() else [place]
    return {path: path.read_bytes() for path in files if path.is_file()}


def test_an_export_has_the_choices_of_its_form_and_may_be_of_a_poor_model() -> None:
    step = export_step("m.yaml", "st", "at/", functions=("online", "regressor"), single=True)
    asked = ("export", "m.yaml", "--to", "st", "--with", "online,regressor", "--single")
    assert step.arguments == (*asked, "--output", "at/")
    assert insisting(step).arguments == (*asked, "--output", "at/", "--force")
    assert export_step("m", "fmu", "a/", fmi="3").arguments[-4:] == ("--fmi", "3", "--output", "a/")


def test_a_robot_of_a_form_is_that_of_the_command(folder: Path) -> None:
    answers = {"base_radius": "200 mm", "platform_radius": "45mm", "arm": "0.235", "strut": "80 cm"}
    answers |= {"unknown": "", "spacing": " "}
    step = new_step("delta", "my-robot.yaml", answers)
    with contextlib.chdir(folder):
        accepted(*step.arguments)
        text = Path("my-robot.yaml").read_text()
        assert drafted("delta", "my-robot", answers) == text
        Path("my-robot.yaml").unlink()
        exec(compile(step.python, "new", "exec"), {})
        assert Path("my-robot.yaml").read_text() == text
    assert load_robot(folder / "my-robot.yaml").limbs.strut == pytest.approx(0.8)
    for wrong in ({}, answers | {"strut": "long"}, answers | {"strut": "80 mm"}):
        with pytest.raises(DeltaidError):
            drafted("delta", "my-robot", wrong)
