"""Interview about a robot: each answer is checked at once, and each group for consistency."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Protocol, runtime_checkable

from deltaid.checks.at_rest import checked_workspace
from deltaid.checks.check import of_robot
from deltaid.checks.priors import checked_inertia, checked_priors
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.model.verdict import Grade, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import described_in
from deltaid.studio.drafting.draft import GIVEN, Draft, read_answer
from deltaid.studio.drafting.questions import (
    ARTICULATED,
    GROUPS,
    KINDS,
    Group,
    Question,
    answered,
    questions_of,
)
from deltaid.studio.drafting.text import written
from deltaid.studio.drafting.workspace import find_space, height
from deltaid.studio.steps import Step


@runtime_checkable
class Asker(Protocol):
    """A user interface that asks for answers."""

    def ask(self, question: Question, offer: tuple[float, str] | None) -> str:
        """An answer in a user's notation; empty to accept the offer."""
        ...

    def tell(self, error: DeltaidError) -> None:
        """Report what is wrong with the last answers."""
        ...


def interview(draft: Draft, asker: Asker | None = None) -> Draft:
    """A complete draft: missing numbers are asked for, or assumed if there is no asker.

    Raises:
        DeltaidError: numbers are missing without an asker, or are inconsistent.
    """
    if asker is None:
        draft.require_known()
        return require_group(require_group(draft, "lengths"), "workspace")
    for group in GROUPS:
        draft = _settled(draft, group, asker)
    return draft


def _settled(draft: Draft, group: Group, asker: Asker) -> Draft:
    """A group's answers, all asked again, including given ones, until they are consistent."""
    questions = [question for question in questions_of(draft.kind) if question.group == group]
    again = False
    while True:
        for question in questions:
            if again or question.key not in draft.values:
                draft = _answered(draft, question, asker)
        try:
            return require_group(draft, group)
        except DeltaidError as error:
            if not questions:
                raise
            asker.tell(error)
            again = True


def _answered(draft: Draft, question: Question, asker: Asker) -> Draft:
    offer = draft.offer(question)
    if question.key in draft.values:  # asked again
        offer = draft.values[question.key], draft.origins[question.key]
    while True:
        text = asker.ask(question, offer).strip()
        if not text and offer is not None:
            return draft.answered(question.key, *offer)
        try:
            return draft.answered(question.key, read_answer(question, text, question.option), GIVEN)
        except DeltaidError as error:
            asker.tell(error)


_SPACE = ("radius", "low", "high")
_RANGES = (("angle_low", "angle_high"), ("rail_low", "rail_high"), ("low", "high"))
# Size of the trial workspace before the search for the real one, as a share of the struts' length.
_FIRST = 0.02


def description(draft: Draft) -> RobotDescription:
    """The robot that a complete draft describes.

    Raises:
        DeltaidError: its numbers are inconsistent.
    """
    try:
        return described_in(written(draft), draft.name)
    except DescriptionError as error:  # refers to lines of a file that does not exist
        raise DeltaidError(
            re.sub(r"^line \d+, ", "", error.what), where="the answers", cure=_reach(draft)
        ) from None


def unusual(draft: Draft) -> tuple[str, ...]:
    """Doubts of `deltaid check` about a draft's masses, which may be right nevertheless."""
    verdicts = checked_inertia(description(draft))
    return tuple(f"{v.subject}: {v.seen}; {v.cure}" for v in verdicts if v.grade is not Grade.GOOD)


def require_group(draft: Draft, group: Group) -> Draft:
    """The draft if its answers so far are consistent, with values that follow from them.

    Masses that are unusual for a robot of its size are accepted; the machine may have them.

    Raises:
        DeltaidError: they are inconsistent, with the finding and the fix.
    """
    _require_ordered(draft.values)
    if group == "lengths" or (group == "tool" and draft.kind in ARTICULATED):
        return _with_space(draft)
    complete = (draft if group == "workspace" else _without_space(draft)).completed()
    if group == "workspace":
        _require_ordered(complete.values)
        _refuse(complete, of_robot(description(complete)))
        return complete
    if group == "masses":
        _refuse(complete, checked_priors(description(complete)))
    if group == "motors":
        limits = checked_workspace(description(complete))
        _refuse(complete, (verdict for verdict in limits if verdict.key == "torque-limit"))
    return draft


def _with_space(draft: Draft) -> Draft:
    """The draft with the robot's reach as assumed workspace.

    Raises:
        DeltaidError: the lengths are inconsistent, or nothing is within reach.
    """
    draft = _own_space(draft)
    bare = _without_space(draft)
    a = _with_reach(bare, 1.0, -2.0, -1.0).completed().values
    _require_ordered(a)
    middle, half = height(draft.kind, a), _FIRST * a["strut"]
    if middle <= 2 * half:
        raise DeltaidError(
            "the platform would stand beside or above its base, where no workspace is searched",
            where="--strut",
            cure="a longer strut, or rails that reach farther down",
        )
    trial = _with_reach(bare, half, -middle - half, -middle + half).completed()
    robot = description(trial)
    if robot.telescope is not None:
        # The assumed stroke follows from the workspace, not the other way round.
        robot = robot.changed(telescope=robot.telescope.changed(stroke=None))
    space = find_space(robot, middle, a["strut"])
    return _with_reach(draft, space.radius, *space.z)


def _own_space(draft: Draft) -> Draft:
    """The draft without the workspace of its source robot if other lengths were given."""
    keys = [question.key for question in questions_of(draft.kind) if question.group == "lengths"]
    if all(draft.values.get(k, draft.offered.get(k)) == draft.offered.get(k) for k in keys):
        return draft
    return replace(_without_space(draft), values=draft.values)


def _without_space(draft: Draft) -> Draft:
    return replace(
        draft,
        values={k: v for k, v in draft.values.items() if k not in _SPACE},
        offered={k: v for k, v in draft.offered.items() if k not in _SPACE},
    )


def _with_reach(draft: Draft, radius: float, low: float, high: float) -> Draft:
    return replace(draft, reach={"reach_radius": radius, "reach_low": low, "reach_high": high})


def _reach(draft: Draft) -> str:
    if not draft.reach:
        return "check the lengths"
    radius, low, high = (draft.reach[f"reach_{key}"] for key in _SPACE)
    return (
        f"these lengths reach a radius of {radius:g} m (--radius) between heights of {low:g} m "
        f"(--low) and {high:g} m (--high)"
    )


def _require_ordered(a: Mapping[str, float]) -> None:
    for low, high in _RANGES:
        if low in a and high in a and a[low] >= a[high]:
            raise DeltaidError(
                f"must be more than --{low.replace('_', '-')}, {a[low]:g}, and is {a[high]:g}",
                where=f"--{high.replace('_', '-')}",
            )


def _refuse(draft: Draft, verdicts: Iterable[Verdict]) -> None:
    """Raise an error for the first verdict that is not good, except on unusual masses."""
    for verdict in verdicts:
        unusual_mass = verdict.key == "prior-scale" and verdict.grade is Grade.DOUBTFUL
        if verdict.grade is not Grade.GOOD and not unusual_mass:
            more = _reach(draft) if verdict.key in ("workspace", "length-unit") else ""
            cure = "; ".join(filter(None, (verdict.cure, more)))
            raise DeltaidError(verdict.seen, where=verdict.subject, cure=cure)


def drafted(kind: str, name: str, answers: Mapping[str, str]) -> str:
    """The description of a robot as YAML; missing answers are assumed and marked so.

    Args:
        kind: a key of `KINDS`.
        name: of the robot.
        answers: texts such as '235 mm' by the keys of the questions.

    Raises:
        DeltaidError: an answer is invalid, a necessary one is missing, or they are inconsistent.
    """
    texts = answered(kind, answers)
    missing = [q.text for q in questions_of(kind) if q.assumed is None and q.key not in texts]
    if missing:
        raise DeltaidError(
            "still missing",
            where="; ".join(missing),
            cure="measure it, or look it up: nobody can guess",
        )
    draft = Draft(kind, name, KINDS[kind].split(",")[0])
    return written(interview(draft.answered_in_words(texts, lambda question: question.text)))


def new_step(kind: str, file: str, answers: Mapping[str, str]) -> Step:
    """A description of a user's own robot from a few numbers."""
    given = answered(kind, answers)
    options = [w for q in questions_of(kind) if q.key in given for w in (q.option, given[q.key])]
    known = {key: answers[key] for key in given}
    python = f"""\
from pathlib import Path

from deltaid.studio.drafting.interview import drafted

text = drafted({kind!r}, {file.partition(".")[0]!r}, {known!r})
Path({file!r}).write_text(text, encoding="utf-8")
"""
    return Step("new", ("new", file, "--kind", kind, *options, "--yes"), python)
