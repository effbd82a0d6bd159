"""The function `check`: all checks in order, without an identification."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.checks.at_rest import checked_workspace
from deltaid.checks.closed_loop import checked_feedback
from deltaid.checks.description import (
    checked_friction,
    checked_gravity,
    checked_lengths,
    checked_limits,
)
from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.information import checked_information, information_of, judged_information
from deltaid.checks.priors import checked_inertia, checked_measured
from deltaid.checks.proposals import confirmed, not_refuted
from deltaid.checks.residual import checked_residual, load_held_throughout
from deltaid.checks.sensing.sensors import checked_sensors
from deltaid.checks.signal import checked_signals
from deltaid.checks.verdicts import Verdicts, as_written, changes, with_changes
from deltaid.checks.wiring.wiring import checked_wirings, too_short_verdicts
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, DescriptionError, Doubt, LostReadingError
from deltaid.estimation.information import Information, merge
from deltaid.identification.study import Study
from deltaid.identification.whole_loads import heavier
from deltaid.model.settings import Settings, settings_of
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import FOUND, ColumnMapping, ColumnMappings, mapping_each
from deltaid.recording.memory import Recording, RecordingLike, as_sources
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, described_in, load_robot, yaml_text


def check(
    robot: RobotLike,
    logs: RecordingLike | Sequence[RecordingLike] = (),
    *,
    columns: ColumnMappings = None,
    settings: Settings | Mapping[str, Any] | None = None,
    progress: Watch = None,
    **options: Any,
) -> Verdicts:
    """Check a robot's description and recordings of it before they are used.

    Args:
        robot: a description, a catalogue name, or a file of a robot or of a model.
        logs: none, one recording or a sequence of them, as for `identify`. Each is judged alone,
            but columns, and the parameters that recordings determine, are judged together.
        columns: names and units of their columns, if not the default ones, and held loads: one
            mapping for all recordings, or one for each.
        settings: of the judged fit, by value or as a dictionary.
        progress: called with a sentence before each stage; or whether to show these sentences,
            None for only in a notebook or at a prompt.
        options: single settings by name, such as `cutoff=30`.

    Returns:
        Verdicts, a tuple in the order of the checks; with several recordings each names its own.

    Raises:
        DescriptionError: the robot does not exist, or its file does not describe one.
        RecordingError: a recording cannot be read at all.
    """
    with watched(progress, "check") as say:
        say("checking the description")
        try:
            description = load_robot(robot)
        except DescriptionError:
            if (verdict := _in_metres(robot)) is None:
                raise
            return Verdicts((verdict,), given=robot)
        sources = as_sources(logs)
        judged = of_robot(description, recorded=bool(sources))
        several, fitting = len(sources) > 1, settings_of(settings, options)
        records, mappings = _opened(description, sources, columns, fitting)
        if several:
            say("checking the columns of all recordings")
        common, on_columns = checked_wirings(records)
        informations, strokes, of_logs = list[Information](), list[np.ndarray](), list[Verdict]()
        studies = dict[int, Study | None]()
        for k, (record, wiring) in enumerate(zip(records, on_columns, strict=True)):
            say(f"checking {record.source}")
            _ = record.rows  # an unreadable recording is an error and no verdict
            judged, common = not_refuted(record, judged), not_refuted(record, common)
            if worst(common) is Grade.WRONG:  # later checks would only repeat it
                on_log = (*wiring, *checked_signals(record))
            else:
                on_log = of_recording(record, confirmed(record, wiring), several)
            on_log = confirmed(record, on_log)
            of_logs += named_verdicts(record, on_log, several=several)
            wrong = Grade.WRONG in (worst(common), worst(on_log))
            if several and not (wrong or record.stands or record.columns.loads):
                studies[k] = record.study
            if several and not (wrong or record.stands) and (known := information_of(record)):
                informations.append(known)
                strokes.append(record.moved)
        for k, excess in heavier(studies).items():
            of_logs += named_verdicts(records[k], [load_held_throughout(excess)], several=True)
        if informations and len(informations) == sum(not record.stands for record in records):
            say("checking what they determine together")
            of_logs += judged_information(compiled(description), merge(informations), strokes)
        verdicts = (*judged, *common, *of_logs)
        warnings = reading_warnings(
            ((record.table.path, record.doubts) for record in records), verdicts
        )
        return Verdicts(verdicts, description, sources, mappings, robot, warnings)


def reading_warnings(
    doubts: Iterable[tuple[Path, Iterable[Doubt]]], verdicts: Iterable[Verdict]
) -> tuple[str, ...]:
    """Warnings of reading recordings, by their paths, whose cause no verdict reports."""
    judged = {verdict.key for verdict in verdicts}
    return tuple(
        f"{path}: {doubt}"
        for path, of_recording in doubts
        for doubt in of_recording
        if doubt.key not in judged
    )


def _opened(
    robot: RobotDescription,
    sources: Sequence[Path | Recording],
    columns: ColumnMappings,
    settings: Settings,
) -> tuple[list[Evidence], list[ColumnMapping | None]]:
    """Recordings, and their mappings as given or found."""
    given = mapping_each(columns, len(sources))
    records = [
        evidence(robot, source, mapping, settings)
        for source, mapping in zip(sources, given, strict=True)
    ]
    return records, [
        record.mapping if record.mapping.source == FOUND else mapping
        for record, mapping in zip(records, given, strict=True)
    ]


def _in_metres(robot: RobotLike) -> Verdict | None:
    """The verdict on a robot file that fails to load because its lengths are in millimetres; else
    None."""
    try:
        data = as_written(robot)
        verdict = checked_lengths(data)
        described_in(yaml_text(with_changes(data, changes([verdict], "robot"))), str(robot))
    except DescriptionError:
        return None
    return verdict if verdict.grade is Grade.WRONG else None


def of_robot(
    robot: RobotDescription, *, quick: bool = False, recorded: bool = False
) -> tuple[Verdict, ...]:
    """Verdicts on a description. `quick`, or a wrong verdict, skips the workspace; `recorded` skips
    missing limits, which matter only for planning a motion."""
    judged = [checked_lengths(as_written(robot)), checked_friction(robot), checked_limits(robot)]
    if recorded and judged[-1].grade is not Grade.GOOD:
        del judged[-1]
    judged += (*checked_gravity(robot), *checked_inertia(robot), *checked_measured(robot))
    if not quick and worst(judged) is not Grade.WRONG:
        judged += checked_workspace(robot)
    return tuple(judged)


def of_recording(record: Evidence, wiring: Sequence[Verdict], several: bool) -> tuple[Verdict, ...]:
    """All verdicts on a recording, those on its columns first. Information is judged here only for
    a single recording; several complement each other.

    An error of survey or fit becomes a verdict unless a check explains it. Lost readings are judged
    alone: other checks take them for a fast motion.
    """
    is_lost = isinstance(record.setup, LostReadingError)
    judged = [] if is_lost else [*wiring, *checked_signals(record)]
    if worst(judged) is not Grade.WRONG and not record.stands and record.surveyed is not None:
        judged += checked_sensors(record)
        judged += () if several else checked_information(record)
    if worst(judged) is Grade.WRONG or record.stands:  # later checks would only repeat it
        return tuple(judged)
    if isinstance(error := record.fitted, DeltaidError):
        return (*judged, Verdict("refused", Grade.WRONG, error.what, error.where, "", error.cure))
    judged += too_short_verdicts(record, wiring)
    return (*judged, *checked_residual(record), *checked_feedback(record))


def named_verdicts(
    record: Evidence, judged: Iterable[Verdict], *, several: bool
) -> tuple[Verdict, ...]:
    """Verdicts that name their recording if it is one of several."""
    if not several:
        return tuple(judged)
    path = record.table.path
    return tuple(
        verdict  # of a refusal, whose place has the file
        if verdict.subject.startswith(str(path))
        else replace(verdict, subject=": ".join(filter(None, (path.name, verdict.subject))))
        for verdict in judged
    )
