"""Greedy buying: one use after the other, always that which gains most for what it costs.

The gain is by how much ½ log det(I + G Cov Gᵀ/ε²) of the goal falls. What an offer costs is paid
with its first use; every use costs its work.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.sensors.planning.goals import Goal
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.uses import Use

# A gain that is not worth anybody's way: all of a goal's standard deviations smaller by 2 %.
_LEAST = 0.02
# What costs nothing is taken for this much, so that more for nothing comes before less.
_NOTHING = 1e-6


@dataclass(frozen=True, eq=False)
class Step:
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
) -> tuple[Step, ...]:
    """What to buy, in order; of equal ones the first in the list.

    Args:
        budget: most that all may cost; None for no bound.
        most: number of steps.
    """
    rows = [one.likely @ W for one in uses]
    steps, spent, done = list[Step](), 0.0, set[int]()
    owned = dict[str, str]()  # by group
    least = _LEAST * len(goal.rows) * goal.weight
    while len(steps) < most:
        before, best, ratio = goal.left(known), None, 0.0
        for k, one in enumerate(uses):
            has = owned.get(one.group, one.offer)
            cost = one.work + (0.0 if one.group in owned else one.price)
            if k in done or has != one.offer or (budget is not None and spent + cost > budget):
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
        steps.append(Step(uses[k], cost, spent, gain))
    return tuple(steps)


def cost_of(some: Sequence[Use]) -> float:
    """Of several uses together, each offer paid once."""
    prices = {one.offer: one.price for one in some}
    return sum(prices.values()) + sum(one.work for one in some)
