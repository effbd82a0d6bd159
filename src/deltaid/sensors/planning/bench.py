"""All rows of a plan, and what is known after any of what could be bought."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.planning.knowledge import Knowledge, Unknowns
from deltaid.sensors.planning.offers import Offers
from deltaid.sensors.planning.rows import Extended, PlannedMotion, Scene, torque_rows, torques
from deltaid.sensors.planning.shopping import Goal, cost_of, goal
from deltaid.sensors.planning.uses import Use, described_rows, uses
from deltaid.sensors.weighings import weighings

Shares = Float[np.ndarray, " entries"]


@dataclass(frozen=True)
class PlanSettings:
    """What a plan assumes.

    Attributes:
        torque_noise: standard deviation of the torques' noise, as a share of each drive's largest
            torque along the motion.
        rate: independent samples a second, of torques and of sensors.
        duration: of the generic motion [s].
        prior_spread: relative standard deviation of the prior, where the description has no other.
        gain_spread: of the drives' torque constants; None for 0.1 if these are the goal, and for
            drives that are right else.
        enough: share of an entry, or of the largest force, that is good enough: to know it better
            is no gain.
        steps: how many things are bought at most.
        seed: of the generic motion.
    """

    torque_noise: float = 0.02
    rate: float = 200.0
    duration: float = 20.0
    prior_spread: float = PRIOR_SPREAD
    gain_spread: float | None = None
    enough: float = 0.01
    steps: int = 10
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Outlook:
    """What is known after something.

    Attributes:
        name, title: of it.
        cost: of all of it.
        shares: standard deviation of each entry as a share of its size.
        goal: geometric mean of the goal's standard deviations, as a share.
        gain: by how much ½ log det of the goal's covariance falls [nats].
    """

    name: str
    title: str
    cost: float
    shares: Shares = field(repr=False)
    goal: float
    gain: float


@dataclass(frozen=True, eq=False)
class Bench:
    """Rows, and what there is before anything is bought.

    Attributes:
        entries: what is unknown.
        goal: what is wanted.
        torque, sure: rows of torques, and of what the description has, as of `SensorInformation`.
        uses: what could be bought.
        left_out: what of the list the robot has no place for, in words.
        start: what is known before anything is bought.
        torques, described: by torques alone, and with what the description has.
    """

    entries: Unknowns
    goal: Goal
    torque: Extended
    sure: Extended
    uses: tuple[Use, ...]
    left_out: tuple[str, ...]
    start: Knowledge
    torques: Outlook
    described: Outlook

    @classmethod
    def prepare(
        cls,
        dynamics: Dynamics,
        motion: PlannedMotion,
        offers: Offers,
        entries: Unknowns,
        wanted: str,
        settings: PlanSettings,
        progress: Callable[[str], None],
    ) -> "Bench":
        """Rows of a robot along a motion, of all that a list offers, and a goal.

        Raises:
            DeltaidError: no such goal; the list names what the robot does not have.
        """
        p = prior_parameters(dynamics.robot)
        Y = torques(dynamics, p, motion)
        noise = settings.torque_noise * np.abs(Y @ p).max(axis=0)
        count = settings.rate * motion.duration / len(motion.z)
        scene = Scene(dynamics, p, motion, count, noise)
        rows = torque_rows(scene, Y)
        progress("looking at what could be bought")
        likely, sure = described_rows(scene, weighings(dynamics.robot))
        found, left_out = uses(scene, offers)
        aim = goal(wanted, entries, scene, settings.enough)
        alone = Knowledge.before(len(entries.names)).and_rows(rows @ entries.W)
        start = alone.and_rows(likely @ entries.W) if len(likely) else alone
        by_torques = _outlook("torques", "torques alone", alone, alone, aim, entries, 0.0)
        described = by_torques
        if len(likely):
            title = "with what the description has"
            described = _outlook("described", title, start, alone, aim, entries, 0.0)
        return cls(entries, aim, rows, sure, found, left_out, start, by_torques, described)

    def outlook(self, some: Sequence[Use]) -> Outlook:
        """What is known after some uses together."""
        known = self.start
        for use in some:
            known = known.and_rows(use.likely @ self.entries.W)
        name, title = " + ".join(use.name for use in some), " + ".join(use.title for use in some)
        return _outlook(name, title, known, self.start, self.goal, self.entries, cost_of(some))

    def find(self, names: Sequence[str], offers: Offers) -> list[Use]:
        """Uses by their names; none of them where the list's own combination does not fit.

        Raises:
            DeltaidError: there is none of a name.
        """
        by_name = {use.name: use for use in self.uses}
        missing = [name for name in names if name not in by_name]
        if missing and tuple(names) in offers.combinations:
            return []
        if missing:
            raise DeltaidError(
                f"there is nothing called '{missing[0]}' to be done on this robot",
                where="--combine",
                cure=f"choose from {', '.join(by_name)}",
            )
        return [by_name[name] for name in names]


def _outlook(
    name: str,
    title: str,
    known: Knowledge,
    before: Knowledge,
    aim: Goal,
    entries: Unknowns,
    cost: float,
) -> Outlook:
    shares = known.std * entries.spread
    return Outlook(name, title, cost, shares, aim.std(known), aim.left(before) - aim.left(known))
