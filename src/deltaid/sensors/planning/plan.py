"""Plan measurements: what torques determine, what each measurement adds, and what to buy next.

Linear and Gaussian: rows of torques along a motion, of sensors and of measured values add up to
information about the entries of all bodies, on top of their prior (`sensors.planning.knowledge`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, DescriptionError, unknown
from deltaid.identification.gains import SPREAD
from deltaid.levels import TORQUE_NOISE
from deltaid.model.model import Model, ModelLike, load
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.planning.knowledge import Knowledge, PlanUnknowns, unknowns
from deltaid.sensors.planning.null_space import DESCRIBED, TITLES, TORQUES, Opening, openings
from deltaid.sensors.planning.offers import Offers, load_offers, shipped_offers
from deltaid.sensors.planning.rows import (
    PlannedRecording,
    generic_motion,
    motion_of_file,
    torque_rows,
)
from deltaid.sensors.planning.shopping import (
    BODIES,
    GAINS,
    Goal,
    PurchaseStep,
    cost_of,
    enough,
    shopping,
)
from deltaid.sensors.planning.shopping import goal as goal_called
from deltaid.sensors.planning.uses import Use, described_rows, uses
from deltaid.shown import Plotted, Reported, Shown, Tabled


@dataclass(frozen=True)
class PlanSettings:
    """Assumptions of a plan.

    Attributes:
        torque_noise: standard deviation of the torques' noise, as a share of each drive's largest
            torque along the motion.
        rate: independent samples a second, of torques and of sensors.
        duration: of the generic motion [s].
        prior_spread: relative standard deviation of the prior, where the description states none.
        gain_spread: of the drives' torque constants; None for 0.1 if these are the goal, and for
            exact ones otherwise.
        enough: uncertainty that is good enough, as a share of an entry or of the largest force.
        steps: largest number of purchases.
        seed: of the generic motion.
    """

    torque_noise: float = TORQUE_NOISE
    rate: float = 200.0
    duration: float = 20.0
    prior_spread: float = PRIOR_SPREAD
    gain_spread: float | None = None
    enough: float = 0.01
    steps: int = 10
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Outlook:
    """Uncertainty after some measurements.

    Attributes:
        name, title: of the measurements.
        cost: of all of them.
        shares: standard deviation of each entry as a share of its size.
        goal: geometric mean of the goal's standard deviations, as a share.
        gain: by how much ½ log det of the goal's covariance falls [nats].
    """

    name: str
    title: str
    cost: float
    shares: Float[np.ndarray, " entries"] = field(repr=False)
    goal: float
    gain: float


@dataclass(frozen=True, eq=False, repr=False)
class SensorPlan(Shown, Plotted, Tabled, Reported):
    """A plan for one robot and one motion.

    Attributes:
        model: the robot with its parameters, taken for true.
        motion: in words.
        settings, offers: inputs of the plan.
        goal, goal_name: in words, and its name.
        unknowns: the entries, in the order of all shares.
        torques: uncertainty after torques alone.
        described: after these with the description's sensors and measured values; the same object
            where it has none.
        uses: after `described` and each use by itself.
        combinations: the same for several uses together.
        steps: purchases in order; without a budget, those that are enough.
        openings: directions that no row determines.
        notes: assumptions, in words.
        beyond: the next purchase, not worth its price; None with a budget.
    """

    model: Model
    motion: str
    settings: PlanSettings
    offers: Offers
    goal: str
    goal_name: str
    unknowns: PlanUnknowns
    torques: Outlook
    described: Outlook
    uses: tuple[Outlook, ...]
    combinations: tuple[Outlook, ...]
    steps: tuple[tuple[PurchaseStep, Outlook], ...]
    openings: tuple[Opening, ...]
    notes: tuple[str, ...]
    beyond: PurchaseStep | None = None

    @property
    def has_described(self) -> bool:
        """Whether the description has sensors or measured values."""
        return self.described is not self.torques

    @property
    def last(self) -> Outlook:
        """Uncertainty after all purchases."""
        return self.steps[-1][1] if self.steps else self.described

    def entry(self, name: str) -> int:
        """Position of an entry, such as 'S.mcx'.

        Raises:
            UnknownNameError: there is none of that name; the message has the nearest.
        """
        if name not in self.unknowns.names:
            raise unknown(name, self.unknowns.names, "entry", self.model.robot.name)
        return self.unknowns.names.index(name)


def sensor_plan(
    robot: ModelLike,
    motion: RecordingLike | None = None,
    *,
    offers: Offers | str | Path | None = None,
    goal: str = BODIES,
    budget: float | None = None,
    combinations: Sequence[Sequence[str]] = (),
    settings: PlanSettings | None = None,
    columns: MappingLike | None = None,
    progress: Watch = None,
) -> SensorPlan:
    """What sensors and scales would tell of a robot, and which are worth buying.

    Args:
        robot: a robot or a model, by value, name or file; its parameters are taken as true.
        motion: a planned motion or a recording, as a file, a table or arrays; a generic random one
            without.
        offers: a list of what could be bought, by value or file; the shipped one without.
        goal: 'bodies', a body, 'forces' or 'gains'.
        budget: largest total cost; without one, the plan ends where it is enough.
        combinations: names of uses that are tried together, in addition to the list's.
        settings: noise, prior and the like.
        columns: of a recording, by value or file.
        progress: called with each stage; or whether to show stages, None for where someone is
            watching.

    Raises:
        DeltaidError: no such goal, combination or body; a file that cannot be used.
    """
    model, mapping, settings = load(robot), as_mapping(columns), settings or PlanSettings()
    with watched(progress, "sensor plan") as say:
        place = f"{offers}, " if isinstance(offers, str | Path) else ""
        if not isinstance(offers, Offers):
            offers = shipped_offers() if offers is None else load_offers(offers)
        dynamics = compiled(model.as_description())
        say("looking at the motion")
        if motion is None:
            planned = generic_motion(dynamics, settings.duration, settings.seed)
        else:
            planned = motion_of_file(model, dynamics, motion, mapping)
        gain_spread = _gain_spread(goal, settings)
        entries = unknowns(dynamics.robot, settings.prior_spread, gain_spread)
        rate, noise = settings.rate, settings.torque_noise
        recorded = PlannedRecording.with_noise(dynamics, planned, rate, noise)
        say("looking at what could be bought")
        likely, sure = described_rows(recorded)
        try:
            possible, left_out = uses(recorded, offers)
        except DescriptionError as error:
            raise DescriptionError(
                error.what, where=f"{place}{error.where}", cure=error.cure
            ) from None
        aim, torque = goal_called(goal, entries, recorded, settings.enough), torque_rows(recorded)
        alone = entries.after(torque)
        outlooks = _Outlooks(entries, aim, entries.after(torque, likely))
        by_torques = described = outlooks.outlook(TORQUES, TITLES[TORQUES], alone, alone)
        if len(likely):
            described = outlooks.outlook(DESCRIBED, TITLES[DESCRIBED], outlooks.start, alone)
        say("comparing")
        greedy = shopping(outlooks.start, aim, possible, entries.W, budget, settings.steps)
        steps = enough(outlooks.start, aim, greedy, entries.W) if budget is None else greedy
        bought = [step.use for step in steps]
        tried = [_find(names, possible, offers) for names in (*combinations, *offers.combinations)]
        return SensorPlan(
            model=model,
            motion=planned.words,
            settings=settings,
            offers=offers,
            goal=aim.words,
            goal_name=goal,
            unknowns=entries,
            torques=by_torques,
            described=described,
            uses=tuple(outlooks.after([use]) for use in possible),
            combinations=tuple(outlooks.after(together) for together in tried if together),
            steps=tuple((step, outlooks.after(bought[: k + 1])) for k, step in enumerate(steps)),
            openings=openings(dynamics, planned, torque, sure, possible, bought),
            notes=(*_notes(entries, goal, gain_spread), *left_out),
            beyond=next((step for step in greedy if step.use not in bought), None),
        )


def _gain_spread(goal: str, settings: PlanSettings) -> float:
    if settings.gain_spread is None:
        return SPREAD if goal == GAINS else 0.0
    if goal == GAINS and settings.gain_spread == 0:
        raise DeltaidError(
            "gains that are known exactly are no goal", where="--gain-spread", cure="give a spread"
        )
    return settings.gain_spread


@dataclass(frozen=True, eq=False)
class _Outlooks:
    """Uncertainty of the entries and of a goal after measurements, the first of them `start`."""

    entries: PlanUnknowns
    aim: Goal
    start: Knowledge

    def outlook(
        self, name: str, title: str, known: Knowledge, before: Knowledge, cost: float = 0.0
    ) -> Outlook:
        return Outlook(
            name=name,
            title=title,
            cost=cost,
            shares=known.std * self.entries.spread,
            goal=self.aim.std(known),
            gain=self.aim.uncertainty(before) - self.aim.uncertainty(known),
        )

    def after(self, together: Sequence[Use]) -> Outlook:
        known = self.start.and_rows(np.vstack([use.likely for use in together]) @ self.entries.W)
        name, title = (
            " + ".join(getattr(use, key) for use in together) for key in ("name", "title")
        )
        return self.outlook(name, title, known, self.start, cost_of(together))


def _find(names: Sequence[str], possible: Sequence[Use], offers: Offers) -> list[Use]:
    """Uses by their names; none of them where the list's own combination does not fit.

    Raises:
        UnknownNameError: there is none of a name.
    """
    by_name = {use.name: use for use in possible}
    missing = [name for name in names if name not in by_name]
    if not missing:
        return [by_name[name] for name in names]
    if tuple(names) in offers.combinations:
        return []
    raise unknown(missing[0], by_name, "use", "--combine")


def _notes(entries: PlanUnknowns, aim: str, gain_spread: float) -> Iterator[str]:
    yield (
        "a plan asks for the true bodies, so all ten entries of each are unknown, whatever the key "
        "free says for a fit to torques"
        + (f"; known by the description: {', '.join(entries.known)}" if entries.known else "")
    )
    if gain_spread == 0:
        yield "drives' torque constants are taken to be right"
    elif aim != GAINS:
        yield f"drives' torque constants are known to {100 * gain_spread:.3g} %"
