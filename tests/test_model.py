"""A robot with its parameters: loaded from a name, a robot file, a model file; taken everywhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import deltaid
from command import refused, run
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters, write_recording
from deltaid.robot.load import save_yaml

NAME = "clavel-delta3"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot file, a model file and two recordings of the same robot."""
    folder, robot = tmp_path_factory.mktemp("model"), deltaid.load_robot(NAME)
    rng, dynamics = np.random.default_rng(3), deltaid.Dynamics(robot)
    truth = surrogate_parameters(robot, rng)
    for name in ("log", "other"):
        motion = random_motion(dynamics.kinematics, rng)
        made = simulate_recording(dynamics, truth, motion, rng, duration=4.0, rate=500.0)
        write_recording(made, folder / f"{name}.csv")
    save_yaml(robot, folder / "robot.yaml")
    deltaid.identify(robot, [folder / "log.csv"]).model.save(folder / "model.yaml")
    return folder


def test_name_robot_file_and_model_file(folder: Path) -> None:
    prior = deltaid.prior_parameters(deltaid.load_robot(NAME))
    for source in (NAME, folder / "robot.yaml", str(folder / "robot.yaml")):
        model = deltaid.load(source)
        assert model.identified is None
        assert model.origin == "the prior of its description"
        np.testing.assert_array_equal(model.p, prior)
    model = deltaid.load(folder / "model.yaml")
    assert model.identified is not None
    assert model.origin == "identified from log.csv"
    np.testing.assert_array_equal(model.p, deltaid.IdentifiedModel.load(folder / "model.yaml").p)
    assert not np.allclose(model.p, prior)
    assert deltaid.load(model) is model
    assert deltaid.load(model.identified).p.tolist() == model.p.tolist()
    assert deltaid.load(model.robot).source == NAME


def test_functions_take_names_files_and_values(folder: Path) -> None:
    model = deltaid.load(folder / "model.yaml")
    for source in (NAME, folder / "robot.yaml", folder / "model.yaml", model, model.dynamics):
        assert deltaid.Kinematics(source).dof == 3
        assert deltaid.Dynamics(source).robot == model.robot
        assert deltaid.ForwardDynamics(source).robot == model.robot
        assert deltaid.ConstraintForces(source).struts == ("strut1", "strut2", "strut3")
    for source in (NAME, folder / "model.yaml", model, model.robot):
        error, _ = deltaid.validate(source, folder / "other.csv")
        assert (error.nrmse.max() < 0.1) == (deltaid.load(source).identified is not None)


def test_bodies_that_cannot_exist_are_refused() -> None:
    model = deltaid.load(NAME)
    p = model.p.copy()
    p[model.layout.names.index("S.Ixx")] = 1.0
    with pytest.raises(deltaid.DeltaidError, match=r"clavel-delta3: body S cannot exist"):
        replace(model, p=p)


@pytest.mark.parametrize("command", ["torque", "validate", "forces", "compare-controllers"])
def test_commands_take_a_robot_and_say_so(command: str, folder: Path, tmp_path: Path) -> None:
    options = {
        "torque": ("-o", tmp_path / "tau.csv"),
        "compare-controllers": ("--plant", folder / "model.yaml", "--bandwidth", 5),
    }
    for source in (NAME, folder / "robot.yaml"):
        outcome = run(command, source, folder / "other.csv", *options.get(command, ()), width=200)
        assert outcome.code == 0, outcome.err
        name = Path(source).name
        assert f"{name} is a robot: it stands for its prior parameters" in outcome.err
    outcome = run(command, folder / "model.yaml", folder / "other.csv", *options.get(command, ()))
    assert outcome.code == 0, outcome.err
    assert "stands for its prior" not in outcome.err


def test_a_report_of_a_prior_says_so(folder: Path, tmp_path: Path) -> None:
    for command in ("validate", "forces"):
        page = tmp_path / f"{command}.html"
        outcome = run(command, NAME, folder / "other.csv", "--report", page)
        assert outcome.code == 0, outcome.err
        assert "the prior of its description" in page.read_text(encoding="utf-8")


def test_ranges_need_an_identified_model(folder: Path, tmp_path: Path) -> None:
    message = refused(
        "forces", NAME, folder / "other.csv", "--logs", folder / "log.csv", folder=tmp_path
    )
    assert "comes from no recordings" in message
