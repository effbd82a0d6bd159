"""Free variables of a type, scaled by their sizes, and their prior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import prior_scale
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.fleets.member import MeasuredFact, TypeMember, eliminated
from deltaid.grouping import grouped
from deltaid.levels import WIDER
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia
from deltaid.robot.parameter import PriorParameter

U = Float[np.ndarray, " u"]
Square = Float[np.ndarray, "u u"]
# Kinds of entries with a common spread, and its prior median as a share of an entry's size.
KINDS = {
    "mass": 0.03,
    "first moments": 0.03,
    "second moments": 0.03,
    "rotor": 0.03,
    "spring": 0.05,
    "viscous": 0.2,
    "coulomb": 0.2,
    "friction": 0.2,
}
# Prior standard deviation of the logarithm of a spread: a factor of 4.5 either way.
VAGUE = 1.5
# Factor by which friction's prior is wider than described.
_VAGUE_FRICTION = 20.0
FRICTION = ("viscous", "coulomb", "friction")
# Variance of a free entry over its squared size: its deviation is a hundred times its size.
ANYTHING = 1e4


@dataclass(frozen=True, eq=False)
class Coordinates:
    """u: the free variables x of a type over their sizes, then shared geometric errors.

    Attributes:
        reduction: of p to the free variables, p = A x + p_0.
        kinds: of each variable, a key of `KINDS`.
        quantities: geometric errors.
        spread: of the description's prior.
    """

    robot: RobotDescription
    reduction: Reduction
    kinds: tuple[str, ...]
    quantities: tuple[str, ...]
    sizes: Float[np.ndarray, " n"]
    spread: float

    @classmethod
    def for_type(
        cls, robot: RobotDescription, members: Sequence[TypeMember], settings: Settings
    ) -> "Coordinates":
        names = parameter_layout(robot).names
        shown = {name for member in members for name in member.visible}
        visible = np.array([i for i, name in enumerate(names) if name in shown], dtype=int)
        reduction = build_reduction(robot, visible, (), settings.prior_spread)
        reduction = replace(reduction, widened=_widened(members))
        return cls(
            robot=robot,
            reduction=reduction,
            kinds=tuple(_kind(variable) for variable in reduction.variables),
            quantities=tuple(
                dict.fromkeys(name for member in members for name in member.quantities)
            ),
            sizes=reduction.scale,
            spread=settings.prior_spread,
        )

    def resized(self, p: Float[np.ndarray, " parameters"]) -> "Coordinates":
        """Take sizes from parameters p, so that spreads are shares of real sizes."""
        layout, sizes = self.reduction.layout, self.reduction.scale.copy()
        for k, variable in enumerate(self.reduction.variables):
            if variable.kind == "inertia":
                part = layout.body(variable.owner)
                now, before = p[part], self.reduction.p_reg[part]
                entries = PSEUDO_INERTIA_ENTRIES[variable.symbol]
                times = np.prod([_times(now, before, entry) for entry in entries])
            else:
                times = abs(p[layout.names.index(variable.name)]) / sizes[k]
            sizes[k] *= np.clip(times, 1.0 / WIDER, WIDER)
        return replace(self, sizes=sizes)

    @cached_property
    def precision(self) -> Square:
        """Prior precision of u about `prior`."""
        n, changed = self.size, np.any(self.reduction.A != 0, axis=1)
        D = self.reduction.A[changed] * self.sizes / prior_scale(self.reduction)[changed][:, None]
        # Recordings determine friction; its prior is wide.
        D[:, self.is_friction[:n]] /= _VAGUE_FRICTION
        precision = np.eye(n + len(self.quantities))
        precision[:n, :n] = D.T @ D / self.spread**2
        return precision

    @property
    def size(self) -> int:
        return self.reduction.size

    @property
    def prior(self) -> U:
        return np.append(self.reduction.prior / self.sizes, np.zeros(len(self.quantities)))

    @cached_property
    def to_p(self) -> Float[np.ndarray, "parameters u"]:
        """Slopes ∂p/∂u of the parameters."""
        return np.pad(self.reduction.A * self.sizes, ((0, 0), (0, len(self.quantities))))

    @cached_property
    def is_friction(self) -> np.ndarray:
        return np.isin([*self.kinds, *self.quantities], FRICTION)

    @property
    def free_friction(self) -> U:
        """Variances with free friction, zero otherwise."""
        return np.where(self.is_friction, ANYTHING, 0.0)

    def kind_of(self) -> Int[np.ndarray, " u"]:
        """Index of each variable's kind among those present; −1 for geometry."""
        return np.array(
            [*map(self.present.index, self.kinds), *[-1] * len(self.quantities)], dtype=int
        )

    @property
    def present(self) -> tuple[str, ...]:
        return tuple(kind for kind in KINDS if kind in self.kinds)

    def owners(self) -> dict[str, list[int]]:
        return grouped(
            (x.owner if x.kind == "inertia" else f"{x.kind} of {x.owner}", k)
            for k, x in enumerate(self.reduction.variables)
        )

    def rows(
        self, member: TypeMember, facts: Sequence[MeasuredFact]
    ) -> Float[np.ndarray, "rows augmented"]:
        """Rows of a member and some of its facts: over u, over p_0, and the right side."""
        names, count = self.reduction.layout.names, len(self.quantities)
        to_names, to_shared = _same(member.names, names), _same(member.quantities, self.quantities)
        strange = ~to_names.any(axis=1)  # terms of friction that are not the type's
        H, shared = member.rows @ to_names, member.shared @ to_shared
        data = np.column_stack([member.rows[:, strange], H, shared, member.values])
        weighed = [
            np.array([*(fact.coefficients @ to_names), *np.zeros(count), fact.value]) / fact.std
            for fact in facts
        ]
        wide = np.vstack([eliminated(data, int(strange.sum())), *weighed])
        H, shared, b = np.split(wide, [len(names), len(names) + count], axis=1)
        over, constant = H @ (self.reduction.A * self.sizes), H @ self.reduction.p_0
        return triangle(np.column_stack([over, shared, constant, b[:, 0] - constant]))


def _same(names: Sequence[str], others: Sequence[str]) -> Float[np.ndarray, "names others"]:
    """1 where both names are equal, else 0."""
    return (np.array(names, dtype=str)[:, None] == np.array(others, dtype=str)).astype(float)


def _widened(members: Sequence[TypeMember]) -> dict[str, float]:
    factors = grouped(entry for member in members for entry in (member.widened or {}).items())
    return {
        name: float(np.median(values))
        for name, values in factors.items()
        if len(values) > len(members) / 2
    }


def _times(p: np.ndarray, prior: np.ndarray, entry: int) -> float:
    """√(M̄_ii / prior); for second moments by their trace, because small ones are uncertain."""
    M, before = pseudo_inertia(p), pseudo_inertia(prior)
    rows = [3] if entry == 3 else [0, 1, 2]
    return float(np.sqrt(np.trace(M[np.ix_(rows, rows)]) / np.trace(before[np.ix_(rows, rows)])))


def _kind(variable: PriorParameter) -> str:
    first = variable.symbol.split("_")[0]
    if variable.kind == "inertia":
        moments = "first moments" if first.startswith("mc") else "second moments"
        return "mass" if first == "m" else moments
    if variable.kind != "friction":
        return variable.kind
    return first if first in FRICTION else "friction"
