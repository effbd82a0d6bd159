"""A robot by a few numbers, each with where it comes from, before it is written down."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from deltaid.errors import DeltaidError
from deltaid.studio.drafting.questions import Question, asked

GIVEN, ASSUMED = "given", "assumed"


@dataclass(frozen=True)
class Draft:
    """What a description is written from.

    Attributes:
        kind: of robot, a key of `KINDS`.
        name, title: as in the description.
        values: numbers by the keys of the questions.
        origins: where each comes from: given, assumed, or the robot that it was taken from.
        offered: numbers of a robot to start from, which stand where nothing else is given.
        source: that robot.
        found: the workspace that the lengths reach, once it is known: found_radius, found_low, …
        found_for: the answers that it was found for.
    """

    kind: str
    name: str
    title: str
    values: Mapping[str, float] = field(default_factory=dict[str, float])
    origins: Mapping[str, str] = field(default_factory=dict[str, str])
    offered: Mapping[str, float] = field(default_factory=dict[str, float])
    source: str = ""
    found: Mapping[str, float] = field(default_factory=dict[str, float])
    found_for: Mapping[str, float] = field(default_factory=dict[str, float])

    def answered(self, key: str, value: float, origin: str) -> "Draft":
        """With one more answer."""
        values, origins = {**self.values, key: value}, {**self.origins, key: origin}
        return replace(self, values=values, origins=origins)

    def offer(self, question: Question) -> tuple[float, str] | None:
        """What stands where nothing is given, and where it comes from; None if nobody can guess."""
        if question.key in self.offered:
            return self.offered[question.key], f"from {self.source}"
        if question.assumed is None:
            return None
        guess = question.assumed(self.kind, {**self.values, **self.found})
        return min(max(guess, question.low), question.high), ASSUMED

    def completed(self) -> "Draft":
        """With what is offered or assumed of all that is not known yet.

        Raises:
            DeltaidError: there are numbers that nobody can guess.
        """
        self.require_known()
        draft = self
        for question in asked(self.kind):
            if question.key not in draft.values and (offer := draft.offer(question)) is not None:
                draft = draft.answered(question.key, *offer)
        return draft

    def require_known(self) -> None:
        """Refuse a draft that lacks what nobody can guess.

        Raises:
            DeltaidError: with the options that give it.
        """
        missing = [
            question.option
            for question in asked(self.kind)
            if question.assumed is None and question.key not in {**self.values, **self.offered}
        ]
        if missing:
            raise DeltaidError(
                f"a {self.kind} needs {', '.join(missing)}: nobody can guess "
                f"{'it' if len(missing) == 1 else 'them'}",
                where=f"--kind {self.kind}",
                cure="give them as options such as --strut 235mm, or run the command in a "
                "terminal, where it asks; --from NAME starts from a robot of the catalogue",
            )
