"""`deltaid check`: what is wrong with a description and with recordings, before they are used."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

import deltaid
from deltaid.cli.options import AsJson, ColumnFiles, Cutoff, KeepAll, Report, Robot, output_file
from deltaid.cli.output import console, print_json, print_note, progress, styled, verdicts_shown
from deltaid.cli.output_files import print_written, require_outputs, write_files
from deltaid.errors import DescriptionError

if TYPE_CHECKING:
    from deltaid.checks.verdicts import File

# Exit codes by the most severe verdict; 1 and 2 mean what they mean everywhere.
EXIT = {"good": 0, "cannot tell": 3, "doubtful": 3, "wrong": 4}
_BELONGS: dict["File", str] = {"robot": "the robot file", "mapping": "the mapping (--columns)"}


def check(
    robot: Robot,
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Recordings; without any, the description only.")
    ] = None,
    columns: ColumnFiles = None,
    cutoff: Cutoff = None,
    write: Annotated[
        Path | None,
        output_file(help="Where to write the robot file or mapping with all that is proposed."),
    ] = None,
    report: Report = None,
    keep_all: KeepAll = False,
    full: Annotated[
        bool, typer.Option("--full", help="List what is good too, with its numbers.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Find what is wrong with a description or recording.

    Each finding comes with its likeliest cause and how to correct it.

    Exit code 0: all is good; 3: something is doubtful or cannot be told; 4: something is wrong.
    """
    from deltaid.checks.verdicts import as_written
    from deltaid.recording.mapping import FOUND, as_words
    from deltaid.view.check import tally, verdict_table

    logs, targets = logs or [], dict["File", Path]()
    if write is not None:  # where each file goes if both have something proposed
        targets["robot"] = write.with_name(f"{write.stem}-robot{write.suffix}")
        targets["mapping"] = write.with_name(f"{write.stem}-columns{write.suffix}")
    for path in (write, *targets.values()):
        require_outputs([robot, *logs, *(columns or ())], {"--write": path, "--report": report})
    with progress(as_json) as say:
        settings = deltaid.Settings(cutoff=cutoff, keep_all=keep_all)
        verdicts = deltaid.check(robot, logs, columns=columns, settings=settings, progress=say)
    for log, mapping in zip(logs, verdicts.mappings, strict=False):  # none of a broken description
        if mapping is not None and mapping.source == FOUND:
            print_note(f"{log}: {as_words(mapping)}; `deltaid columns {log} {robot}` says why")
    with progress(as_json):
        cures = _cures(robot, columns or [], logs, verdicts)
    if write is not None and len(cures) == 1:
        targets = {cures[0].file: write}
    write_files(
        *((targets.get(cure.file), cure.text) for cure in cures),
        (report, lambda path: _write_report(robot, verdicts, logs, cures, path)),
    )
    if as_json:
        print_json(
            {
                "robot": as_written(robot).get("name"),
                "grade": verdicts.grade,
                "verdicts": [
                    {
                        "key": verdict.key,
                        "grade": verdict.grade,
                        "subject": verdict.subject,
                        "seen": verdict.seen,
                        "number": verdict.number,
                        "unit": verdict.unit,
                        "cause": verdict.cause,
                        "cure": verdict.cure,
                        "proposals": [
                            {"file": proposal.file, "changes": dict(proposal.changes)}
                            for proposal in verdict.proposals
                        ],
                    }
                    for verdict in verdicts
                ],
            }
        )
    else:
        if listed := verdicts if full else verdicts.poor:  # the most severe first
            console.print(verdicts_shown(verdict_table(listed)))
            console.print()
        console.print(tally(verdicts))
        for cure in cures:
            console.print()
            console.print(styled(f"into {_BELONGS[cure.file]}:"))
            console.print(cure.lines)
        for cure in cures if write else ():
            path = targets[cure.file]
            with_it = f"give it with --columns {path}"
            use = "use it in place of the robot" if cure.file == "robot" else with_it
            console.print(f"wrote {path}; {use}")
        if write is not None and not cures:
            nothing = "no verdict proposes a line of robot file or mapping"
            console.print(f"nothing was written: {nothing}")
        print_written(report)
    raise typer.Exit(EXIT[verdicts.grade])


class Cure(NamedTuple):
    """One file with all that is proposed for it: changed keys to paste, and the whole text."""

    file: "File"
    lines: str
    text: str


def _cures(
    robot: str, columns: Sequence[Path], logs: Sequence[Path], verdicts: "deltaid.Verdicts"
) -> list[Cure]:
    """Files with what is proposed; of several mappings none, for they differ."""
    from deltaid.checks.evidence import evidence
    from deltaid.checks.verdicts import (
        as_written,
        changes,
        files_of,
        mapping_text,
        pasted,
        robot_text,
    )
    from deltaid.robot.load import described

    cures = list[Cure]()
    for file in files_of(verdicts):
        wanted = changes(verdicts, file)
        if file == "robot":
            data, text = as_written(robot), robot_text(robot, wanted)
        elif len(columns) > 1:
            print_note("to have a mapping corrected, check its recording alone")
            continue
        else:
            path = columns[0] if columns else None
            record = evidence(described(robot), logs[0], path and deltaid.load_mapping(path))
            data, text = record.written_mapping, mapping_text(record, wanted, path)
        cures.append(Cure(file, pasted(data, wanted), text))
    return cures


def _write_report(
    robot: str,
    verdicts: "deltaid.Verdicts",
    logs: Sequence[Path],
    cures: Sequence[Cure],
    path: Path,
) -> None:
    """Write the page, which names files; that of `Verdicts.report` needs a robot."""
    from deltaid.checks.verdicts import as_written
    from deltaid.dynamics.dynamics import compiled
    from deltaid.robot.load import described
    from deltaid.view.check import check_page
    from deltaid.view.drawing import drawing
    from deltaid.view.html import write_page

    try:
        description = described(robot)
        picture = drawing(description, compiled(description).kinematics)
    except DescriptionError:  # which the verdicts tell
        picture = None
    lines, data = {_BELONGS[cure.file]: cure.lines for cure in cures}, as_written(robot)
    title = str(data.get("title") or data.get("name") or robot)
    write_page(check_page(title, verdicts, [log.name for log in logs], lines, picture), path)
