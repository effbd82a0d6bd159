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
    laws = ((drive, *law) for drive in missing for law in _law(robot, drive).items())
    changes = tuple((f"friction.{drive}.{key}", value) for drive, key, value in laws)
    yield Verdict(
        "friction-missing",
        Grade.DOUBTFUL,
        f"no friction is described of {listed(missing)}",
        listed(missing),
        "left out of the description; a fit then puts the friction there is into masses and "
        "inertias",
        "describe it; its size is only a start, as the recording decides it",
        (Proposal("robot", changes),),
        number=float(len(missing)),
        unit="drives",
    )


def checked_limits(robot: RobotDescription) -> Iterable[Verdict]:
    """Whether limits are given, and what acts where they are not."""
    defaults = [key for key in _DEFAULTS if key not in robot.model_fields_set]
    limits = robot.drive_limits
    free = [drive for drive in robot.drives if drive not in limits or not limits[drive].effort]
    seen = [
        f"{key} is not given: {getattr(robot, key):g} {_DEFAULTS[key]} acts" for key in defaults
    ]
    if free:
        words = {robot.units(drive).effort for drive in free}
        seen.append(f"no {' or '.join(sorted(words))} limit of {listed(free)}")
    if not seen:
        speed, acceleration = robot.platform_speed, robot.platform_acceleration
        words = f"platform {speed:g} m/s, {acceleration:g} m/s²; effort of all drives"
        yield Verdict("limits-missing", Grade.GOOD, words)
        return
    yield Verdict(
        "limits-missing",
        Grade.DOUBTFUL,
        "; ".join(seen),
        listed(defaults + ["drive_limits"] * bool(free)),
        "left out of the description",
        "give what the machine may do before `deltaid excite` plans a motion: it goes to the "
        "limits that it knows; identification does not depend on them",
        number=float(len(seen)),
        unit="limits",
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
