"""How large the torques are that a model has not, learnt while the robot runs.

They are d, one number a drive, of the size

    a + b / (1 + (q̇/v)²),

a while the drive moves and b more where it is slow. In units of that size E(d²) = 1, so d² + P_dd
beyond 1 says that a and b are larger than thought, below 1 that they are smaller; each learns by
its share.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.online.graph import Kept
from deltaid.online.kalman import Estimate
from deltaid.online.knowledge import Knowledge
from deltaid.online.layout import Field
from deltaid.online.signals import Signals

# How fast [s] sizes are learnt, within which bounds, and the most by which one cycle counts.
_LEARNT, _LEVELS, _LARGEST_STEP = 2.0, (0.15, 20.0), 10.0
_NAMES = ("moving", "slow")


@dataclass(frozen=True, eq=False)
class Lacking:
    """Sizes in one cycle.

    Attributes:
        levels: of moving and of slow drives, in units of what was thought.
        parts: a and what b adds.
    """

    levels: tuple[ca.SX, ca.SX]
    parts: tuple[ca.SX, ca.SX]

    @classmethod
    def named(cls, known: Knowledge, s: Signals) -> "Lacking":
        """New symbols."""
        moving, slow = (ca.SX.sym(name, s.qd.numel()) for name in _NAMES)
        parts = known.unmodelled * moving, known.unmodelled_slow * slow * s.slow
        return cls((moving, slow), (ca.SX(parts[0]), ca.SX(parts[1])))

    @property
    def size(self) -> ca.SX:
        """Of d, drive by drive."""
        return self.parts[0] + self.parts[1]

    def kept(self, d: Estimate, calm: ca.SX, period: float) -> tuple[Kept, ...]:
        """Fields of the state.

        Args:
            d: in units of its size.
            calm: 1 where it may be learnt from.
        """
        beyond = ca.fmin(d.x**2 + ca.diag(d.P) - 1, _LARGEST_STEP)
        fields = list[Kept]()
        for name, level, part in zip(_NAMES, self.levels, self.parts, strict=True):
            doc = f"how much more than thought the model lacks of {name} drives"
            grown = level * (1 + period / _LEARNT * calm * beyond * (part / self.size) ** 2)
            grown = ca.fmin(ca.fmax(grown, _LEVELS[0]), _LEVELS[1])
            fields.append(
                Kept(Field(f"{name}_level", level.numel(), doc, initial=1.0), level, grown)
            )
        return tuple(fields)
