"""What a description leaves out: friction and limits."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed
from deltaid.robot.description import RobotDescription

# A start for friction that nobody has measured: Coulomb friction as a share of the torque that
# gravity asks for, and the speed [rad/s or m/s] at which viscous friction is as large.
_SHARE, _SPEED = 0.1, {False: 3.0, True: 0.5}
_DEFAULTS = {"platform_speed": "m/s", "platform_acceleration": "m/s²"}


def checked_friction(robot: RobotDescription) -> Iterable[Verdict]:
    """Whether every drive has a friction law."""
    missing = [drive for drive in robot.drives if drive not in robot.friction]
    if not missing:
        seen = f"described of {listed(robot.friction_joints)}"
        yield Verdict("friction-missing", Grade.GOOD, seen)
        return
    laws = {drive: _law(robot, drive) for drive in missing}
    changes = tuple(
        (f"friction.{drive}.{key}", value)
        for drive, law in laws.items()
        for key, value in law.items()
    )
    yield Verdict(
        "friction-missing",
        Grade.DOUBTFUL,
        f"no friction is described of {listed(missing)}",
        subject=listed(missing),
        cause="left out of the description; a fit then puts the friction there is into masses and "
        "inertias",
        cure="describe it; its size is only a start, as the recording decides it",
        proposals=(Proposal("robot", changes),),
        number=float(len(missing)),
        unit="drives",
    )


def checked_limits(robot: RobotDescription) -> Iterable[Verdict]:
    """Whether limits are given, and what acts where they are not."""
    defaults = [key for key in _DEFAULTS if key not in robot.model_fields_set]
    free = [
        d for d in robot.drives if d not in robot.drive_limits or not robot.drive_limits[d].effort
    ]
    seen = [
        f"{key} is not given: {getattr(robot, key):g} {_DEFAULTS[key]} acts" for key in defaults
    ]
    if free:
        words = {robot.units(drive).effort for drive in free}
        seen.append(f"no {' or '.join(sorted(words))} limit of {listed(free)}")
    if seen:
        yield Verdict(
            "limits-missing",
            Grade.DOUBTFUL,
            "; ".join(seen),
            subject=listed(defaults + ["drive_limits"] * bool(free)),
            cause="left out of the description",
            cure="give what the machine may do before `deltaid excite` plans a motion: it goes to "
            "the limits that it knows; identification does not depend on them",
            number=float(len(seen)),
            unit="limits",
        )
        return
    yield Verdict(
        "limits-missing",
        Grade.GOOD,
        f"platform {robot.platform_speed:g} m/s, {robot.platform_acceleration:g} m/s²; effort of "
        "all drives",
    )


def _law(robot: RobotDescription, drive: str) -> dict[str, Any]:
    """Friction of another drive that is alike; else by the torque that gravity asks for."""
    kind = robot.is_linear(drive)
    for other in robot.drives:
        alike = robot.is_linear(other) == kind and (other == "drive4") == (drive == "drive4")
        if other in robot.friction and (alike or robot.platform_turns):
            law = robot.friction[other]
            return {"viscous": law.viscous, "coulomb": law.coulomb}
    dynamics = compiled(robot)
    home, still = dynamics.kinematics.home[None], np.zeros((1, dynamics.dof))
    torque = np.abs(dynamics.torque(home, still, still, prior_parameters(robot))[0]).max()
    coulomb = float(f"{_SHARE * torque:.2g}") or 0.1
    return {"viscous": float(f"{coulomb / _SPEED[kind]:.2g}"), "coulomb": coulomb}
