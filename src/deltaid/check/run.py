"""All checks in order: of the description, of each recording, and of all recordings together."""

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
from deltaid.check.proposals import proved, unharmed
from deltaid.check.residual import checked_residual
from deltaid.check.sensors import checked_sensors
from deltaid.check.signal import checked_signals
from deltaid.check.verdicts import Verdicts
from deltaid.check.wiring.wiring import checked_wiring, checked_wirings
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
    """Checks of one kind on one recording."""

    check: OfRecording
    first: bool = False  # whether `identify` refuses what it calls wrong, before it fits
    # 'rows': whatever is wrong with the data; 'survey': of recordings that can be computed with and
    # in which nothing has been found wrong; 'fit': if there also is one.
    needs: Needs = "rows"
    alone: bool = True  # else recordings complement each other and are judged together


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
# Of several recordings: columns and information are judged together.
OF_SEVERAL = tuple(family for family in OF_RECORDING[1:] if family.alone)


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
            judged on its own, but their columns, and what they tell of the parameters, by all of
            them together.
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
        sources, judged = as_sources(logs), of_robot(description)
        mappings, fitting = mapping_each(columns, len(sources)), settings_of(settings)
        informations, strokes, several = list[Information](), list[np.ndarray](), len(sources) > 1
        families, of_logs = OF_SEVERAL if several else OF_RECORDING, list[Verdict]()
        places = zip(sources, mappings, strict=True)
        records = [evidence(description, *place, fitting) for place in places]
        common: tuple[Verdict, ...] = ()
        on_columns: list[tuple[Verdict, ...]] = [()] * len(records)
        if several:
            say("checking the columns of all recordings")
            common, on_columns = checked_wirings(records)
        for record, wiring in zip(records, on_columns, strict=True):
            say(f"checking {record.source}")
            _ = record.rows  # what cannot be read at all is an error and no verdict
            judged, common = unharmed(record, judged), unharmed(record, common)
            if worst(common) is Grade.WRONG:  # what rests on it would only repeat it
                on_log = wiring + asked(record, families, "rows")
            else:
                on_log = of_recording(record, families, wiring)
            on_log = proved(record, on_log)
            of_logs += named(record, on_log, several=several)
            wrong = Grade.WRONG in (worst(common), worst(on_log))
            if several and not wrong and (known := information_of(record)):
                informations.append(known)
                strokes.append(record.moved)
        if several and len(informations) == len(sources):
            say("checking what they tell together")
            of_logs += judged_information(compiled(description), merge(informations), strokes)
        return Verdicts((*judged, *common, *of_logs), description, sources, mappings)


def of_robot(
    robot: RobotDescription, families: Iterable[OfRobot] = OF_ROBOT
) -> tuple[Verdict, ...]:
    """Verdicts on a description; where something is wrong, not those that it would only repeat."""
    judged: list[Verdict] = []
    for family in families:
        if family in QUICK_OF_ROBOT or worst(judged) is not Grade.WRONG:
            judged += family(robot)
    return tuple(judged)


def of_recording(
    record: Evidence,
    checks: Iterable[Family] = OF_RECORDING,
    known: tuple[Verdict, ...] = (),
) -> tuple[Verdict, ...]:
    """All verdicts on one recording, after those that are known.

    An error of survey or fit is reported as it is where no check explains it.
    """
    judged = known + asked(record, checks, "rows")
    if worst(judged) is not Grade.WRONG and not isinstance(record.surveyed, DeltaidError):
        judged += asked(record, checks, "survey")
    if worst(judged) is Grade.WRONG:  # what rests on it would only repeat it
        return judged
    if isinstance(error := record.fitted, DeltaidError):
        return (*judged, Verdict("refused", Grade.WRONG, error.what, error.where, "", error.cure))
    return judged + asked(record, checks, "fit")


def asked(record: Evidence, families: Iterable[Family], needs: Needs) -> tuple[Verdict, ...]:
    """The verdicts of those families that need this."""
    return tuple(v for family in families if family.needs == needs for v in family.check(record))


def named(record: Evidence, judged: Iterable[Verdict], *, several: bool) -> tuple[Verdict, ...]:
    """Verdicts on one of several recordings say which."""
    if not several:
        return tuple(judged)
    name = record.table.path.name
    return tuple(
        replace(verdict, subject=f"{name}: {verdict.subject}" if verdict.subject else name)
        for verdict in judged
    )
