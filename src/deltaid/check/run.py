"""All checks in order: of the description, of each recording, and of what they tell together."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from deltaid.check.closed_loop import checked_feedback
from deltaid.check.description import checked_friction, checked_limits, checked_workspace
from deltaid.check.evidence import Evidence, evidence
from deltaid.check.information import checked_information, information_of, judged_information
from deltaid.check.lengths import checked_lengths
from deltaid.check.mended import in_metres
from deltaid.check.priors import checked_measured, checked_priors
from deltaid.check.residual import checked_residual
from deltaid.check.sensors import checked_sensors
from deltaid.check.signal import checked_signals
from deltaid.check.verdicts import Verdicts
from deltaid.check.wiring.wiring import checked_wiring
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.estimation.information import Information, merge
from deltaid.model.settings import Settings, settings_of
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import ColumnMappings, mapping_each
from deltaid.recording.memory import RecordingLike, as_sources
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, described

Needs = Literal["rows", "survey", "fit"]
OfRobot = Callable[[RobotDescription], Iterable[Verdict]]
OfRecording = Callable[[Evidence], Iterable[Verdict]]


@dataclass(frozen=True)
class Family:
    """Checks of one sort on one recording, with a verdict for whatever they looked at."""

    check: OfRecording
    first: bool = False  # whether `identify` refuses what it calls wrong, before it fits
    # 'rows': whatever is wrong with the data; 'survey': of recordings that can be computed with and
    # in which nothing has been found wrong; 'fit': if there also is one.
    needs: Needs = "rows"
    alone: bool = True  # else one recording may tell what another leaves open: judged together


# One entry a family, in the order of the table of verdicts.
QUICK_OF_ROBOT: tuple[OfRobot, ...] = (
    lambda robot: (checked_lengths(robot.model_dump(mode="json", exclude_none=True)),),
    checked_friction,
    checked_limits,
    checked_priors,
    checked_measured,
)
OF_ROBOT: tuple[OfRobot, ...] = (*QUICK_OF_ROBOT, checked_workspace)
OF_RECORDING: tuple[Family, ...] = (
    Family(checked_wiring, first=True),
    Family(checked_signals),
    Family(checked_sensors, first=True, needs="survey"),
    Family(checked_information, needs="survey", alone=False),
    Family(checked_residual, needs="fit"),
    Family(checked_feedback, needs="fit"),
)


def verdicts(
    robot: RobotLike,
    logs: RecordingLike | Sequence[RecordingLike] = (),
    *,
    columns: ColumnMappings = None,
    settings: Settings | Mapping[str, Any] | None = None,
    progress: Watch = None,
) -> Verdicts:
    """What is wrong with a robot's description and with recordings of it, before they are used.

    Args:
        robot: a description, or what has one: a catalogue name, a file of a robot or of a model.
        logs: none, one recording or a sequence of them, the same as `identify` takes. Each is
            judged on its own, but what they tell of the parameters by all of them together.
        columns: names and units of their columns, if not the default ones, and loads that are
            held: one mapping for all recordings, or one each.
        settings: of the fit that verdicts on the fit rest on, by value or as a dictionary.
        progress: called with a sentence before each stage; or whether to show them, None for where
            someone is watching.

    Returns:
        Verdicts, a tuple of them in the order of what they look at; of several recordings each
        names its own.

    Raises:
        DescriptionError: there is no such robot, or its file does not describe one.
        RecordingError: a recording cannot be read at all.
    """
    with watched(progress, "check") as say:
        say("checking the description")
        try:
            description = described(robot)
        except DescriptionError:
            if (verdict := in_metres(robot)) is None:
                raise
            return Verdicts((verdict,))
        sources, found = as_sources(logs), list(of_robot(description))
        mappings, fitting = mapping_each(columns, len(sources)), settings_of(settings)
        known, moved, several = list[Information](), list[np.ndarray](), len(sources) > 1
        families = [family for family in OF_RECORDING if family.alone or not several]
        for source, mapping in zip(sources, mappings, strict=True):
            say(f"checking {source}")
            one = evidence(description, source, mapping, fitting)
            _ = one.rows  # what cannot be read at all is an error and no verdict
            said = of_recording(one, families)
            found += named(one, said, several=several)
            if several and worst(said) is not Grade.WRONG and (told := information_of(one)):
                known.append(told)
                moved.append(one.moved)
        if several and len(known) == len(sources):
            say("checking what they tell together")
            found += judged_information(compiled(description), merge(known), moved)
        return Verdicts(found, description, sources, mappings)


def of_robot(
    robot: RobotDescription, families: Iterable[OfRobot] = OF_ROBOT
) -> tuple[Verdict, ...]:
    """Verdicts on a description; where something is wrong, not those that it would only repeat."""
    found: list[Verdict] = []
    for family in families:
        if family in QUICK_OF_ROBOT or worst(found) is not Grade.WRONG:
            found += family(robot)
    return tuple(found)


def of_recording(one: Evidence, families: Iterable[Family] = OF_RECORDING) -> tuple[Verdict, ...]:
    """All verdicts on one recording.

    A refusal of the survey or of the fit is said in its own words where no check knows better.
    """
    found = asked(one, families, "rows")
    if worst(found) is not Grade.WRONG and not isinstance(one.surveyed, DeltaidError):
        found += asked(one, families, "survey")
    if worst(found) is Grade.WRONG:  # what rests on it would only repeat it
        return found
    if isinstance(error := one.fitted, DeltaidError):
        return (*found, Verdict("refused", Grade.WRONG, error.what, error.where, "", error.cure))
    return found + asked(one, families, "fit")


def asked(one: Evidence, families: Iterable[Family], needs: Needs) -> tuple[Verdict, ...]:
    """The verdicts of those families that need this."""
    return tuple(v for family in families if family.needs == needs for v in family.check(one))


def named(one: Evidence, found: Iterable[Verdict], *, several: bool) -> tuple[Verdict, ...]:
    """Verdicts on one of several recordings say which."""
    if not several:
        return tuple(found)
    name = one.table.path.name
    return tuple(
        replace(verdict, subject=f"{name}: {verdict.subject}" if verdict.subject else name)
        for verdict in found
    )
