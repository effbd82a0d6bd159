"""What the short names of bodies stand for."""

import re

# Of bodies that several limbs have, each one.
_BODIES = {
    "U": "upper arm",
    "C": "carriage",
    "S": "strut",
    "P": "platform",
    "SB": "side bar",
    "MB": "middle bar",
    "MP": "main part",
    "R": "rod",
    "HP": "half platform",
    "TU": "upper telescope bar",
    "TL": "lower telescope bar",
    "EE": "end effector",
}
_NUMBERED = re.compile(r"([USC])(\d+)")


def body_in_words(name: str) -> str:
    """'upper arm' of U, 'upper arm 2' of U2; the name itself of a body of an own mechanism."""
    if numbered := _NUMBERED.fullmatch(name):
        return f"{_BODIES[numbered[1]]} {numbered[2]}"
    return _BODIES.get(name, name)
