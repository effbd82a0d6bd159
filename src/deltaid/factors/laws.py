"""Friction laws of a robot, from those that its recordings asked for one by one."""

from collections import Counter
from collections.abc import Sequence
from statistics import median

from deltaid.factors.file import FactorFile
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction

# Terms with constants of their own beside the coefficient.
_CURVED = {"power": ("exponent",), "stribeck": ("speed", "exponent"), "hess_soom": ("speed",)}


def asked_for(robot: RobotDescription, files: Sequence[FactorFile]) -> RobotDescription:
    """The robot with, joint by joint, the law that most of its recordings asked for.

    Of as many recordings the simpler law is taken. Constants of its terms, such as Stribeck's
    speed, are the medians over the recordings that asked for it.
    """
    laws = {
        joint: _usual([one.record.model.robot.friction[joint] for one in files])
        for joint in robot.friction
        if all(joint in one.record.model.robot.friction for one in files)
    }
    return robot.changed(friction=dict(robot.friction) | laws)


def _usual(laws: Sequence[Friction]) -> Friction:
    """The law that is asked for most."""
    kinds = Counter(_terms(law) for law in laws)
    terms = min(kinds, key=lambda one: (-kinds[one], len(one), one))
    own = [law for law in laws if _terms(law) == terms]
    found = min(own, key=lambda law: law.model_dump_json())
    for term, names in _CURVED.items():
        if term in terms:
            values = {
                name: median(getattr(getattr(law, term), name) for law in own) for name in names
            }
            found = found.changed(**{term: getattr(found, term).changed(**values)})
    return found


def _terms(law: Friction) -> tuple[str, ...]:
    """Names of its terms."""
    return tuple(name for name, value in law if value is not None)
