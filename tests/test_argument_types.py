"""Arguments of another type than a function takes: one message with the argument's name."""

from typing import Any

import numpy as np
import pytest

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.robot.load import load_robot


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"to": ["c"]}, "export: has no target"),
        ({"output": None}, "output: must be a file or a folder, not None"),
        ({"inputs": "log.csv"}, "inputs: must be a list of files, not 'log.csv'"),
        ({"functions": 5}, "functions: must be a list of names, not 5"),
        ({"functions": ["online", 5]}, "functions: must be a list of names, not 5"),
        ({"online": {"rate": 500}}, "online: must be OnlineSettings, not {'rate': 500}"),
        ({"payload": [1.0]}, "--payload: '[1.0]' is no mass"),
    ],
)
def test_export_names_the_argument(wrong: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"model": "clavel-delta3", "to": "c", "output": "x.c"}
    with pytest.raises(DeltaidError) as refused:
        deltaid.export(**given | wrong)
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kinematics": "par4"}, "kinematics: must be the Kinematics of a robot, not 'par4'"),
        ({"rng": 0}, "rng: must be a generator, such as numpy.random.default_rng(0), not 0"),
        ({"period": "10"}, "period: must be a number, not '10'"),
        ({"period": 0}, "period: must be a positive number, not 0"),
        ({"harmonics": 2.5}, "harmonics: must be a whole number, not 2.5"),
        ({"harmonics": 0}, "harmonics: must be a positive number, not 0"),
    ],
)
def test_random_motion_names_the_argument(wrong: dict[str, Any], message: str) -> None:
    given = {
        "kinematics": compiled(load_robot("clavel-delta3")).kinematics,
        "rng": np.random.default_rng(0),
    }
    with pytest.raises(DeltaidError) as refused:
        deltaid.random_motion(**given | wrong)
    assert str(refused.value) == message


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rate": "1000"}, "rate: must be a number, not '1000'"),
        ({"rate": True}, "rate: must be a number, not True"),
        ({"extent": None}, "extent: must be a number, not None"),
        ({"noise": 0.1}, "noise: must be a number for each drive, not 0.1"),
        ({"noise": ("x", 1)}, "noise: must be a number, not 'x'"),
        ({"delay": "x"}, "delay: must be a number, not 'x'"),
        ({"body": 5}, "body: must be the name of a body, not 5"),
    ],
)
def test_online_settings_name_the_setting(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(DeltaidError) as refused:
        deltaid.OnlineSettings(**wrong)
    assert str(refused.value) == message


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"unit_q": 5}, "arrays, unit_q: must be a unit, or one for each drive, not 5"),
        ({"extra": [0.0]}, "arrays, extra: must be a dictionary of arrays, not [0.0]"),
        ({"name": 3}, "name: must be the name of the recording, not 3"),
    ],
)
def test_a_recording_names_the_argument(wrong: dict[str, Any], message: str) -> None:
    still = np.zeros((3, 3))
    with pytest.raises(DeltaidError) as refused:
        deltaid.Recording.from_arrays(**{"q": still, "tau": still, "rate": 1e3} | wrong)
    assert str(refused.value) == message


def test_an_online_cycle_names_its_rate() -> None:
    with pytest.raises(DeltaidError, match="rate: must be a number, not '1 kHz'"):
        deltaid.OnlineSettings().at_rate("1 kHz")  # type: ignore[arg-type]


def test_numbers_of_drives_may_be_arrays_and_whole() -> None:
    settings = deltaid.OnlineSettings(rate=500, noise=np.full(3, 0.1), delay=(0, 1e-3, 0))  # type: ignore[arg-type]
    assert settings.period == 0.002
