"""The friction laws of a robot that most of its recordings ask for."""

from collections import Counter
from collections.abc import Sequence
from statistics import median

from deltaid.fleets.recording_brief import RecordingBrief
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction

# Terms with constants of their own beside the coefficient.
_CURVED = {"power": ("exponent",), "stribeck": ("speed", "exponent"), "hess_soom": ("speed",)}


def with_laws(
    robot: RobotDescription, briefs: Sequence[RecordingBrief], settings: Settings
) -> RobotDescription:
    """The robot with the friction laws to fit: those of the description, or joint by joint what
    most of its recordings asked for, of as many the simpler law. Constants of its terms, such as
    Stribeck's speed, are the medians over the recordings that asked for it."""
    if settings.friction != "choose":
        return robot
    laws = {
        joint: _usual([brief.friction[joint] for brief in briefs])
        for joint in robot.friction
        if all(joint in brief.friction for brief in briefs)
    }
    return robot.changed(friction=dict(robot.friction) | laws)


def _usual(laws: Sequence[Friction]) -> Friction:
    """The most frequent law."""
    kinds = Counter(terms_of(law) for law in laws)
    terms = min(kinds, key=lambda kind: (-kinds[kind], len(kind), kind))
    same = [law for law in laws if terms_of(law) == terms]
    law = min(same, key=lambda law: law.model_dump_json())
    for term in set(_CURVED).intersection(terms):
        own = [getattr(law, term) for law in same]
        values = {name: median(getattr(part, name) for part in own) for name in _CURVED[term]}
        law = law.changed(**{term: getattr(law, term).changed(**values)})
    return law


def terms_of(law: Friction) -> tuple[str, ...]:
    """Names of a law's terms."""
    return tuple(name for name, value in law if value is not None)
