"""What is estimated, from one cycle to the next: how long it is remembered, and its prior.

How large the torques are that a model has not is learnt. They are d, one number a drive, of the
size

    a + b / (1 + (q̇/v)²),

a while the drive moves and b more where it is slow. In units of that size E(d²) = 1, so d² + P_dd
beyond 1 says that a and b are larger than thought, below 1 that they are smaller; each learns by
its share.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.online.graph import Field, StateField
from deltaid.online.kalman import Estimate
from deltaid.online.knowledge import OnlineKnowledge
from deltaid.online.settings import OnlineSettings
from deltaid.online.signals import Signals

# Memory [s] of a load, of the model's own errors, and of torques that the model has not.
_LOAD, _MODEL, _UNMODELLED = 1e6, 300.0, 0.05


@dataclass(frozen=True, eq=False)
class States:
    """What is estimated, as the cycle before left it.

    Attributes:
        kinds: of each: 0 load, 1 model, 2 friction, 3 unmodelled.
        x, P: symbols; of P the lower triangle.
        held: 1 while a load was held.
        period, friction_time: [s].
    """

    kinds: np.ndarray
    x: ca.SX
    P: ca.SX
    held: ca.SX
    period: float
    friction_time: float

    @classmethod
    def named(cls, s: Signals, settings: OnlineSettings, held: ca.SX) -> "States":
        """States with new symbols.

        Args:
            held: 1 while a load is held.
        """
        kinds = _kinds(s)
        n, symbol = len(kinds), ca.SX.sym
        P = symbol("P", ca.Sparsity.lower(n).nnz())
        times = settings.period, settings.friction_time
        return cls(kinds, symbol("x", n), P, held, *times)

    @property
    def count(self) -> int:
        """How many states there are."""
        return len(self.kinds)

    @property
    def stays(self) -> ca.SX:
        """Share of each that is not forgotten in a cycle."""
        memory = np.array([_LOAD, _MODEL, self.friction_time, _UNMODELLED])[self.kinds]
        return ca.SX(np.exp(-self.period / memory))

    @property
    def wander(self) -> ca.SX:
        """1 for those whose mean is forgotten too."""
        return ca.SX((self.kinds == 3).astype(float))

    @property
    def symbols(self) -> Estimate:
        """As the cycle before left them."""
        return Estimate(self.x, ca.tril2symm(ca.SX(ca.Sparsity.lower(self.count), self.P)))

    def later(self, estimate: Estimate) -> Estimate:
        """A cycle later, before anything is measured."""
        prior = ca.vertcat(*(self.held if kind == 0 else ca.SX(1) for kind in self.kinds))
        return estimate.forgotten(self.stays, prior, self.wander)

    def kept(self, behind: Estimate) -> tuple[StateField, ...]:
        """Fields of the state."""
        n, initial = self.count, np.diag(np.where(self.kinds == 0, 0.0, 1.0))
        first = tuple(initial.T[np.triu_indices(n)].tolist())
        triangle = Field("P", len(first), "its covariance, columns of the lower triangle",
                         initial=first)  # fmt: skip
        return (
            StateField(Field("x", n, "estimate, in deviations of its prior"), self.x, behind.x),
            StateField(triangle, self.P, ca.tril(ca.densify(behind.P)).nz[:]),
        )


def _kinds(s: Signals) -> np.ndarray:
    """For each state: 0 load, 1 model, 2 friction, 3 unmodelled."""
    parts = (s.at_load, 0), (s.at_directions, 1), (s.at_friction, 2), (s.at_lacked, 1)
    sizes = [part.stop - part.start for part, _ in parts]
    return np.repeat([*(kind for _, kind in parts), 3], [*sizes, s.qd.numel()])


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
    def named(cls, known: OnlineKnowledge, s: Signals) -> "Lacking":
        """States with new symbols."""
        moving, slow = (ca.SX.sym(name, s.qd.numel()) for name in _NAMES)
        parts = known.unmodelled * moving, known.unmodelled_slow * slow * s.slow
        return cls((moving, slow), (ca.SX(parts[0]), ca.SX(parts[1])))

    @property
    def size(self) -> ca.SX:
        """Of d, drive by drive."""
        return self.parts[0] + self.parts[1]

    def kept(self, d: Estimate, calm: ca.SX, period: float) -> tuple[StateField, ...]:
        """Fields of the state.

        Args:
            d: in units of its size.
            calm: 1 where it may be learnt from.
        """
        beyond = ca.fmin(d.x**2 + ca.diag(d.P) - 1, _LARGEST_STEP)
        fields = list[StateField]()
        for name, level, part in zip(_NAMES, self.levels, self.parts, strict=True):
            doc = f"how much more than thought the model lacks of {name} drives"
            grown = level * (1 + period / _LEARNT * calm * beyond * (part / self.size) ** 2)
            grown = ca.fmin(ca.fmax(grown, _LEVELS[0]), _LEVELS[1])
            fields.append(
                StateField(Field(f"{name}_level", level.numel(), doc, initial=1.0), level, grown)
            )
        return tuple(fields)
