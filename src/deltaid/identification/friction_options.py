"""What may be added to a joint's friction law, and the columns that would show it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deltaid.effects.joint import Joint, Shape, of_load, one_way, one_way_speed
from deltaid.identification.friction_rows import FrictionRows
from deltaid.model.friction_record import AdditionKind
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, PowerLaw, Stribeck
from deltaid.robot.friction_terms import TERM_OF, FrictionTerm, friction_terms

# First grids: exponents of the power law; Stribeck's speed as a share of the joint's own, and form.
_EXPONENTS = (0.25, 0.5, 0.75, 1.5, 2.0, 3.0)
_SPEEDS = tuple(np.geomspace(0.01, 1.0, 10).tolist())
FORMS = (1.0, 2.0)
# Size of a further term as a share of Coulomb's, before anything is known of it; a share of load.
_SIZE, _LOAD = 0.3, 0.05
# Shares of a rotor's inertia that may be its link's; below zero the other way.
_SHARES = (0.0, -1.0, -0.5, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, eq=False)
class Variant:
    """One form of an addition.

    Attributes:
        columns: positions of its columns among those of all options.
        more: what the law gets: keys of `Friction`.
        moved: inertia of the rotor that its gear is taken to carry.
    """

    columns: tuple[int, ...]
    more: dict[str, Any]
    moved: float = 0.0


@dataclass(frozen=True, eq=False)
class Option:
    """One kind of addition to one joint's law.

    Attributes:
        joint, kind: which.
        variants: forms that it may have.
        constants: how many constants are chosen with the form, beside its coefficients.
        positive: whether its coefficient must be.
    """

    joint: str
    kind: AdditionKind
    variants: tuple[Variant, ...]
    constants: int
    positive: bool


class Options:
    """All additions to the laws of a robot, with their columns.

    A joint's described terms are not among them, but that their constants are others is.

    Attributes:
        all: the options.
        columns: theirs, at unit length, as they are.
    """

    def __init__(self, rows: FrictionRows) -> None:
        self._wanted: list[tuple[Joint, Shape]] = []
        laws = rows.dynamics.robot.friction
        self.all: tuple[Option, ...] = tuple(
            option for joint in rows.joints for option in self._of(joint, laws[joint.name], rows)
        )
        columns = rows.columns(self._wanted)
        norms = np.linalg.norm(columns, axis=0)
        self.columns = columns / np.where(norms > 0, norms, 1.0)

    def _of(self, joint: Joint, law: Friction, rows: FrictionRows) -> list[Option]:
        found, c = [], law.coulomb
        if joint.drive is not None and law.both_ways:
            way = self._add(joint, one_way), self._add(joint, one_way_speed)
            back = {"viscous_back": law.viscous, "coulomb_back": c, "offset": None}
            if law.offset is None:
                offset = Variant(way[:1], {"offset": 0.1 * c})
                found.append(Option(joint.name, "offset", (offset,), 0, positive=False))
            both = Variant(way, back)
            found.append(Option(joint.name, "both_ways", (both,), 0, positive=False))
        if joint.drive is not None and law.load is None:
            found.append(self._load(joint, rows.rotor(joint)))
        own = {t.kind: t for t in rows.dynamics.robot.friction_terms if t.joint == joint.name}
        forms: dict[AdditionKind, list[dict[str, Any]]] = {
            "power": _powers(joint, c),
            "stribeck": _stribecks(joint, c),
        }
        for kind, laws in forms.items():
            if kind in own:
                found.append(self._retuned(joint, own[kind]))
            elif kind != "stribeck" or "hess_soom" not in own:
                variants = tuple(self._variant(joint, kind, more, rows) for more in laws)
                count = len(TERM_OF[kind].constants)
                found.append(Option(joint.name, kind, variants, count, positive=True))
        return found

    def _load(self, joint: Joint, rotor: float) -> Option:
        """Losses by load. Torques tell a rotor and what turns behind its gear by their sum only,
        losses what the gear carries of it."""
        moved = [share * rotor for share in (_SHARES if rotor else _SHARES[:1])]
        variants = tuple(
            Variant((self._add(replace(joint, moved=one), of_load),), {"load": _LOAD}, one)
            for one in moved
        )
        return Option(joint.name, "load", variants, min(len(variants) - 1, 1), positive=True)

    def _variant(
        self, joint: Joint, kind: str, more: dict[str, Any], rows: FrictionRows
    ) -> Variant:
        robot = rows.dynamics.robot
        law = robot.friction[joint.name].changed(**more)
        term = _term_of(robot, joint.name, law, kind)
        return Variant((self._add(joint, of_term(term)),), more)

    def _retuned(self, joint: Joint, term: FrictionTerm) -> Option:
        """Other constants of a term that is described."""
        columns = [self._add(joint, of_slope(term, name)) for name in term.constants]
        kind: AdditionKind = "power" if term.kind == "power" else "stribeck"
        return Option(joint.name, kind, (Variant(tuple(columns), {}),), 0, positive=False)

    def _add(self, joint: Joint, made: Shape) -> int:
        self._wanted.append((joint, made))
        return len(self._wanted) - 1


def columns_of(rows: FrictionRows, law: Friction, option: Option) -> np.ndarray:
    """The columns that an option has in a law, with the constants of that."""
    joint = next(one for one in rows.joints if one.name == option.joint)
    if option.kind == "offset":
        return rows.columns([(joint, one_way)])
    if option.kind == "both_ways":
        return rows.columns([(joint, one_way), (joint, one_way_speed)])
    if option.kind == "load":
        return rows.columns([(joint, of_load)])
    robot = rows.dynamics.robot
    term = _term_of(robot, joint.name, law, option.kind)
    if getattr(robot.friction[joint.name], option.kind) is None:
        return rows.columns([(joint, of_term(term))])
    return rows.columns([(joint, of_slope(term, name)) for name in term.constants])


def _term_of(robot: RobotDescription, joint: str, law: Friction, kind: str) -> FrictionTerm:
    """The term of a kind in a law of a joint."""
    terms = friction_terms({joint: (law, robot.units(joint))})
    return next(term for term in terms if term.kind == kind)


def remaining(options: tuple[Option, ...], taken: Option) -> tuple[Option, ...]:
    """What may still be added; laws for both directions have no offset, which says the same."""
    barred = {taken.kind, *({"offset"} if taken.kind == "both_ways" else ())}
    return tuple(one for one in options if one.joint != taken.joint or one.kind not in barred)


def of_term(term: FrictionTerm) -> Shape:
    """A term that has constants."""
    return lambda v, C, load: C * term.values(v)


def of_slope(term: FrictionTerm, constant: str) -> Shape:
    """Its change with the logarithm of a constant."""
    return lambda v, C, load: C * term.slopes(v)[constant]


def _powers(joint: Joint, coulomb: float) -> list[dict[str, Any]]:
    return [
        {"power": PowerLaw(coefficient=_SIZE * coulomb / joint.fastest**e, exponent=e)}
        for e in _EXPONENTS
    ]


def _stribecks(joint: Joint, coulomb: float) -> list[dict[str, Any]]:
    return [
        {
            "stribeck": Stribeck(
                coefficient=_SIZE * coulomb, speed=share * joint.fastest, exponent=form
            )
        }
        for share in _SPEEDS
        for form in FORMS
    ]
