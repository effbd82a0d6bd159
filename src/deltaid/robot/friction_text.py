"""Friction laws in words, for terminals and reports."""

from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import friction_terms
from deltaid.robot.joint_units import TURNING

# Said together, for all laws have them.
_PLAIN = ("viscous", "coulomb", "viscous_back", "coulomb_back")


def written(law: Friction) -> str:
    """A law as its terms, constants in brackets: 'viscous + Coulomb + Stribeck (0.3 rad/s, …)'."""
    plain = "viscous + Coulomb" if law.both_ways else "viscous + Coulomb, each direction its own"
    terms = friction_terms({"": (law, TURNING)})
    return " + ".join([plain, *(term.words for term in terms if term.kind not in _PLAIN)])
