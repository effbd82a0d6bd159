"""What recordings said by themselves as they were gathered, of all of them together: verdicts,
corrections, and the friction laws that they asked for."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from statistics import median

from deltaid.errors import RecordingError
from deltaid.factors.file import FactorFile
from deltaid.factors.keys import require_alike
from deltaid.factors.merged import ordered
from deltaid.model.corrections import Correction
from deltaid.model.record import Settings
from deltaid.model.verdict import KEYS, Grade, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_text import written

# What a fit to all recordings says for itself, and `torque_constants`.
_OF_FIT = ("friction", "prior", "load", "gain")
# Terms with constants of their own beside the coefficient.
_CURVED = {"power": ("exponent",), "stribeck": ("speed", "exponent"), "hess_soom": ("speed",)}


def prepared(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> tuple[list[FactorFile], RobotDescription]:
    """Files of a robot in an order of their own, and the robot with the friction laws to fit: those
    of the description, or joint by joint what most of its recordings asked for.

    Of as many recordings the simpler law is taken. Constants of its terms, such as Stribeck's
    speed, are the medians over the recordings that asked for it.

    Raises:
        RecordingError: files do not go together, or not with the robot.
    """
    require_alike(files, robot)
    files = ordered(files)
    if settings.friction != "choose":
        return files, robot
    asked = [file.record.model.robot.friction for file in files]
    laws = {
        joint: _usual([laws[joint] for laws in asked])
        for joint in robot.friction
        if all(joint in laws for laws in asked)
    }
    return files, robot.changed(friction=dict(robot.friction) | laws)


def _usual(laws: Sequence[Friction]) -> Friction:
    """The law that is asked for most."""
    kinds = Counter(_terms(law) for law in laws)
    terms = min(kinds, key=lambda kind: (-kinds[kind], len(kind), kind))
    own = [law for law in laws if _terms(law) == terms]
    found = min(own, key=lambda law: law.model_dump_json())
    for term in set(_CURVED).intersection(terms):
        values = {
            name: median(getattr(getattr(law, term), name) for law in own) for name in _CURVED[term]
        }
        found = found.changed(**{term: getattr(found, term).changed(**values)})
    return found


def _terms(law: Friction) -> tuple[str, ...]:
    return tuple(name for name, value in law if value is not None)


def verdicts(files: Sequence[FactorFile]) -> list[Verdict]:
    """Verdicts on recordings; of several each says which.

    What one of several does not show of the parameters, another may.
    """
    several, found = len(files) > 1, list[Verdict]()
    for file in files:
        for known in file.record.verdicts:
            if not (several and known.key in KEYS["the information"]):
                parts = (file.record.log if several else "", known.subject)
                subject = ": ".join(part for part in parts if part)
                found.append(replace(Verdict(**known.model_dump()), subject=subject))
    return found


def remarks(files: Sequence[FactorFile], gains: Sequence[Correction]) -> list[str]:
    """What is to be said of recordings: verdicts that are not good, warnings of the survey, and
    what factor files do not hold."""
    said = [verdict.sentence for verdict in verdicts(files) if verdict.grade is not Grade.GOOD]
    for file in files:
        said += file.record.warnings
        if file.record.model.sensors:
            names = ", ".join(sensor.name for sensor in file.record.model.sensors)
            said.append(
                f"{file.record.log}: factor files hold torques alone, so what {names} showed is "
                "not in this fit; identify the recording itself to have it"
            )
    said += [
        f"the torque constant of {gain.subject} was put right as recordings were gathered and "
        "counts as known here: intervals leave its own out"
        for gain in gains
    ]
    return said


def corrections(
    described: RobotDescription, chosen: RobotDescription, files: Sequence[FactorFile]
) -> list[Correction]:
    """What was corrected in each recording, and friction laws that most of them asked for."""
    found = [
        own if own.log else own.changed(log=file.record.log)
        for file in files
        for own in file.record.model.corrections
        if own.kind not in _OF_FIT
    ]
    for joint, law in chosen.friction.items():
        if law != described.friction[joint]:
            asked = [_terms(file.record.model.robot.friction[joint]) for file in files]
            text = (
                f"the law is now {written(law)}, no longer {written(described.friction[joint])}: "
                f"{asked.count(_terms(law))} of {len(files)} recordings ask for its terms by "
                "themselves"
            )
            found.append(Correction(kind="friction", subject=joint, text=text))
    return [*found, *torque_constants(files)]


def torque_constants(files: Sequence[FactorFile]) -> list[Correction]:
    """Torque constants that were corrected in all recordings alike; of each the surest.

    Raises:
        RecordingError: in some and not in others, or by factors that exclude each other.
    """
    gains: dict[str, list[tuple[FactorFile, Correction]]] = {}
    for file in files:
        for own in file.record.model.corrections:
            if own.kind == "gain":
                gains.setdefault(own.subject, []).append((file, own))
    for drive, found in sorted(gains.items()):
        (file, first), *others = found
        if len(found) < len(files):
            without = next(other for other in files if all(other is not own for own, _ in found))
            raise _contradiction(drive, file, f"and in {without.where} it was not")
        for other, own in others:
            if _exclude(first, own):
                raise _contradiction(
                    drive, file, f"by {first.value:.4g}, and in {other.where} by {own.value:.4g}"
                )
    return [
        min((own for _, own in found), key=lambda own: (own.high or 0.0) - (own.low or 0.0))
        for _, found in sorted(gains.items())
    ]


def _contradiction(drive: str, file: FactorFile, how: str) -> RecordingError:
    return RecordingError(
        f"the torque constant of {drive} was put right in this recording, {how}",
        where=file.where,
        cure="identify the recordings themselves together, or write the constant into the "
        "description and gather them again",
    )


def _exclude(one: Correction, other: Correction) -> bool:
    """Whether their intervals have nothing in common."""
    if None in (one.low, one.high, other.low, other.high):
        return one.value != other.value
    return (one.high or 0.0) < (other.low or 0.0) or (other.high or 0.0) < (one.low or 0.0)
