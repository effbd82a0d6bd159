"""Friction laws in words, for terminals and reports."""

from deltaid.robot.friction import Friction


def written(law: Friction) -> str:
    """A law as its terms, constants in brackets: 'viscous + Coulomb + Stribeck (0.3 rad/s, …)'."""
    terms = ["viscous + Coulomb"]
    if not law.both_ways:
        terms = ["viscous + Coulomb, each direction its own"]
    if law.offset is not None:
        terms.append("offset")
    if law.power is not None:
        terms.append(f"|speed|^{law.power.exponent:.3g}")
    if law.stribeck is not None:
        s = law.stribeck
        terms.append(f"Stribeck (speed {s.speed:.3g}, exponent {s.exponent:.3g})")
    if law.load is not None:
        terms.append("share of the torque")
    return " + ".join(terms)
