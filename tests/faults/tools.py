"""Helpers for kinds of fault: their registration, and small changes of a case."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from faults.case import Case
from oracle.tree import Array

Change = Callable[[Case, np.random.Generator], Case]


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    Attributes:
        change: adds the fault to a case; draws the same random numbers whatever the case's noise.
        keys: verdicts of which any is right.
        related: verdicts that follow from the fault and are accepted.
        hides: whether parameters and noise may hide a small fault.
    """

    change: Change
    keys: tuple[str, ...]
    related: tuple[str, ...] = ()
    hides: bool = False


def kind(
    *keys: str, related: tuple[str, ...] = (), hides: bool = False
) -> Callable[[Change], Kind]:
    """Make a kind of fault from a function that adds it to a case."""

    def kind_of(change: Change) -> Kind:
        return Kind(change, keys, related, hides)

    return kind_of


class ImpossibleError(Exception):
    """Error for a robot or a recording that cannot have a fault."""


def drives(case: Case) -> tuple[str, ...]:
    """Names of a robot's drives."""
    return case.robot.drives


def random_drive(case: Case, rng: np.random.Generator) -> int:
    """Index of a random drive."""
    return int(rng.integers(len(drives(case))))


def scaled(case: Case, name: str, factors: Array | float) -> dict[str, Array]:
    """The columns with one quantity times a factor for each drive."""
    return dict(case.columns) | {name: case.columns[name] * factors}


def only(case: Case, drive: int, factor: float) -> Array:
    """A factor for one drive and 1 for the others."""
    return np.where(np.arange(len(drives(case))) == drive, factor, 1.0)


def rotary(case: Case) -> Array:
    """Whether each drive is rotary."""
    return np.array([not case.robot.is_linear(drive) for drive in drives(case)])


def recorded(case: Case, **changes: Any) -> Case:
    """The case with a changed setting, recorded anew."""
    setting = replace(case.setting, **changes)
    return replace(case, setting=setting, columns=setting.sensed())


def with_velocity(case: Case) -> Case:
    """The case with recorded velocities."""
    return case if "qd" in case.columns else recorded(case, velocity=True)


def replanted(case: Case, **changes: Any) -> Case:
    """The case with another true robot on the same path.

    Raises:
        ImpossibleError: the robot cannot reach the path.
    """
    plant = case.setting.plant
    oracle = replace(plant.oracle, **changes)
    if not np.all(np.isfinite(oracle.positions(plant.path))):
        raise ImpossibleError("the path leaves the workspace")
    return recorded(case, plant=replace(plant, oracle=oracle))


def permutation(case: Case, rng: np.random.Generator) -> Array:
    """A wrong order of the drives."""
    order = np.arange(len(drives(case)))
    while np.all(order == np.arange(len(order))):
        order = rng.permutation(len(order))
    return order


def some(case: Case, rng: np.random.Generator) -> tuple[Array, str]:
    """Mask and name of a random drive, or of all drives with an empty name."""
    if rng.uniform() < 0.5:
        return np.ones(len(drives(case)), bool), ""
    drive = random_drive(case, rng)
    return np.arange(len(drives(case))) == drive, drives(case)[drive]
