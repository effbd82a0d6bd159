"""Goals of a sensor plan, and the greedy choice of measurements.

A goal is rows G over u: bodies, one body, constraint forces, drives' gains, in shares of an entry's
prior or of the largest force. Its remaining uncertainty is ½ log det(I + G Cov Gᵀ/ε²), where ε is
the share that is good enough: knowing it better hardly reduces this.

The greedy choice takes one use after the other, always the one with the largest reduction per cost.
An offer's price is paid with its first use; every use costs its work.

Without a budget it ends (`enough`) at the uncertainty ε, without uses that this does not need, or
at the knee, beyond which money buys far less.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.sensors.planning.knowledge import Knowledge, PlanUnknowns
from deltaid.sensors.planning.rows import PlannedRecording
from deltaid.sensors.planning.uses import Use

BODIES, FORCES, GAINS = "bodies", "forces", "gains"


@dataclass(frozen=True, eq=False)
class Goal:
    """Combinations of the unknowns that a plan is to determine.

    Attributes:
        words: description, for tables and pages.
        rows: G; forces have rows at several instants, which together count as one.
        weight: of each row.
        enough: ε.
    """

    words: str
    rows: Float[np.ndarray, "goals n"]
    weight: float
    enough: float

    def uncertainty(self, known: Knowledge) -> float:
        """½ log det(I + G Cov Gᵀ/ε²) [nats]."""
        return known.log_det(np.sqrt(self.weight) / self.enough * self.rows)

    def std(self, known: Knowledge) -> float:
        """Geometric mean of the standard deviations, as a share; of those that are not zero."""
        std = known.std_of(self.rows)
        return float(np.exp(np.mean(np.log(std[std > 0])))) if std.any() else 0.0


def goal(name: str, unknowns: PlanUnknowns, recorded: PlannedRecording, enough: float) -> Goal:
    """A goal by its name.

    Raises:
        DeltaidError: there is none of that name.
        DescriptionError: forces of a mechanism of the user's own.
    """
    if name == FORCES:
        return Goal(
            "constraint forces", _forces(unknowns, recorded), 1.0 / len(recorded.motion.few), enough
        )
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


def _forces(unknowns: PlanUnknowns, recorded: PlannedRecording) -> Float[np.ndarray, "rows n"]:
    """All forces in struts, joints and bearings at some instants, as shares of the largest one."""
    forces, motion = ConstraintForces(recorded.dynamics.robot), recorded.motion
    few, count = motion.few, len(recorded.p)
    C = forces.coefficients(motion.z[few], motion.qd[few], motion.qdd[few])
    C = C[:, [k for k, unit in enumerate(forces.units) if unit == "N"]]
    return (C / np.abs(C @ recorded.p).max()).reshape(-1, count) @ unknowns.W[:count]


# Least worthwhile reduction of all of a goal's standard deviations: 2 %.
_LEAST = 0.02
# Beyond the knee a step gains less per cost than this share of what all before it gained.
KNEE = 0.1


@dataclass(frozen=True, eq=False)
class PurchaseStep:
    """One step of a plan.

    Attributes:
        use: the measurement.
        cost: of the step, without offers bought before.
        spent: cumulative cost.
        gain: reduction of the goal's uncertainty [nats].
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
    """Measurements to buy, in order; of equal ones the first in the list.

    Args:
        budget: largest total cost; None for no bound.
        most: largest number of steps.
    """
    rows = {use: use.likely @ W for use in uses}  # of those that are not bought yet
    steps, spent, owned = list[PurchaseStep](), 0.0, dict[str, str]()  # offers by group
    least = _LEAST * len(goal.rows) * goal.weight
    while len(steps) < most:
        left = [use for use in rows if owned.get(use.group, use.offer) == use.offer]
        costs = [use.work + (0.0 if use.group in owned else use.price) for use in left]
        before = goal.uncertainty(known)
        possible = [
            PurchaseStep(
                use, cost, spent + cost, before - goal.uncertainty(known.and_rows(rows[use]))
            )
            for use, cost in zip(left, costs, strict=True)
            if budget is None or spent + cost <= budget
        ]
        worthwhile = [step for step in possible if step.gain >= least > 0.0]
        if not worthwhile:
            break
        best = max(worthwhile, key=_worth)
        known, spent = known.and_rows(rows.pop(best.use)), best.spent
        owned[best.use.group] = best.use.offer
        steps.append(best)
    return tuple(steps)


def _worth(step: PurchaseStep) -> tuple[float, float]:
    """Free uses come first, the one with the largest gain before others."""
    return (step.gain / step.cost if step.cost else np.inf, step.gain)


def enough(
    known: Knowledge, goal: Goal, steps: Sequence[PurchaseStep], W: Float[np.ndarray, "extended n"]
) -> tuple[PurchaseStep, ...]:
    """The steps that are enough, in order; none where `known` already is.

    Where ε is reached, steps that are not needed for it are dropped, the most expensive first.
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
    """Cost of several uses together, each offer paid once."""
    prices = {use.offer: use.price for use in uses}
    return sum(prices.values()) + sum(use.work for use in uses)
