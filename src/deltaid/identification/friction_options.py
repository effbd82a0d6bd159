"""Friction laws near others: with one term more, with only some terms, with other constants."""

import numpy as np

from deltaid.model.friction_record import AdditionKind
from deltaid.robot.friction import EXPONENTS, Friction, PowerLaw, Stribeck

# First grids: exponents of the power law; Stribeck's speed as a share of the joint's own, and form.
_EXPONENTS = (0.25, 0.5, 0.75, 1.5, 2.0, 3.0)
_SPEEDS = tuple(np.geomspace(0.01, 1.0, 10).tolist())
_FORMS = (1.0, 2.0)

# By what they add, the laws that may be tried.
Options = dict[AdditionKind, list[Friction]]


def additions(law: Friction, speed: float, *, drive: bool) -> Options:
    """Laws with one more term; priors of the new coefficients come from the Coulomb prior."""
    c = law.coulomb

    def more(**terms: object) -> Friction:
        return law.changed(**terms)

    options: Options = {
        "offset": [more(offset=0.1 * c)],
        "both_ways": [more(viscous_back=law.viscous, coulomb_back=c)],
        "power": [
            more(power=PowerLaw(coefficient=0.3 * c / speed**e, exponent=e)) for e in _EXPONENTS
        ],
        "stribeck": [
            more(stribeck=Stribeck(coefficient=0.3 * c, speed=share * speed, exponent=form))
            for share in _SPEEDS
            for form in _FORMS
        ],
    }
    if drive:
        options["load"] = [more(load=0.05)]
    return options


def only(law: Friction, kinds: set[AdditionKind]) -> Friction:
    """A law's viscous and Coulomb terms and of the others only those of some kinds."""
    terms = {"both_ways": ("viscous_back", "coulomb_back")}
    names = [name for kind in kinds for name in terms.get(kind, (kind,))]
    return plain_law(law).changed(**{name: getattr(law, name) for name in names})


def remaining(law: Friction, options: Options, taken: AdditionKind) -> Options:
    """What may still be added to a law that has been extended.

    Laws with both directions have no offset, because both say the same.
    """
    barred = {taken, *({"offset", "both_ways"} if taken in ("offset", "both_ways") else ())}
    own = {
        name: value for name in type(law).model_fields if (value := getattr(law, name)) is not None
    }
    return {
        kind: [option.changed(**own) for option in laws]
        for kind, laws in options.items()
        if kind not in barred
    }


def neighbours(law: Friction, spacing: float) -> list[Friction]:
    """A law with its constants up to one spacing up and down."""
    factors = [spacing**share for share in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    powers, stribecks = [law.power], [law.stribeck]
    if (power := law.power) is not None:
        powers = [power.changed(exponent=_limited(power.exponent * f)) for f in factors]
    if (s := law.stribeck) is not None:
        stribecks = [
            s.changed(speed=s.speed * f, exponent=_limited(s.exponent * g))
            for f in factors
            for g in factors
        ]
    return [law.changed(power=p, stribeck=s) for p in powers for s in stribecks]


def _limited(exponent: float) -> float:
    return float(np.clip(exponent, *EXPONENTS))


def plain_law(law: Friction) -> Friction:
    """A law's viscous and Coulomb terms alone, the same both ways."""
    return Friction(viscous=law.viscous, coulomb=law.coulomb)
