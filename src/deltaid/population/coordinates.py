"""The free variables of a type, in sizes of their own, and what is known of them beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.information import triangle
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.regularizer import prior_scale
from deltaid.model.record import Settings
from deltaid.population.member import Fact, Member
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia
from deltaid.robot.parameter import Parameter

# What spreads of one size are, and what they are likely to be beforehand: the middle, as a share of
# the size of an entry, and the standard deviation of the logarithm.
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
VAGUE = 1.5
# A size is at most so many times that of the description, or that part of it.
_OTHER = 10.0
# So many times wider than described is what is known of friction.
_VAGUE_FRICTION = 20.0
FRICTION = ("viscous", "coulomb", "friction")


@dataclass(frozen=True, eq=False)
class Coordinates:
    """u: the free variables x of a type over their sizes; behind them shared geometric errors.

    Attributes:
        robot: the type, as described.
        reduction: which variables are free, p = A x + p_0.
        kinds: of each variable, a key of `KINDS`.
        quantities: of the geometry.
        sizes: of x.
        spread: of the description's prior.
    """

    robot: RobotDescription
    reduction: Reduction
    kinds: tuple[str, ...]
    quantities: tuple[str, ...]
    sizes: Float[np.ndarray, " n"]
    spread: float

    @classmethod
    def of(
        cls, robot: RobotDescription, members: Sequence[Member], settings: Settings
    ) -> "Coordinates":
        """Those of some robots of a type."""
        names = parameter_layout(robot).names
        visible = np.array([i for i, one in enumerate(names) if _shown(one, members)], dtype=int)
        reduction = build_reduction(robot, visible, (), settings.prior_spread)
        reduction = _widened(reduction, members)
        quantities = tuple(dict.fromkeys(name for one in members for name in one.quantities))
        kinds = tuple(_kind(one) for one in reduction.variables)
        return cls(robot, reduction, kinds, quantities, reduction.scale, settings.prior_spread)

    def resized(self, p: Float[np.ndarray, " parameters"]) -> "Coordinates":
        """The same in sizes of a type with parameters p: spreads are shares of what robots are."""
        layout, sizes = self.reduction.layout, self.reduction.scale.copy()
        for k, one in enumerate(self.reduction.variables):
            if one.kind == "inertia":
                part = layout.body(one.owner)
                i, j = PSEUDO_INERTIA_ENTRIES[one.symbol]
                times = np.prod([_times(p[part], self.reduction.p_reg[part], e) for e in (i, j)])
            else:
                times = abs(p[layout.names.index(one.name)]) / sizes[k]
            sizes[k] *= np.clip(times, 1.0 / _OTHER, _OTHER)
        return replace(self, sizes=sizes)

    @cached_property
    def precision(self) -> Float[np.ndarray, "u u"]:
        """Of u about `prior` before any recording."""
        n, changed = self.size, np.any(self.reduction.A != 0, axis=1)
        scale = prior_scale(self.reduction)[changed][:, None]
        D = self.reduction.A[changed] * self.sizes / scale
        # Friction shows by itself, and no prior bends it.
        D[:, self.is_friction[:n]] /= _VAGUE_FRICTION
        found = np.eye(n + len(self.quantities))
        found[:n, :n] = D.T @ D / self.spread**2
        return found

    @property
    def size(self) -> int:
        """Number of variables, without those of the geometry."""
        return self.reduction.size

    @property
    def prior(self) -> Float[np.ndarray, " u"]:
        """u in the description."""
        return np.append(self.reduction.prior / self.sizes, np.zeros(len(self.quantities)))

    @property
    def to_p(self) -> Float[np.ndarray, "parameters u"]:
        """How p follows from u."""
        own = self.reduction.A * self.sizes
        return np.column_stack([own, np.zeros((len(own), len(self.quantities)))])

    @property
    def is_friction(self) -> np.ndarray:
        """Which of u are friction."""
        own = [kind in FRICTION for kind in self.kinds]
        return np.array([*own, *[False] * len(self.quantities)], dtype=bool)

    def kind_of(self) -> Int[np.ndarray, " u"]:
        """Place of each variable's kind among those that there are; −1 of the geometry."""
        present = self.present
        own = [present.index(kind) for kind in self.kinds]
        return np.array([*own, *[-1] * len(self.quantities)], dtype=int)

    @property
    def present(self) -> tuple[str, ...]:
        """Kinds that there are."""
        return tuple(kind for kind in KINDS if kind in self.kinds)

    def owners(self) -> dict[str, list[int]]:
        """Variables of each body and joint."""
        found: dict[str, list[int]] = {}
        for k, one in enumerate(self.reduction.variables):
            word = "" if one.kind == "inertia" else f"{one.kind} of "
            found.setdefault(f"{word}{one.owner}", []).append(k)
        return found

    def rows(self, one: Member, facts: Sequence[Fact]) -> Float[np.ndarray, "rows augmented"]:
        """A member's rows, and some of its facts: over u, over p_0, and what is left."""
        names = self.reduction.layout.names
        at = {name: i for i, name in enumerate(one.names)}
        known = [i for i, name in enumerate(names) if name in at]
        taken = [at[names[i]] for i in known]
        H = np.zeros((len(one.rows), len(names)))
        H[:, known] = one.rows[:, taken]
        # Terms of friction that the type has not.
        strange = [k for k, name in enumerate(one.names) if name not in names]
        shared = np.zeros((len(one.rows), len(self.quantities)))
        shared[:, [self.quantities.index(name) for name in one.quantities]] = one.shared
        data = [one.rows[:, strange], H, shared, one.values[:, None]]
        wide = _without(np.column_stack(data), len(strange))
        for fact in facts:
            c = np.zeros(wide.shape[1])
            c[known] = fact.coefficients[taken]
            c[-1] = fact.value
            wide = np.vstack([wide, c / fact.std])
        H, rest, b = np.split(wide, [len(names), wide.shape[1] - 1], axis=1)
        over, constant = H @ (self.reduction.A * self.sizes), H @ self.reduction.p_0
        return triangle(np.column_stack([over, rest, constant, b[:, 0] - constant]))


def _without(wide: Float[np.ndarray, "rows columns"], count: int) -> np.ndarray:
    """Rows orthogonal to their first columns, without these."""
    if not count:
        return wide
    Q, _ = np.linalg.qr(wide[:, :count], mode="complete")
    return Q[:, count:].T @ wide[:, count:]


def _shown(name: str, members: Sequence[Member]) -> bool:
    """Whether some member's rows or facts show a parameter."""
    for one in members:
        if name in one.names:
            k = one.names.index(name)
            if np.any(one.rows[:, k]) or any(fact.coefficients[k] for fact in one.facts):
                return True
    return False


def _widened(reduction: Reduction, members: Sequence[Member]) -> Reduction:
    """With priors as wide as most of the members' recordings ask for."""
    every: dict[str, list[float]] = {}
    for one in members:
        for name, factor in (one.widened or {}).items():
            every.setdefault(name, []).append(factor)
    half = len(members) / 2
    found = {name: float(np.median(own)) for name, own in every.items() if len(own) > half}
    return replace(reduction, widened=found)


def _times(p: np.ndarray, prior: np.ndarray, entry: int) -> float:
    """√(M̄_ii / prior), of the second moments all together: thin ones are hardly known."""
    M, before = pseudo_inertia(p), pseudo_inertia(prior)
    at = [3] if entry == 3 else [0, 1, 2]
    return float(np.sqrt(np.trace(M[np.ix_(at, at)]) / np.trace(before[np.ix_(at, at)])))


def _kind(one: Parameter) -> str:
    """Which spread a variable has."""
    if one.kind == "inertia":
        return {"m": "mass", "mc": "first moments"}.get(
            one.symbol if one.symbol == "m" else one.symbol[:2], "second moments"
        )
    if one.kind != "friction":
        return one.kind
    first = one.symbol.split("_")[0]
    return first if first in FRICTION else "friction"
