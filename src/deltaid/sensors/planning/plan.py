"""What torques leave open of a robot, what each measurement would make of it, and what to buy next.

Linear and Gaussian: rows of torques along a motion, of sensors and of measured values add up to
information about the entries of all bodies, on top of their prior (`sensors.planning.unknowns`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, unknown
from deltaid.identification.gains import SPREAD
from deltaid.model.model import Model, ModelLike, load
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike
from deltaid.sensors.planning.bench import Bench, Outlook, PlanSettings
from deltaid.sensors.planning.knowledge import Unknowns, unknowns
from deltaid.sensors.planning.null_space import Opening, openings
from deltaid.sensors.planning.offers import Offers, load_offers, shipped_offers
from deltaid.sensors.planning.rows import generic_motion, motion_of_file
from deltaid.sensors.planning.shopping import BODIES, GAINS, Step, shopping
from deltaid.shown import Plotted, Reported, Shown, Tabled


@dataclass(frozen=True, eq=False, repr=False)
class SensorPlan(Shown, Plotted, Tabled, Reported):
    """A plan for one robot and one motion.

    Attributes:
        model: the robot with the parameters that are taken for true.
        motion: in words.
        settings, offers: what it was made with.
        goal: what is wanted, in words; and by its name.
        unknowns: the entries, in the order of all shares.
        torques: what torques alone tell.
        described: what they do with the sensors and measured values of the robot's description;
            the same where it has none.
        uses: what each thing would make of the latter, by itself.
        combinations: the same of several together.
        steps: what to buy, one after the other.
        openings: what no row sees, by what there is.
        notes: what it takes for granted, in words.
    """

    model: Model
    motion: str
    settings: PlanSettings
    offers: Offers
    goal: str
    goal_name: str
    unknowns: Unknowns
    torques: Outlook
    described: Outlook
    uses: tuple[Outlook, ...]
    combinations: tuple[Outlook, ...]
    steps: tuple[tuple[Step, Outlook], ...]
    openings: tuple[Opening, ...]
    notes: tuple[str, ...]

    @property
    def has_described(self) -> bool:
        """Whether the description has sensors or measured values."""
        return self.described is not self.torques

    @property
    def last(self) -> Outlook:
        """What is known when all has been bought that is worth it."""
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
        robot: a robot or a model, by value, name or file; its parameters are taken for true.
        motion: a planned motion or a recording, as a file, a table or arrays; a generic random one
            without.
        offers: a list of what could be bought, by value or file; the shipped one without.
        goal: 'bodies', a body, 'forces' or 'gains'.
        budget: most that all may cost.
        combinations: names of uses that are tried together, besides those of the list.
        settings: noise, prior and the like.
        columns: of a recording, by value or file.
        progress: is told what is being done; or whether to show it, None for where someone is
            watching.

    Raises:
        DeltaidError: no such goal, combination or body; a file that cannot be used.
    """
    model, mapping, settings = load(robot), as_mapping(columns), settings or PlanSettings()
    with watched(progress, "sensor plan") as say:
        if not isinstance(offers, Offers):
            offers = shipped_offers() if offers is None else load_offers(offers)
        dynamics = compiled(model.as_description())
        say("looking at the motion")
        if motion is None:
            planned = generic_motion(dynamics, settings.duration, settings.seed)
        else:
            planned = motion_of_file(model, dynamics, motion, mapping)
        gain_spread = settings.gain_spread
        if gain_spread is None:
            gain_spread = SPREAD if goal == GAINS else 0.0
        entries = unknowns(dynamics.robot, settings.prior_spread, gain_spread)
        if goal == GAINS and gain_spread == 0:
            raise DeltaidError(
                "gains that are known exactly are no goal",
                where="--gain-spread",
                cure="give a spread",
            )
        work = Bench.prepare(dynamics, planned, offers, entries, goal, settings, say)
        say("comparing")
        steps = shopping(work.start, work.goal, work.uses, entries.W, budget, settings.steps)
        named = (*combinations, *offers.combinations)
        return SensorPlan(
            model=model,
            motion=planned.words,
            settings=settings,
            offers=offers,
            goal=work.goal.words,
            goal_name=goal,
            unknowns=entries,
            torques=work.torques,
            described=work.described,
            uses=tuple(work.outlook([use]) for use in work.uses),
            combinations=tuple(
                work.outlook(some) for some in (work.find(names, offers) for names in named) if some
            ),
            steps=tuple(
                (step, work.outlook([bought.use for bought in steps[: k + 1]]))
                for k, step in enumerate(steps)
            ),
            openings=openings(
                dynamics, planned, work.torque, work.sure, work.uses, [step.use for step in steps]
            ),
            notes=(*_notes(entries, goal, gain_spread), *work.left_out),
        )


def _notes(entries: Unknowns, aim: str, gain_spread: float) -> tuple[str, ...]:
    """What a plan takes for granted."""
    notes = [
        "a plan asks for the true bodies, so all ten entries of each are unknown, whatever the key "
        "free says for a fit to torques"
        + (f"; known by the description: {', '.join(entries.known)}" if entries.known else "")
    ]
    if gain_spread == 0:
        notes.append("drives' torque constants are taken to be right")
    elif aim != GAINS:
        notes.append(f"drives' torque constants are known to {100 * gain_spread:.3g} %")
    return tuple(notes)
