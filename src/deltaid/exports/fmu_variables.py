"""The variables of a functional mock-up unit."""

from dataclasses import dataclass

import numpy as np

from deltaid.model.model import Model
from deltaid.robot.task import UNITS

# Speed [rad/s or m/s] below which Coulomb friction fades, where the user sets no other.
FRICTION_SPEED = 0.01

# What task coordinates are, by name.
_TASK = {
    "x": "x of the platform point in the world",
    "y": "y of the platform point in the world",
    "z": "z of the platform point in the world",
    "psi": "turn of the tool about world z",
}


@dataclass(frozen=True)
class FmuVariable:
    """One real variable; its value reference is its place in the list.

    Attributes:
        causality: 'input', 'output', 'parameter', 'local', or 'independent' for the time.
        start: value before the first step; None for what is calculated.
        derivative_of: place of the variable that it is the derivative of.
        needs: places of the inputs and states that it follows from without delay; None for all.
    """

    name: str
    causality: str
    unit: str
    description: str
    start: float | None = None
    derivative_of: int | None = None
    needs: tuple[int, ...] | None = None

    @property
    def settable(self) -> bool:
        """Whether its value comes from outside or from the integrator."""
        return self.start is not None


@dataclass(frozen=True)
class Variables:
    """All variables of a unit.

    Attributes:
        places: where groups begin, by the name that the C code gives them.
        states: number of continuous states.
    """

    all: tuple[FmuVariable, ...]
    places: dict[str, int]
    states: int

    def with_time(self) -> "Variables":
        """These and the time, which is a variable in FMI 3."""
        time = FmuVariable("time", "independent", "s", "simulation time")
        return Variables((*self.all, time), self.places | {"TIME": len(self.all)}, self.states)


class _List:
    """Variables in the order in which they are added."""

    def __init__(self, subject: Model) -> None:
        linear = [subject.robot.is_linear(drive) for drive in subject.robot.drives]
        self.drives = [("m", "N") if slides else ("rad", "N.m") for slides in linear]
        self.task = [(name, UNITS[name]) for name in subject.robot.task.names]
        self.all: list[FmuVariable] = []
        self.places: dict[str, int] = {}

    def add(self, place: str, variables: list[FmuVariable]) -> range:
        """Append a group; returns its places."""
        self.places[place] = len(self.all)
        self.all += variables
        return range(self.places[place], len(self.all))


def carrier(subject: Model) -> str:
    """The body that holds a payload; empty where a mechanism of one's own has neither EE nor P."""
    return next((name for name in ("EE", "P") if name in subject.layout.bodies), "")


def forward_variables(subject: Model) -> Variables:
    """The robot: torques and payload in, motion out; z and then q̇ are the states."""
    found, home = _List(subject), subject.home
    found.add("SPEED", [FmuVariable(
        "friction_speed", "parameter", "",
        "rad/s or m/s below which dry friction fades in model exchange; co-simulation is exact",
        FRICTION_SPEED,
    )])  # fmt: skip
    found.add("TAU", [
        FmuVariable(f"tau{i}", "input", force, f"torque or force of drive {i} at the joint", 0.0)
        for i, (_, force) in enumerate(found.drives, 1)
    ])  # fmt: skip
    if carrier(subject):
        held = "mass that the tool holds; it comes and goes with the platform's velocity"
        found.add("PAYLOAD", [FmuVariable("payload", "input", "kg", held, 0.0)])
    z = found.add("Z", [
        FmuVariable(name, "output", unit, _TASK[name], float(start))
        for (name, unit), start in zip(found.task, home, strict=True)
    ])  # fmt: skip
    qd = found.add("QD", [
        FmuVariable(f"qd{i}", "output", f"{unit}/s", f"speed of drive {i}", 0.0)
        for i, (unit, _) in enumerate(found.drives, 1)
    ])  # fmt: skip
    found.add("DZ", [
        FmuVariable(f"der({found.all[k].name})", "local", f"{found.all[k].unit}/s", "",
                 derivative_of=k, needs=(*z, *qd))
        for k in z
    ])  # fmt: skip
    found.add("DQD", [
        FmuVariable(f"der({found.all[k].name})", "local", f"{found.all[k].unit}2", "",
                 derivative_of=k)
        for k in qd
    ])  # fmt: skip
    found.add("Q", [
        FmuVariable(f"q{i}", "output", unit, f"coordinate of drive {i}", needs=tuple(z))
        for i, (unit, _) in enumerate(found.drives, 1)
    ])  # fmt: skip
    return Variables(tuple(found.all), found.places, 2 * len(home))


def inverse_variables(subject: Model) -> Variables:
    """Inverse dynamics: the drives' motion in, torques and pose out; no states."""
    found = _List(subject)
    home = np.asarray(subject.dynamics.kinematics.inverse(subject.home[None])[0])
    groups = (("Q", "q", "", "coordinate", home), ("QD", "qd", "/s", "speed", 0 * home),
              ("QDD", "qdd", "/s2", "acceleration", 0 * home))  # fmt: skip
    for place, name, per, words, starts in groups:
        found.add(place, [
            FmuVariable(
                f"{name}{i}", "input", f"{unit}{per}", f"{words} of drive {i}", float(start)
            )
            for i, ((unit, _), start) in enumerate(zip(found.drives, starts, strict=True), 1)
        ])  # fmt: skip
    q = tuple(range(len(home)))
    found.add("TAU", [
        FmuVariable(f"tau{i}", "output", force, f"torque or force of drive {i} at the joint")
        for i, (_, force) in enumerate(found.drives, 1)
    ])  # fmt: skip
    found.add("Z", [
        FmuVariable(name, "output", unit, _TASK[name], needs=q) for name, unit in found.task
    ])  # fmt: skip
    return Variables(tuple(found.all), found.places, 0)
