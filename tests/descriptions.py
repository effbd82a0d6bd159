"""The text of a description, changed, and the words with which it is refused."""

import pytest

from deltaid.errors import DescriptionError
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue_text, parse

CLAVEL = catalogue_text("clavel-delta3")


def refusal(text: str, model: type = RobotDescription) -> str:
    """The message with which a text is refused."""
    with pytest.raises(DescriptionError) as caught:
        parse(text, model, where="robot.yaml")
    assert str(caught.value).startswith("robot.yaml")
    return str(caught.value)


def replaced(old: str, new: str, text: str = CLAVEL) -> str:
    assert old in text
    return text.replace(old, new, 1)
