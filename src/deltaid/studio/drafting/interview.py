"""Asking for a robot: each answer is checked at once, and groups of them against one another."""

from typing import Protocol, runtime_checkable

from deltaid.errors import DeltaidError
from deltaid.studio.drafting.draft import GIVEN, Draft
from deltaid.studio.drafting.drafts import require_group
from deltaid.studio.drafting.quantity import quantity
from deltaid.studio.drafting.questions import GROUPS, Group, Question, asked


@runtime_checkable
class Asker(Protocol):
    """Whoever answers."""

    def ask(self, question: Question, offer: tuple[float, str] | None) -> str:
        """An answer as it is written; empty to take what is offered."""
        ...

    def tell(self, error: DeltaidError) -> None:
        """What is wrong with the last answers."""
        ...


def interview(draft: Draft, asker: Asker | None = None) -> Draft:
    """A complete draft: what is not given is asked for, or assumed where nobody answers.

    Raises:
        DeltaidError: nobody answers, and numbers are missing, or do not go together.
    """
    if asker is None:
        draft.require_known()
        return require_group(require_group(draft, "lengths"), "workspace")
    for group in GROUPS:
        draft = _settled(draft, group, asker)
    return draft


def _settled(draft: Draft, group: Group, asker: Asker) -> Draft:
    """A group's answers, asked for again until they go together."""
    again = False
    while True:
        draft = _asked(draft, group, asker, again=again)
        try:
            return require_group(draft, group)
        except DeltaidError as error:
            if not _has(draft.kind, group):
                raise
            asker.tell(error)
            again = True


def _has(kind: str, group: Group) -> bool:
    return any(question.group == group for question in asked(kind))


def _asked(draft: Draft, group: Group, asker: Asker, *, again: bool) -> Draft:
    """The draft with answers to the questions of a group; again to those that have one too."""
    for question in asked(draft.kind):
        if question.group == group and (again or question.key not in draft.values):
            draft = draft.answered(question.key, *_one(draft, question, asker))
    return draft


def _one(draft: Draft, question: Question, asker: Asker) -> tuple[float, str]:
    """One answer and where it comes from."""
    key = question.key
    offer = draft.offer(question)
    if key in draft.values:  # asked again
        offer = draft.values[key], draft.origins[key]
    while True:
        text = asker.ask(question, offer).strip()
        if not text and offer is not None:
            return offer
        try:
            return question.require(quantity(text, question.unit, question.option)), GIVEN
        except DeltaidError as error:
            asker.tell(error)
