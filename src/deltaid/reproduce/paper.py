"""What the paper reports of its surrogate (Sec. VII), to stand beside our own numbers."""

from dataclasses import dataclass

from deltaid.reproduce.accuracy import Accuracy


@dataclass(frozen=True)
class Claim:
    """A number of the paper.

    Attributes:
        quantity: of what.
        share: as a number.
        words: as the paper has it.
        place: where in the paper.
    """

    quantity: str
    share: float
    words: str
    place: str

    def of(self, found: Accuracy) -> float:
        """The same quantity of one of our results, the largest over all drives."""
        return _QUANTITIES[self.quantity](found)


_QUANTITIES = {
    "M on the diagonal": lambda a: a.mass_diagonal,
    "M off the diagonal": lambda a: a.mass_off_diagonal,
    "Coriolis C q̇": lambda a: float(a.coriolis.max()),
    "acceleration M q̈": lambda a: float(a.acceleration.max()),
    "friction coefficients": lambda a: a.friction_coefficients,
}

MASS_DIAGONAL = Claim("M on the diagonal", 0.01, "below 1 %", "Sec. VII, at Fig. 4")
MASS_OFF_DIAGONAL = Claim("M off the diagonal", 0.02, "about 2 %", "Sec. VII, at Fig. 4")
CORIOLIS = Claim("Coriolis C q̇", 0.01, "less than 1 %", "Sec. VII, at Figs. 5 and 6")
ACCELERATION = Claim("acceleration M q̈", 0.01, "less than 1 %", "Sec. VII, at Figs. 5 and 6")
FRICTION = Claim("friction coefficients", 0.022, "under 2.2 %", "Sec. VII, at Fig. 3")

CLAIMS = (MASS_DIAGONAL, MASS_OFF_DIAGONAL, CORIOLIS, ACCELERATION, FRICTION)
