"""Shapes and types are checked in every call; robots that several test files share."""

import pkgutil

import jaxtyping
import pytest

import deltaid

# All but the writer of machine code: its methods run for every instruction of every graph and see
# no arrays; checking them would take a third of the tests' time.
_PARTS = [part.name for part in pkgutil.iter_modules(deltaid.__path__) if part.name != "kernel"]
_CHECKED = [f"deltaid.{name}" for name in (*_PARTS, "kernel.batch")]
jaxtyping.install_import_hook(_CHECKED, "beartype.beartype")


@pytest.fixture(scope="session")
def irb360() -> deltaid.Dynamics:
    return deltaid.Dynamics(deltaid.load_robot("irb360-6-1600"))


@pytest.fixture(scope="session")
def clavel() -> deltaid.Dynamics:
    return deltaid.Dynamics(deltaid.load_robot("clavel-delta3"))
