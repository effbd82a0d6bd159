"""Fixtures that several test files share: the catalogue's robots, compiled once a session."""

import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.robot.load import load_robot


@pytest.fixture(scope="session")
def irb360() -> Dynamics:
    return Dynamics(load_robot("irb360-6-1600"))


@pytest.fixture(scope="session")
def clavel() -> Dynamics:
    return Dynamics(load_robot("clavel-delta3"))
