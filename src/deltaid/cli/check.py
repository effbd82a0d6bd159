"""`deltaid check`: what is wrong with a description and with recordings, before they are used."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import (
    AsJson,
    ColumnFiles,
    Cutoff,
    KeepAll,
    Report,
    Robot,
    mappings,
    output_file,
)
from deltaid.cli.output import (
    console,
    print_json,
    print_note,
    print_written,
    progress,
    require_outputs,
    styled,
    verdicts_shown,
)
from deltaid.files import together, written_whole

if TYPE_CHECKING:
    from deltaid.checks.verdicts import Changes, Data, File, Verdicts
    from deltaid.model.verdict import Verdict
    from deltaid.recording.mapping import ColumnMapping
    from deltaid.view.page import Drawing

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
    from deltaid.checks.run import check as run
    from deltaid.model.record import Settings
    from deltaid.recording.mapping_proposal import FOUND, as_words

    logs = logs or []
    targets = _targets(write)
    for path in (write, *targets.values()):
        require_outputs([robot, *logs, *(columns or ())], {"--write": path, "--report": report})
    given = mappings(columns)
    with progress(as_json) as say:
        settings = Settings(cutoff=cutoff, keep_all=keep_all)
        verdicts = run(robot, logs, columns=given, settings=settings, progress=say)
    for log, mapping in zip(logs, verdicts.mappings, strict=False):  # none of a broken description
        if mapping is not None and mapping.source == FOUND:
            print_note(f"{log}: {as_words(mapping)}; `deltaid columns {log} {robot}` says why")
    with progress(as_json):
        cures = _cures(robot, given, logs, verdicts, columns)
    written: dict[File, Path] = {}
    with together():
        if write is not None:
            for cure in cures:
                written[cure.file] = targets[cure.file] if len(cures) > 1 else write
                with written_whole(written[cure.file]) as file:
                    file.write(cure.text)
        if report is not None:
            _write_report(robot, verdicts, logs, cures, report)
    if as_json:
        print_json(as_dictionary(robot, verdicts))
    else:
        _print(verdicts if full else verdicts.poor, verdicts)
        _print_cures(cures, written)
        if write is not None and not cures:
            nothing = "no verdict proposes a line of robot file or mapping"
            console.print(f"nothing was written: {nothing}")
        print_written(report)
    raise typer.Exit(EXIT[verdicts.grade])


@dataclass(frozen=True)
class Cure:
    """One file with all that is proposed for it, as plain data and as the user's text."""

    file: "File"
    data: "Data"
    changes: "Changes"
    text: str

    @property
    def lines(self) -> str:
        """The changed keys, to paste."""
        from deltaid.checks.verdicts import to_paste
        from deltaid.robot.load import yaml_text

        return yaml_text(to_paste(self.data, self.changes))


def _cures(
    robot: str,
    given: "Sequence[ColumnMapping] | None",
    logs: Sequence[Path],
    verdicts: "Verdicts",
    columns: Sequence[Path] | None,
) -> tuple[Cure, ...]:
    """Files with what is proposed; of several mappings none, for they differ."""
    from deltaid.checks.evidence import evidence
    from deltaid.checks.verdicts import (
        as_written,
        changes,
        files_of,
        mapping_text,
        mended,
        robot_text,
    )
    from deltaid.robot.load import described

    cures: list[Cure] = []
    for file in files_of(verdicts):
        wanted = changes(verdicts, file)
        if file == "robot":
            data, text = as_written(robot), robot_text(robot, wanted)
        elif given is not None and len(given) > 1:
            print_note("to have a mapping corrected, check its recording alone")
            continue
        else:
            record = evidence(described(robot), logs[0], given[0] if given else None)
            data = record.written_mapping
            text = mapping_text(record, wanted, columns[0] if columns else None)
        cures.append(Cure(file, mended(data, wanted), wanted, text))
    return tuple(cures)


def _targets(write: Path | None) -> "dict[File, Path]":
    """Where each file goes if both have something proposed."""
    if write is None:
        return {}
    return {
        "robot": write.with_name(f"{write.stem}-robot{write.suffix}"),
        "mapping": write.with_name(f"{write.stem}-columns{write.suffix}"),
    }


def _write_report(
    robot: str, verdicts: "Verdicts", logs: Sequence[Path], cures: Sequence[Cure], path: Path
) -> None:
    """Write the page, which names files; that of `Verdicts.report` needs a robot."""
    from deltaid.checks.verdicts import as_written
    from deltaid.view.check import check_page
    from deltaid.view.html import write_page

    lines = {_BELONGS[cure.file]: cure.lines for cure in cures}
    data = as_written(robot)
    title = str(data.get("title") or data.get("name") or robot)
    page = check_page(title, verdicts, [log.name for log in logs], lines, _drawn(robot))
    write_page(page, path)


def _drawn(robot: str) -> "Drawing | None":
    """The robot, unless its description cannot be read, which the verdicts tell."""
    from deltaid.dynamics.dynamics import compiled
    from deltaid.errors import DescriptionError
    from deltaid.robot.load import described
    from deltaid.view.drawing import drawing

    try:
        description = described(robot)
    except DescriptionError:
        return None
    return drawing(description, compiled(description).kinematics)


def as_dictionary(robot: str, verdicts: "Verdicts") -> dict[str, Any]:
    """All verdicts as one JSON object."""
    from deltaid.checks.verdicts import as_written

    return {
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


def _print(listed: "Sequence[Verdict]", verdicts: "Verdicts") -> None:
    """Some verdicts, the most severe first, and how many there are of each grade."""
    from deltaid.view.check import tally, verdict_table

    if listed:
        console.print(verdicts_shown(verdict_table(listed)))
        console.print()
    console.print(tally(verdicts))


def _print_cures(cures: Sequence[Cure], written: "dict[File, Path]") -> None:
    for cure in cures:
        console.print()
        console.print(styled(f"into {_BELONGS[cure.file]}:"))
        console.print(cure.lines.rstrip())
    for file, path in written.items():
        how = (
            "use it in place of the robot" if file == "robot" else f"give it with --columns {path}"
        )
        console.print(f"wrote {path}; {how}")
