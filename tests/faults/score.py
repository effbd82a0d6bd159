"""Whether the verdicts on a case are right."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from deltaid.checks.check import check
from deltaid.errors import DescriptionError
from deltaid.model.verdict import Grade, Verdict
from deltaid.robot.load import load_robot
from faults.case import Case

_SAID = (Grade.DOUBTFUL, Grade.WRONG)


@dataclass(frozen=True)
class Score:
    """Score of the verdicts on a case.

    Attributes:
        right: whether the expected cause is reported for the expected drive, and no other verdict
            is wrong; for a clean case, whether no verdict is doubtful or wrong.
        said: keys of verdicts worse than good, each with its grade.
        graver: whether an unexpected verdict is wrong.
    """

    right: bool
    said: tuple[tuple[str, str], ...]
    graver: bool


def said_of(case: Case) -> tuple[Verdict, ...]:
    """All verdicts: only on the description if it has the fault, else on the recording too.

    An error about millimetres counts as a verdict.
    """
    if not case.data:
        return check(case.robot, case.table)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(json.dumps(case.data), encoding="utf-8")
        try:
            return check(load_robot(file))
        except DescriptionError as error:
            if "metres" not in f"{error.what} {error.cure}":
                raise
            return (Verdict("length-unit", Grade.WRONG, error.what, error.where, "", error.cure),)


def score(case: Case, found: Sequence[Verdict]) -> Score:
    """Compare verdicts with those that are right."""
    bad = [verdict for verdict in found if verdict.grade in _SAID]
    said = tuple((v.key, str(v.grade)) for v in found if v.grade is not Grade.GOOD)
    stray = [v for v in bad if v.key not in (*case.keys, *case.related)]
    graver = any(verdict.grade is Grade.WRONG for verdict in stray)
    if not case.keys:
        return Score(not bad, said, graver)
    hit = any(v.key in case.keys and _about(v, case.subject) for v in bad)
    return Score(hit and not graver, said, graver)


def _about(verdict: Verdict, subject: str) -> bool:
    """Whether a verdict names a drive: as its subject, or in its text if it has no subject."""
    if not subject or subject in verdict.subject:
        return True
    return not verdict.subject and subject in f"{verdict.seen} {verdict.cause}"
