"""What a joint's friction law may get: further terms and other constants, each in several forms."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deltaid.effects.joint import (
    FrictionJoint,
    Shape,
    of_load,
    of_slope,
    of_term,
    one_way,
    one_way_speed,
)
from deltaid.identification.friction_rows import FrictionRows
from deltaid.model.friction_record import AdditionKind, JointTerm
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, PowerLaw, Stribeck
from deltaid.robot.friction_terms import friction_terms

# First grids: exponents of the power law; Stribeck's speed as a share of the joint's own, and form.
_EXPONENTS = (0.25, 0.5, 0.75, 1.5, 2.0, 3.0)
_SPEEDS = tuple(np.geomspace(0.01, 1.0, 10).tolist())
FORMS = (1.0, 2.0)
# Size of a further term as a share of Coulomb's, before anything is known of it; a share of load.
_SIZE, _LOAD = 0.3, 0.05
# Shares of a rotor's inertia that may be its link's, as torques show their sum only and losses what
# the gear carries; below zero the other way.
_SHARES = (0.0, -1.0, -0.5, 0.25, 0.5, 0.75, 1.0)

_SHAPES: dict[AdditionKind, tuple[Shape, ...]] = {
    "offset": (one_way,),
    "both_ways": (one_way, one_way_speed),
    "load": (of_load,),
}


@dataclass(frozen=True, eq=False)
class Variant:
    """One form of an addition to a joint's law; of a described term, other constants."""

    joint: FrictionJoint
    kind: AdditionKind
    more: dict[str, Any]  # what the law gets, as keys of `Friction`
    shapes: tuple[Shape, ...]  # of the columns that show it
    constants: int  # how many are chosen with it, beside its coefficients
    positive: bool  # whether its coefficient must be

    @property
    def term(self) -> JointTerm:
        return self.joint.name, self.kind


def options(rows: FrictionRows) -> Iterator[list[Variant]]:
    """All additions to the laws of the robot, each with its variants."""
    robot, names = rows.dynamics.robot, rows.dynamics.layout.names
    for joint in rows.joints.values():
        law, rotor = robot.friction[joint.name], f"rotor.{joint.name}"
        for kind, changes in _changes(joint, law).items():
            joints = [joint]
            if kind == "load" and rotor in names:
                inertia = float(rows.p[names.index(rotor)])
                joints = [replace(joint, moved=share * inertia) for share in _SHARES]
            constants = min(len(joints) * len(changes) - 1, 2 if kind == "stribeck" else 1)
            positive = kind in ("load", "power", "stribeck") and changes != [{}]
            laws = [(more, law.changed(**more)) for more in changes]
            yield [
                Variant(joint, kind, more, shapes_of(robot, joint.name, changed, kind),
                        constants, positive)
                for joint in joints for more, changed in laws
            ]  # fmt: skip


def _changes(joint: FrictionJoint, law: Friction) -> dict[AdditionKind, list[dict[str, Any]]]:
    """Forms of what a law may get, as keys of `Friction`; none where constants are others."""
    c, changes = law.coulomb, dict[AdditionKind, list[dict[str, Any]]]()
    if joint.drive is not None and law.both_ways:
        if law.offset is None:
            changes["offset"] = [{"offset": 0.1 * c}]
        changes["both_ways"] = [{"viscous_back": law.viscous, "coulomb_back": c, "offset": None}]
    if joint.drive is not None and law.load is None:
        changes["load"] = [{"load": _LOAD}]
    changes["power"] = [{}] if law.power else [
        {"power": PowerLaw(coefficient=_SIZE * c / joint.fastest**e, exponent=e)}
        for e in _EXPONENTS
    ]  # fmt: skip
    if law.stribeck or not law.hess_soom:
        changes["stribeck"] = [{}] if law.stribeck else [
            {"stribeck": Stribeck(
                coefficient=_SIZE * c, speed=share * joint.fastest, exponent=form)}
            for share in _SPEEDS for form in FORMS
        ]  # fmt: skip
    return changes


def shapes_of(
    robot: RobotDescription, joint: str, law: Friction, kind: AdditionKind
) -> tuple[Shape, ...]:
    """What shows an addition in a law: its terms, or slopes by constants of a described one."""
    if kind in _SHAPES:
        return _SHAPES[kind]
    terms = friction_terms({joint: (law, robot.units(joint))})
    term = next(term for term in terms if term.kind == kind)
    if getattr(robot.friction[joint], kind) is None:
        return (of_term(term),)
    return tuple(of_slope(term, name) for name in term.constants)
