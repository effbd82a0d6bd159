"""Terms of friction laws as functions of speed and load, and laws in words."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.robot.friction import Friction
from deltaid.robot.parameter import TURNING, JointUnits, PriorParameter

# Size of complex steps, whose square is lost in rounding; and a squared speed [rad²/s² or m²/s²]
# that keeps powers of |v| differentiable at rest.
_ROUNDING = float(np.finfo(float).eps)

Speeds = Float[np.ndarray, " *shape"]

# Viscous and Coulomb terms, which `law_in_words` names together.
_PLAIN = ("viscous", "coulomb", "viscous_back", "coulomb_back")


@dataclass(frozen=True)
class FrictionTerm(ABC):
    """A term of a joint's friction law, coefficient · h(v): one column of the regressor.

    Attributes:
        joint: name of the joint.
        unit: unit of the coefficient.
        size: prior of the coefficient; for an offset, whose prior is 0, its described size.
        one_sided: whether viscous or Coulomb friction acts at positive speed only.
        exponent: constant of the term, without unit, if it has one.
        speed: constant of the term [rad/s or m/s], if it has one.
    """

    joint: str
    unit: str
    size: float
    one_sided: bool = False
    exponent: float = 1.0
    speed: float = 1.0

    kind: ClassVar[str]
    # Formats with the term's constants: unit of the coefficient, and words if not those of `kind`.
    unit_form: ClassVar[str] = "{force}"
    saying: ClassVar[str] = ""
    # Whether h(v) is continuous at rest, v = 0.
    continuous: ClassVar[bool] = False
    # Whether h depends on the load of the gear.
    of_load: ClassVar[bool] = False
    # Names of the term's constants.
    constants: ClassVar[tuple[str, ...]] = ()
    # Whether negative speed may have another coefficient.
    has_back: ClassVar[bool] = False
    # Bounds of the coefficient.
    low: ClassVar[float] = 0.0
    high: ClassVar[float] = float("inf")

    @classmethod
    def of_law(cls, joint: str, law: Friction, units: JointUnits) -> "FrictionTerm | None":
        """Term of this kind in a joint's law; None if the law has none."""
        stated = getattr(law, cls.kind)
        if stated is None:
            return None
        constants = {name: getattr(stated, name) for name in cls.constants}
        size = stated.coefficient if constants else stated
        one_sided = cls.has_back and not law.both_ways
        unit = cls.unit_form.format(**vars(units), **constants)
        return cls(joint, unit, size, one_sided, **constants)

    @abstractmethod
    def h(self, v: Any, s: Any, load: Any) -> Any:
        """Friction for a coefficient of 1, by numbers, arrays or CasADi symbols.

        Args:
            v: speed of the joint [rad/s or m/s].
            s: sign of v, or a smooth approximation of it.
            load: torque x of the drive's gear on the link's side [N m or N].
        """

    def values(self, v: Speeds) -> Speeds:
        """Friction h(v) without load."""
        return self.h(v, np.sign(v), 0.0)

    def slopes(self, v: Speeds) -> dict[str, Speeds]:
        """Slopes ∂h/∂ln c for each constant c, by complex steps, which lose no digits."""
        slopes = dict[str, Speeds]()
        for name in self.constants:
            moved = copy(self)
            object.__setattr__(moved, name, getattr(self, name) * (1 + _ROUNDING * 1j))
            slopes[name] = np.imag(moved.h(v, np.sign(v), 0.0)) / _ROUNDING
        return slopes

    @property
    def words(self) -> str:
        """Term in words, with its constants."""
        return self.saying.format(**vars(self)) or self.kind

    @property
    def parameter(self) -> PriorParameter:
        """Coefficient of the term as a parameter with its prior."""
        prior = 0.0 if self.low < 0 else self.size
        bounds = (self.low, self.high)
        return PriorParameter(
            "friction", self.joint, self.kind, self.unit, *bounds, prior, self.size
        )

    def in_law(self, coefficient: float) -> dict[str, Any]:
        """Key and value of this term in a description's law, with this coefficient."""
        constants = {name: getattr(self, name) for name in self.constants}
        return {self.kind: {"coefficient": coefficient, **constants} if constants else coefficient}

    @property
    def name(self) -> str:
        """Name of the coefficient, such as 'viscous.drive1'."""
        return self.parameter.name


class _Viscous(FrictionTerm):
    kind, continuous, has_back, unit_form = "viscous", True, True, "{force} s/{coordinate}"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (1 + s) * v if self.one_sided else v


class _Coulomb(FrictionTerm):
    kind, has_back = "coulomb", True

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (s + s * s) if self.one_sided else s


class _ViscousBack(_Viscous):
    kind, has_back = "viscous_back", False

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (1 - s) * v


class _CoulombBack(FrictionTerm):
    kind = "coulomb_back"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (s - s * s)


class _Offset(FrictionTerm):
    kind, continuous, low = "offset", True, -float("inf")

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 1.0 + 0.0 * v

    def in_law(self, coefficient: float) -> dict[str, Any]:
        return {self.kind: self.size}  # the prior of an offset is always zero


class _Power(FrictionTerm):
    kind, constants = "power", ("exponent",)
    unit_form, saying = "{force} (s/{coordinate})^{exponent:.3g}", "|speed|^{exponent:.3g}"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * _size(v) ** self.exponent


class _Stribeck(FrictionTerm):
    kind, constants = "stribeck", ("speed", "exponent")
    saying = "Stribeck (speed {speed:.3g}, exponent {exponent:.3g})"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * _exp(-((_size(v) / self.speed) ** self.exponent))


class _HessSoom(FrictionTerm):
    kind, constants, saying = "hess_soom", ("speed",), "Hess–Soom (speed {speed:.3g})"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s / (1 + (v / self.speed) ** 2)


class _Load(FrictionTerm):
    kind, of_load, high = "load", True, 1.0
    unit_form, saying = "1", "share of the load"

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * abs(load)


# Kinds of terms, in the order of p.
TERMS: tuple[type[FrictionTerm], ...] = (
    _Viscous, _Coulomb, _ViscousBack, _CoulombBack, _Offset, _Power, _Stribeck, _HessSoom,
    _Load,
)  # fmt: skip


def _size(v: Any) -> Any:
    return (v * v + _ROUNDING) ** 0.5


def _exp(x: Any) -> Any:
    return ca.exp(x) if isinstance(x, ca.SX | ca.MX) else np.exp(x)


def friction_terms(laws: Mapping[str, tuple[Friction, JointUnits]]) -> tuple[FrictionTerm, ...]:
    """Terms of all joints' laws in the order of p: by kind, then by joint."""
    terms = (kind.of_law(joint, *law) for kind in TERMS for joint, law in laws.items())
    return tuple(term for term in terms if term is not None)


def at_rest(law: Friction) -> float:
    """Largest friction near rest without its load-dependent term [N m or N]."""
    terms = friction_terms({"": (law, TURNING)})
    return max(sum(abs(float(term.size * term.h(0.0, s, 0.0))) for term in terms) for s in (-1, 1))


def law_in_words(law: Friction) -> str:
    """Friction law in words, such as 'viscous + Coulomb + Stribeck (speed 0.3, exponent 1)'."""
    plain = "viscous + Coulomb" if law.both_ways else "viscous + Coulomb, each direction its own"
    terms = friction_terms({"": (law, TURNING)})
    return " + ".join([plain, *(term.words for term in terms if term.kind not in _PLAIN)])
