"""A robot of one's own from a few numbers: what `deltaid new` asks for, as data of a form."""

from collections.abc import Mapping

from deltaid.errors import DeltaidError
from deltaid.studio.drafting.draft import Draft
from deltaid.studio.drafting.kinds import KINDS
from deltaid.studio.drafting.questions import Question, asked
from deltaid.studio.steps import Step


def drafted(kind: str, name: str, answers: Mapping[str, str]) -> str:
    """The description of a robot as YAML; what is not answered is assumed, and said so in it.

    Args:
        kind: a key of `KINDS`.
        name: of the robot.
        answers: texts such as '235 mm' by the keys of the questions.

    Raises:
        DeltaidError: an answer is none, something is missing, or they do not go together.
    """
    # The server knows this module and need not wait for those.
    from deltaid.studio.drafting.interview import interview
    from deltaid.studio.drafting.text import written

    given = _answered(kind, answers)
    missing = [
        question.text
        for question in asked(kind)
        if question.assumed is None and question not in given
    ]
    if missing:
        raise DeltaidError(
            "still missing",
            where="; ".join(missing),
            cure="measure it, or look it up: nobody can guess",
        )
    draft = Draft(kind, name, KINDS[kind].split(",")[0])
    texts = {question.key: text for question, text in given.items()}
    return written(interview(draft.answered_in_words(texts, lambda question: question.text)))


def new_step(kind: str, file: str, answers: Mapping[str, str]) -> Step:
    """The command that writes the same description."""
    given = _answered(kind, answers)
    options = [word for question, text in given.items() for word in (question.option, text)]
    known = {question.key: answers[question.key] for question in given}
    python = f"""\
from pathlib import Path

from deltaid.studio.describe import drafted

text = drafted({kind!r}, {file.partition(".")[0]!r}, {known!r})
Path({file!r}).write_text(text, encoding="utf-8")
"""
    arguments = ("new", file, "--kind", kind, *options, "--yes")
    return Step("new", arguments, python, (), (file,))


def _answered(kind: str, answers: Mapping[str, str]) -> dict[Question, str]:
    """Questions that have an answer, and what was written."""
    texts = {question: answers.get(question.key, "").strip() for question in asked(kind)}
    return {question: text for question, text in texts.items() if text}
