"""Goals, and greedy buying towards one.

A goal is rows G over u: bodies, one body, constraint forces, drives' gains, in shares of an entry's
prior or of the largest force of a kind. ½ log det(I + G Cov Gᵀ/ε²) with ε, the share that is good
enough, falls as one learns, and no more below that.

Greedy buying: one use after the other, always that which gains most for what it costs.

The gain is by how much ½ log det(I + G Cov Gᵀ/ε²) of the goal falls. What an offer costs is paid
with its first use; every use costs its work.

Without a budget buying ends where it is enough (`enough`): at the wanted uncertainty ε, without
what that does not need, or at the knee, from which on money buys far less.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.sensors.planning.knowledge import Knowledge, PlanUnknowns
from deltaid.sensors.planning.rows import Scene
from deltaid.sensors.planning.uses import Use

BODIES, FORCES, GAINS = "bodies", "forces", "gains"
# Samples of the motion at which forces are looked at.
_INSTANTS = 12


@dataclass(frozen=True, eq=False)
class Goal:
    """Attributes:
    words: what it is.
    rows: G; of forces at several instants each, which count as one.
    weight: by how much each row counts.
    enough: ε.
    """

    words: str
    rows: Float[np.ndarray, "goals n"]
    weight: float
    enough: float

    def left(self, known: Knowledge) -> float:
        """½ log det(I + G Cov Gᵀ/ε²) [nats]."""
        return known.log_det(np.sqrt(self.weight) / self.enough * self.rows)

    def std(self, known: Knowledge) -> float:
        """Geometric mean of the standard deviations, as a share; of those that are not zero."""
        std = known.std_of(self.rows)
        return float(np.exp(np.mean(np.log(std[std > 0])))) if std.any() else 0.0


def goal(name: str, unknowns: PlanUnknowns, scene: Scene, enough: float) -> Goal:
    """A goal by its name.

    Raises:
        DeltaidError: there is none of that name.
        DescriptionError: forces of a mechanism of the user's own.
    """
    if name == FORCES:
        return Goal("constraint forces", _forces(unknowns, scene), 1.0 / _INSTANTS, enough)
    gains = [k for k, entry in enumerate(unknowns.names) if entry.startswith("gain.")]
    chosen = {body: (f"body {body}", unknowns.of_bodies(body)) for body in unknowns.bodies}
    chosen |= {BODIES: ("all bodies", unknowns.of_bodies()), GAINS: ("gains of the drives", gains)}
    if name in chosen:
        words, places = chosen[name]
        return Goal(words, np.diag(unknowns.spread)[places], 1.0, enough)
    known = f"; {name} is known by its description" if name in unknowns.known else ""
    raise DeltaidError(
        f"there is no goal '{name}'{known}",
        where="--goal",
        cure=f"choose from {BODIES}, {FORCES}, {GAINS}, {', '.join(unknowns.bodies)}",
    )


def _forces(unknowns: PlanUnknowns, scene: Scene) -> Float[np.ndarray, "rows n"]:
    """All forces in struts, joints and bearings at some instants, as shares of the largest one."""
    forces, motion = ConstraintForces(scene.dynamics.robot), scene.motion
    at = np.linspace(0, len(motion.z) - 1, _INSTANTS).astype(int)
    C = forces.coefficients(motion.z[at], motion.qd[at], motion.qdd[at])
    C = C[:, [k for k, unit in enumerate(forces.units) if unit == "N"]]
    return (C / np.abs(C @ scene.p).max()).reshape(-1, len(scene.p)) @ unknowns.W[: len(scene.p)]


# A gain that is not worth anybody's way: all of a goal's standard deviations smaller by 2 %.
_LEAST = 0.02
# Beyond the knee a step gains less than this share of what all before it gained for their price.
KNEE = 0.1
# What costs nothing is taken for this much, so that more for nothing comes before less.
_NOTHING = 1e-6


@dataclass(frozen=True, eq=False)
class PurchaseStep:
    """One thing that is bought or done.

    Attributes:
        use: what.
        cost: of it, without what has been bought before.
        spent: with all before.
        gain: in nats.
    """

    use: Use
    cost: float
    spent: float
    gain: float


def shopping(
    known: Knowledge,
    goal: Goal,
    uses: Sequence[Use],
    W: Float[np.ndarray, "extended n"],
    budget: float | None,
    most: int,
) -> tuple[PurchaseStep, ...]:
    """What to buy, in order; of equal ones the first in the list.

    Args:
        budget: most that all may cost; None for no bound.
        most: number of steps.
    """
    rows = [use.likely @ W for use in uses]
    steps, spent, done = list[PurchaseStep](), 0.0, set[int]()
    owned = dict[str, str]()  # by group
    least = _LEAST * len(goal.rows) * goal.weight
    while len(steps) < most:
        before, best, ratio = goal.left(known), None, 0.0
        for k, use in enumerate(uses):
            has = owned.get(use.group, use.offer)
            cost = use.work + (0.0 if use.group in owned else use.price)
            if k in done or has != use.offer or (budget is not None and spent + cost > budget):
                continue
            gain = before - goal.left(known.and_rows(rows[k]))
            if gain >= least and gain / max(cost, _NOTHING) > ratio:
                best, ratio = (k, cost, gain), gain / max(cost, _NOTHING)
        if best is None:
            break
        k, cost, gain = best
        known, spent = known.and_rows(rows[k]), spent + cost
        owned[uses[k].group] = uses[k].offer
        done.add(k)
        steps.append(PurchaseStep(uses[k], cost, spent, gain))
    return tuple(steps)


def enough(
    known: Knowledge, goal: Goal, steps: Sequence[PurchaseStep], W: Float[np.ndarray, "extended n"]
) -> tuple[PurchaseStep, ...]:
    """What of greedy buying is enough, in order; nothing where `known` is already.

    Where ε is reached, what came before and is not needed for it is left out, the dearest first.
    """

    def is_reached(uses: Sequence[Use]) -> bool:
        return goal.std(known.and_rows(np.vstack([use.likely for use in uses]) @ W)) <= goal.enough

    if goal.std(known) <= goal.enough:
        return ()
    uses = [step.use for step in steps]
    reached = (uses[:k] for k in range(1, len(uses) + 1) if is_reached(uses[:k]))
    if needed := next(reached, None):
        for step in sorted(steps[: len(needed)], key=lambda step: -step.cost):
            rest = [use for use in needed if use is not step.use]
            if rest and is_reached(rest):
                needed = rest
        return shopping(known, goal, needed, W, None, len(needed))
    spent = gained = 0.0
    for k, step in enumerate(steps):
        if step.gain * spent < KNEE * gained * step.cost:
            return tuple(steps[:k])
        if step.cost:
            spent, gained = spent + step.cost, gained + step.gain
    return tuple(steps)


def cost_of(uses: Sequence[Use]) -> float:
    """Of several uses together, each offer paid once."""
    prices = {use.offer: use.price for use in uses}
    return sum(prices.values()) + sum(use.work for use in uses)
