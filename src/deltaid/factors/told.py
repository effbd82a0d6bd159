"""What recordings said by themselves as they were gathered, told of all of them together."""

from collections import Counter
from collections.abc import Sequence

from deltaid.errors import RecordingError
from deltaid.factors.file import FactorFile
from deltaid.factors.record import SeenVerdict
from deltaid.model.corrections import Correction
from deltaid.model.verdict import KEYS, Grade, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_text import written

# What a fit to all recordings says for itself, and what `torque_constants` tells.
_OF_FIT = ("friction", "prior", "load", "gain")


def verdicts(files: Sequence[FactorFile]) -> list[Verdict]:
    """Verdicts on recordings; of several each says which.

    What one of several does not tell about the parameters, another may.
    """
    several, found = len(files) > 1, list[Verdict]()
    for one in files:
        for seen in one.record.verdicts:
            if not (several and seen.key in KEYS["the information"]):
                found.append(_verdict(seen, one.record.log if several else ""))
    return found


def _verdict(seen: SeenVerdict, log: str) -> Verdict:
    return Verdict(
        key=seen.key,
        grade=Grade(seen.grade),
        seen=seen.seen,
        subject=": ".join(part for part in (log, seen.subject) if part),
        cause=seen.cause,
        cure=seen.cure,
        number=seen.number,
        unit=seen.unit,
    )


def remarks(files: Sequence[FactorFile], gains: Sequence[Correction]) -> list[str]:
    """What is to be said of recordings: verdicts that are not good, warnings of the survey, and
    what factor files do not hold."""
    said = [one.sentence for one in verdicts(files) if one.grade is not Grade.GOOD]
    for one in files:
        said += one.record.warnings
        if one.record.model.sensors:
            names = ", ".join(sensor.name for sensor in one.record.model.sensors)
            said.append(
                f"{one.record.log}: factor files hold torques alone, so what {names} showed is "
                "not in this fit; identify the recording itself to have it"
            )
    said += [
        f"the torque constant of {one.subject} was put right as recordings were gathered and "
        "counts as known here: intervals leave its own out"
        for one in gains
    ]
    return said


def corrections(
    described: RobotDescription, chosen: RobotDescription, files: Sequence[FactorFile]
) -> list[Correction]:
    """What was put right in each recording, and friction laws that most of them asked for."""
    found = [
        one if one.log else one.changed(log=file.record.log)
        for file in files
        for one in file.record.model.corrections
        if one.kind not in _OF_FIT
    ]
    return [*found, *_laws(described, chosen, files), *torque_constants(files)]


def _laws(
    described: RobotDescription, chosen: RobotDescription, files: Sequence[FactorFile]
) -> list[Correction]:
    found = list[Correction]()
    for joint, law in chosen.friction.items():
        if law == described.friction[joint]:
            continue
        terms = _terms(law)
        asking = sum(terms == _terms(one.record.model.robot.friction[joint]) for one in files)
        found.append(
            Correction(
                kind="friction",
                subject=joint,
                text=f"the law is now {written(law)}, no longer "
                f"{written(described.friction[joint])}: {asking} of {len(files)} recordings ask "
                "for its terms by themselves",
            )
        )
    return found


def _terms(law: object) -> frozenset[str]:
    return frozenset(name for name, value in vars(law).items() if value is not None)


def torque_constants(files: Sequence[FactorFile]) -> list[Correction]:
    """Torque constants that were put right in all recordings alike.

    Raises:
        RecordingError: in some and not in others, or by factors that exclude each other.
    """
    by_file = [
        {one.subject: one for one in file.record.model.corrections if one.kind == "gain"}
        for file in files
    ]
    counts = Counter(drive for own in by_file for drive in own)
    found = list[Correction]()
    for drive, count in sorted(counts.items()):
        own = [(file, one[drive]) for file, one in zip(files, by_file, strict=True) if drive in one]
        file, first = own[0]
        if count < len(files):
            other = next(file for file, one in zip(files, by_file, strict=True) if drive not in one)
            _refuse(drive, file, f"and in {other.path or other.record.log} it was not")
        for other, one in own[1:]:
            if _apart(first, one):
                where = other.path or other.record.log
                _refuse(drive, file, f"by {first.value:.4g}, and in {where} by {one.value:.4g}")
        found.append(min((one for _, one in own), key=_width))
    return found


def _refuse(drive: str, file: FactorFile, how: str) -> None:
    raise RecordingError(
        f"the torque constant of {drive} was put right in this recording, {how}",
        where=file.path or file.record.log,
        cure="identify the recordings themselves together, or write the constant into the "
        "description and gather them again",
    )


def _apart(one: Correction, other: Correction) -> bool:
    """Whether their intervals have nothing in common."""
    ends = (one.low, one.high, other.low, other.high)
    if any(end is None for end in ends):
        return one.value != other.value
    low, high, other_low, other_high = (float(end or 0.0) for end in ends)
    return high < other_low or other_high < low


def _width(one: Correction) -> float:
    return (one.high or 0.0) - (one.low or 0.0)
