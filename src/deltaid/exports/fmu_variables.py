"""Variables of a functional mock-up unit: torques and motion with units and starts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deltaid.model.model import Model
from deltaid.robot.limits import UNITS

# Default speed [rad/s or m/s] below which Coulomb friction fades to zero.
FRICTION_SPEED = 0.01


# Task coordinates in words.
_TASK = {
    "x": "x of the platform point in the world",
    "y": "y of the platform point in the world",
    "z": "z of the platform point in the world",
    "psi": "turn of the tool about world z",
}


@dataclass(frozen=True)
class FmuVariable:
    """One real variable; its value reference is its index in the list.

    Attributes:
        causality: 'input', 'output', 'parameter', 'local', or 'independent' for the time.
        start: value before the first step; None for calculated variables.
        derivative_of: name of the variable that it is the derivative of.
        needs: names of the inputs and states that it directly depends on; None for all.
    """

    name: str
    causality: str
    unit: str
    description: str
    start: float | None = None
    derivative_of: str = ""
    needs: tuple[str, ...] | None = None

    @property
    def settable(self) -> bool:
        """Whether its value is set from outside or by the integrator."""
        return self.start is not None


@dataclass(frozen=True)
class Variables:
    """All variables of a unit.

    Attributes:
        groups: in order, by their names in the C code.
        states: number of continuous states.
    """

    groups: Mapping[str, tuple[FmuVariable, ...]]
    states: int = 0

    @property
    def all(self) -> tuple[FmuVariable, ...]:
        """The variables of all groups, concatenated."""
        return tuple(variable for group in self.groups.values() for variable in group)

    @property
    def places(self) -> dict[str, int]:
        """First index of each group."""
        ends = np.cumsum([len(group) for group in self.groups.values()]).tolist()
        return {n: end - len(g) for (n, g), end in zip(self.groups.items(), ends, strict=True)}

    def with_time(self) -> "Variables":
        """The variables with time, which FMI 3 lists."""
        time = FmuVariable("time", "independent", "s", "simulation time")
        return replace(self, groups={**self.groups, "TIME": (time,)})


def _per_drive(
    subject: Model,
    name: str,
    causality: str,
    words: str,
    unit: str = "{0.coordinate}",
    starts: Sequence[float] = (),
    needs: tuple[str, ...] | None = None,
) -> tuple[FmuVariable, ...]:
    """One variable per drive, with the drive's number in its description and the drive's units."""
    units = [unit.format(x).replace(" ", ".") for x in subject.robot.drive_units.values()]
    return tuple(
        FmuVariable(f"{name}{i}", causality, x, words.format(i), start, needs=needs)
        for i, (x, start) in enumerate(zip(units, starts or [None] * len(units), strict=True), 1)
    )


_EFFORT = ("torque or force of drive {} at the joint", "{0.force}")


def forward_variables(subject: Model) -> Variables:
    """The robot: inputs are torques and payload, outputs the motion; z and then q̇ are the
    states."""
    speed = FmuVariable(
        "friction_speed", "parameter", "",
        "rad/s or m/s below which dry friction fades in model exchange; co-simulation is exact",
        FRICTION_SPEED,
    )  # fmt: skip
    payload = FmuVariable("payload", "input", "kg",
        "mass that the tool holds; it comes and goes with the platform's velocity", 0.0,
    )  # fmt: skip
    z = tuple(
        FmuVariable(name, "output", UNITS[name], _TASK[name], float(start))
        for name, start in zip(subject.robot.task.names, subject.home, strict=True)
    )
    still = [0.0] * subject.dynamics.dof
    qd = _per_drive(subject, "qd", "output", "speed of drive {}", "{0.coordinate}/s", still)
    needs = tuple(variable.name for variable in (*z, *qd))
    dz, dqd = (
        tuple(
            FmuVariable(f"der({v.name})", "local", f"{v.unit}{per}", "", None, v.name, from_)
            for v in group
        )
        for group, per, from_ in ((z, "/s", needs), (qd, "2", None))
    )
    q = _per_drive(subject, "q", "output", "coordinate of drive {}", needs=needs[: len(z)])
    held = {"PAYLOAD": (payload,)} if subject.robot.load_carrier else {}
    of_motion = {"Z": z, "QD": qd, "DZ": dz, "DQD": dqd, "Q": q}
    tau = _per_drive(subject, "tau", "input", *_EFFORT, still)
    return Variables({"SPEED": (speed,), "TAU": tau, **held, **of_motion}, 2 * len(z))


def inverse_variables(subject: Model) -> Variables:
    """Inverse dynamics: inputs are the drives' motion, outputs torques and pose; no states."""
    home = subject.dynamics.kinematics.inverse(subject.home[None])[0].tolist()
    still = [0.0] * len(home)
    kinds = {"q": ("", "coordinate", home), "qd": ("/s", "speed", still),
             "qdd": ("/s2", "acceleration", still)}  # fmt: skip
    groups = {
        name.upper(): _per_drive(
            subject, name, "input", f"{words} of drive {{}}", f"{{0.coordinate}}{per}", starts
        )
        for name, (per, words, starts) in kinds.items()
    }
    q = tuple(variable.name for variable in groups["Q"])
    z = tuple(
        FmuVariable(name, "output", UNITS[name], _TASK[name], needs=q)
        for name in subject.robot.task.names
    )
    return Variables({**groups, "TAU": _per_drive(subject, "tau", "output", *_EFFORT), "Z": z})
