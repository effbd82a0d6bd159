"""Kinds of robots that can be asked for, and what each of them has."""

KINDS: dict[str, str] = {
    "delta": "Delta with three arms on motors, 3 axes",
    "delta-4": "Delta with three arms and a telescope bar that turns the tool, 4 axes",
    "h4": "H4: four arms, two side bars on a middle bar that turns, 4 axes",
    "i4": "I4: four arms, two half platforms on a slide, 4 axes",
    "par4": "Par4 (Quattro): four arms, a platform of four bars, 4 axes",
    "linear-delta": "Delta with three carriages on rails, 3 axes",
    "h4-linear": "H4 on rails, 4 axes",
    "i4-linear": "I4 on rails, 4 axes",
    "par4-linear": "Par4 on rails, 4 axes",
}


def is_linear(kind: str) -> bool:
    """Whether carriages drive it."""
    return "linear" in kind


def is_rotary(kind: str) -> bool:
    """Whether arms on motors drive it."""
    return not is_linear(kind)


def platform_of(kind: str) -> str:
    """Kind of platform: rigid, h4, i4 or par4."""
    head = kind.split("-")[0]
    return head if head in ("h4", "i4", "par4") else "rigid"


def limbs_of(kind: str) -> int:
    """Number of limbs, three or four."""
    return 3 if platform_of(kind) == "rigid" else 4


def is_articulated(kind: str) -> bool:
    """Whether its platform turns the tool."""
    return platform_of(kind) != "rigid"


def has_telescope(kind: str) -> bool:
    """Whether a telescope bar turns the tool."""
    return kind == "delta-4"


def turns(kind: str) -> bool:
    """Whether it turns a tool."""
    return has_telescope(kind) or is_articulated(kind)
