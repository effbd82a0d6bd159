"""Arguments of another type than a function takes: one message with the argument's name."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.robot.load import load_robot

STILL = np.zeros((3, 3))
# Functions with good arguments, of which one is replaced.
CALLS: dict[str, Callable[..., object]] = {
    "export": partial(deltaid.export, model="clavel-delta3", to="c", output="x.c"),
    "motion": partial(
        deltaid.random_motion,
        kinematics=compiled(load_robot("clavel-delta3")).kinematics,
        rng=np.random.default_rng(0),
    ),
    "online": deltaid.OnlineSettings,
    "recording": partial(deltaid.Recording.from_arrays, q=STILL, tau=STILL, rate=1e3),
}


@pytest.mark.parametrize(
    ("call", "wrong", "message"),
    [
        ("export", {"to": ["c"]}, "export: has no target '['c']'"),
        ("export", {"output": None}, "output: must be a file or a folder, not None"),
        ("export", {"inputs": "log.csv"}, "inputs: must be a list of files, not 'log.csv'"),
        ("export", {"functions": 5}, "functions: must be a list of names, not 5"),
        ("export", {"functions": ["online", 5]}, "functions: must be a list of names, not 5"),
        ("export", {"online": {"rate": 1}}, "online: must be OnlineSettings, not {'rate': 1}"),
        (
            "export",
            {"payload": [1.0]},
            "--payload: '[1.0]' is no mass, and no load that the model was identified with",
        ),
        (
            "motion",
            {"kinematics": "par4"},
            "kinematics: must be the Kinematics of a robot, not 'par4'",
        ),
        (
            "motion",
            {"rng": 0},
            "rng: must be a generator, such as numpy.random.default_rng(0), not 0",
        ),
        ("motion", {"period": "10"}, "period: must be a number, not '10'"),
        ("motion", {"period": 0}, "period: must be a positive number, not 0"),
        ("motion", {"harmonics": 2.5}, "harmonics: must be a whole number, not 2.5"),
        ("motion", {"harmonics": 0}, "harmonics: must be a positive number, not 0"),
        ("online", {"rate": "1000"}, "rate: must be a number, not '1000'"),
        ("online", {"rate": True}, "rate: must be a number, not True"),
        ("online", {"extent": None}, "extent: must be a number, not None"),
        ("online", {"noise": 0.1}, "noise: must be a number for each drive, not 0.1"),
        ("online", {"noise": ("x", 1)}, "noise: must be a number, not 'x'"),
        ("online", {"delay": "x"}, "delay: must be a number, not 'x'"),
        ("online", {"body": 5}, "body: must be the name of a body, not 5"),
        (
            "recording",
            {"unit_q": 5},
            "arrays, unit_q: must be a unit, or one for each drive, not 5",
        ),
        ("recording", {"extra": [0.0]}, "arrays, extra: must be a dictionary of arrays, not [0.0]"),
        ("recording", {"name": 3}, "name: must be the name of the recording, not 3"),
    ],
)
def test_a_message_names_the_argument(call: str, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(DeltaidError) as refused:
        CALLS[call](**wrong)
    assert str(refused.value).partition("\n")[0] == message


def test_an_online_cycle_names_its_rate() -> None:
    with pytest.raises(DeltaidError, match="rate: must be a number, not '1 kHz'"):
        deltaid.OnlineSettings().at_rate("1 kHz")  # type: ignore[arg-type]


def test_numbers_of_drives_may_be_arrays_and_whole() -> None:
    settings = deltaid.OnlineSettings(rate=500, noise=np.full(3, 0.1), delay=(0, 1e-3, 0))  # type: ignore[arg-type]
    assert settings.period == 0.002
