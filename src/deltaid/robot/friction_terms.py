"""Terms of friction laws: what each is of speed and load, at a coefficient of 1."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.robot.friction import Friction
from deltaid.robot.joint_units import TURNING, JointUnits
from deltaid.robot.parameter import Parameter

# Speeds below this [rad/s, m/s] count as rest: it keeps powers of |v| differentiable there.
_REST = 1e-9
# A step so small that its square is none.
_STEP = 1e-20

Speeds = Float[np.ndarray, " *shape"]


@dataclass(frozen=True)
class FrictionTerm(ABC):
    """One term of one joint's law, coefficient · h(v): one column of the regressor.

    Attributes:
        joint: of which joint.
        unit: of its coefficient.
        size: typical size of the coefficient: its prior, for an offset what the description says.
        one_sided: viscous and coulomb for positive speed only.
        exponent, speed: constants of the term, where it has them.
    """

    joint: str
    unit: str
    size: float
    one_sided: bool = False
    exponent: float = 1.0
    speed: float = 1.0

    kind: ClassVar[str]
    # Whether h(v) is continuous at rest, v = 0.
    continuous: ClassVar[bool] = False
    # Whether h depends on what the gear carries.
    of_load: ClassVar[bool] = False
    # Which constants it has.
    constants: ClassVar[tuple[str, ...]] = ()
    # Bounds of the coefficient.
    low: ClassVar[float] = 0.0
    high: ClassVar[float] = float("inf")

    @classmethod
    @abstractmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> "FrictionTerm | None":
        """The term of a joint's law; None if the law has none of its kind."""

    @abstractmethod
    def h(self, v: Any, s: Any, load: Any) -> Any:
        """Friction for a coefficient of one, of numbers, arrays or symbols of CasADi.

        Args:
            v: the joint's speed.
            s: its sign, or a smooth stand-in for it.
            load: torque that the drive's gear carries on its link's side, x.
        """

    def values(self, v: Speeds) -> Speeds:
        """Friction h(v) without load."""
        return self.h(v, np.sign(v), 0.0)

    def slopes(self, v: Speeds) -> dict[str, Speeds]:
        """∂h/∂ln c of each constant c, by a complex step, which has no rounding."""
        found = dict[str, Speeds]()
        for name in self.constants:
            moved = copy(self)
            object.__setattr__(moved, name, getattr(self, name) * (1 + _STEP * 1j))
            found[name] = np.imag(moved.h(v, np.sign(v), 0.0)) / _STEP
        return found

    @property
    def words(self) -> str:
        """The term in a sentence, with its constants."""
        return self.kind

    @property
    def parameter(self) -> Parameter:
        """Its coefficient as a parameter."""
        prior = 0.0 if self.low < 0 else self.size
        bounds = (self.low, self.high)
        return Parameter("friction", self.joint, self.kind, self.unit, *bounds, prior, self.size)

    def in_law(self, coefficient: float) -> dict[str, Any]:
        """What a law says of this term where its coefficient is another one."""
        return {self.kind: coefficient}

    @property
    def name(self) -> str:
        """Name of the coefficient, such as 'viscous.drive1'."""
        return self.parameter.name

    @property
    def signed(self) -> bool:
        """Whether the coefficient may be negative."""
        return self.low < 0


class _Viscous(FrictionTerm):
    """v, or v for v > 0 where the other direction has a coefficient of its own."""

    kind, continuous = "viscous", True

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm:
        unit = f"{units.force} s/{units.coordinate}"
        return cls(joint, unit, law.viscous, one_sided=not law.both_ways)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (1 + s) * v if self.one_sided else v


class _Coulomb(FrictionTerm):
    """s, or s for v > 0 where the other direction has a coefficient of its own."""

    kind = "coulomb"

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm:
        return cls(joint, units.force, law.coulomb, one_sided=not law.both_ways)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (s + s * s) if self.one_sided else s


class _ViscousBack(FrictionTerm):
    """v for v < 0."""

    kind, continuous = "viscous_back", True

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        back, unit = law.viscous_back, f"{units.force} s/{units.coordinate}"
        return None if back is None else cls(joint, unit, back)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (1 - s) * v


class _CoulombBack(FrictionTerm):
    """s for v < 0."""

    kind = "coulomb_back"

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        back = law.coulomb_back
        return None if back is None else cls(joint, units.force, back)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 0.5 * (s - s * s)


class _Offset(FrictionTerm):
    """A constant torque, h = 1."""

    kind, continuous, low = "offset", True, -float("inf")

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        return None if law.offset is None else cls(joint, units.force, law.offset)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return 1.0 + 0.0 * v

    def in_law(self, coefficient: float) -> dict[str, Any]:
        return {self.kind: self.size}  # the prior of an offset is zero, whatever it was found to be


class _Power(FrictionTerm):
    """A power of speed, s |v|^exponent."""

    kind, constants = "power", ("exponent",)

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        if law.power is None:
            return None
        unit = f"{units.force} (s/{units.coordinate})^{law.power.exponent:.3g}"
        return cls(joint, unit, law.power.coefficient, exponent=law.power.exponent)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * _size(v) ** self.exponent

    def in_law(self, coefficient: float) -> dict[str, Any]:
        return {self.kind: {"coefficient": coefficient, "exponent": self.exponent}}

    @property
    def words(self) -> str:
        return f"|speed|^{self.exponent:.3g}"


class _Stribeck(FrictionTerm):
    """Friction near rest, s exp(−(|v|/speed)^exponent)."""

    kind, constants = "stribeck", ("speed", "exponent")

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        if (term := law.stribeck) is None:
            return None
        force, size = units.force, term.coefficient
        return cls(joint, force, size, exponent=term.exponent, speed=term.speed)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * _exp(-((_size(v) / self.speed) ** self.exponent))

    def in_law(self, coefficient: float) -> dict[str, Any]:
        constants = {"speed": self.speed, "exponent": self.exponent}
        return {self.kind: {"coefficient": coefficient, **constants}}

    @property
    def words(self) -> str:
        return f"Stribeck (speed {self.speed:.3g}, exponent {self.exponent:.3g})"


class _HessSoom(FrictionTerm):
    """s / (1 + (v/speed)²)."""

    kind, constants = "hess_soom", ("speed",)

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        if (term := law.hess_soom) is None:
            return None
        return cls(joint, units.force, term.coefficient, speed=term.speed)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s / (1 + (v / self.speed) ** 2)

    def in_law(self, coefficient: float) -> dict[str, Any]:
        return {self.kind: {"coefficient": coefficient, "speed": self.speed}}

    @property
    def words(self) -> str:
        return f"Hess–Soom (speed {self.speed:.3g})"


class _Load(FrictionTerm):
    """s |x|; a share of what the gear carries, below one."""

    kind, of_load, high = "load", True, 1.0

    @classmethod
    def of(cls, joint: str, law: Friction, units: JointUnits) -> FrictionTerm | None:
        return None if law.load is None else cls(joint, "1", law.load)

    def h(self, v: Any, s: Any, load: Any) -> Any:
        return s * abs(load)

    @property
    def words(self) -> str:
        return "share of the load"


# In the order of p.
TERMS: tuple[type[FrictionTerm], ...] = (
    _Viscous, _Coulomb, _ViscousBack, _CoulombBack, _Offset, _Power, _Stribeck, _HessSoom,
    _Load,
)  # fmt: skip
TERM_OF = {term.kind: term for term in TERMS}


def _size(v: Any) -> Any:
    """|v|, differentiable at rest."""
    return (v * v + _REST**2) ** 0.5


def _exp(x: Any) -> Any:
    return ca.exp(x) if isinstance(x, ca.SX | ca.MX) else np.exp(x)


def friction_terms(laws: Mapping[str, tuple[Friction, JointUnits]]) -> tuple[FrictionTerm, ...]:
    """The terms of all joints' laws in the order of p: by kind, then by joint."""
    found = (kind.of(joint, *law) for kind in TERMS for joint, law in laws.items())
    return tuple(term for term in found if term is not None)


def at_rest(law: Friction) -> float:
    """Largest friction near rest, without its load-dependent part [N m or N]."""
    rest, none = ca.SX(0), ca.SX(0)
    terms = friction_terms({"": (law, TURNING)})
    sums = [
        sum(abs(float(term.size * term.h(rest, ca.SX(s), none))) for term in terms) for s in (-1, 1)
    ]
    return max(sums)
