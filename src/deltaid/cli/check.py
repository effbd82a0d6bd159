"""`deltaid check`: what is wrong with a description and with recordings, before they are used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import ColumnFiles, KeepAll, mappings, output_file

if TYPE_CHECKING:
    from deltaid.checks.verdicts import Changes, Data, File
    from deltaid.model.verdict import Verdict
    from deltaid.recording.mapping import ColumnMapping
    from deltaid.view.page import Drawing

# Exit codes by the most severe verdict; 1 and 2 mean what they mean everywhere.
EXIT = {"good": 0, "cannot tell": 3, "doubtful": 3, "wrong": 4}
_BELONGS: dict["File", str] = {"robot": "the robot file", "mapping": "the mapping (--columns)"}


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("check")(check)


def check(
    robot: Annotated[str, typer.Argument(help="Catalogue name, or a robot or model file.")],
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Recordings; without any, the description only.")
    ] = None,
    columns: ColumnFiles = None,
    cutoff: Annotated[
        float | None, typer.Option(help="Low-pass cut-off in Hz. Default: from the data.")
    ] = None,
    write: Annotated[
        Path | None,
        output_file(help="Where to write the robot file or mapping with all that is proposed."),
    ] = None,
    report: Annotated[
        Path | None, output_file(help="HTML page of all verdicts, works offline.")
    ] = None,
    keep_all: KeepAll = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell what is wrong with a robot's description and recordings, why, and how to mend it.

    Exit code 0: all is good; 3: something is doubtful or cannot be told; 4: something is wrong.
    """
    from deltaid.checks.run import check as run
    from deltaid.cli.output import console, print_json, progress, require_outputs
    from deltaid.errors import positive
    from deltaid.files import together
    from deltaid.model.record import Settings
    from deltaid.model.verdict import worst

    logs = logs or []
    positive("--cutoff", cutoff)
    inputs = [Path(robot), *logs, *(columns or ())]
    targets = _targets(write)
    require_outputs(inputs, {"--write": write}, report)
    if write is not None:
        require_outputs(inputs, {f"--write {write}": path for path in targets.values()}, report)
    given = mappings(columns)
    with progress(as_json) as say:
        settings = Settings(cutoff=cutoff, keep_all=keep_all)
        found = run(robot, logs, columns=given, settings=settings, progress=say)
        cures = _cures(robot, given, logs, found)
    with together():
        written = _write(cures, write, targets)
        if report is not None:
            _write_report(robot, found, logs, cures, report)
    if as_json:
        print_json(as_dictionary(robot, found))
    else:
        print_verdicts(found)
        _print_cures(cures, written, wanted=write is not None)
        if report is not None:
            console.print(f"wrote {report}")
    raise typer.Exit(EXIT[worst(found)])


@dataclass(frozen=True)
class Cure:
    """One file with all that is proposed for it, as plain data."""

    file: "File"
    data: "Data"
    changes: "Changes"

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
    found: "Sequence[Verdict]",
) -> tuple[Cure, ...]:
    """Files with what is proposed; of several mappings none, for they differ."""
    from deltaid.checks.evidence import evidence
    from deltaid.checks.verdicts import as_written, changes, files_of, mended
    from deltaid.cli.output import print_note
    from deltaid.robot.load import described

    cures: list[Cure] = []
    mapping = given[0] if given else None
    for file in files_of(found):
        if file == "mapping" and given is not None and len(given) > 1:
            print_note("to have a mapping mended, check its recording alone")
            continue
        if file == "robot":
            data = as_written(robot)
        else:
            data = evidence(described(robot), logs[0], mapping).written_mapping
        wanted = changes(found, file)
        cures.append(Cure(file, mended(data, wanted), wanted))
    return tuple(cures)


def _targets(write: Path | None) -> "dict[File, Path]":
    """Where each file goes if both have something proposed."""
    if write is None:
        return {}
    return {
        "robot": write.with_name(f"{write.stem}-robot{write.suffix}"),
        "mapping": write.with_name(f"{write.stem}-columns{write.suffix}"),
    }


def _write(
    cures: Sequence[Cure], write: Path | None, targets: "Mapping[File, Path]"
) -> "dict[File, Path]":
    """Write what is mended: one file under the name that was asked for, two beside it."""
    from deltaid.files import written_whole
    from deltaid.robot.load import yaml_text

    written: dict[File, Path] = {}
    for cure in cures if write is not None else ():
        path = targets[cure.file] if len(cures) > 1 else write
        assert path is not None
        with written_whole(path) as file:
            file.write(yaml_text(cure.data))
        written[cure.file] = path
    return written


def _write_report(
    robot: str,
    found: "Sequence[Verdict]",
    logs: Sequence[Path],
    cures: Sequence[Cure],
    path: Path,
) -> None:
    from deltaid.checks.verdicts import as_written
    from deltaid.view.check import check_page
    from deltaid.view.html import write_page

    lines = {_BELONGS[cure.file]: cure.lines for cure in cures}
    data = as_written(robot)
    title = str(data.get("title") or data.get("name") or robot)
    page = check_page(title, found, [log.name for log in logs], lines, _drawn(robot))
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


def as_dictionary(robot: str, found: "Sequence[Verdict]") -> dict[str, Any]:
    """All verdicts as one JSON object."""
    from deltaid.checks.verdicts import as_written
    from deltaid.model.verdict import worst

    return {
        "robot": as_written(robot).get("name"),
        "grade": worst(list(found)),
        "verdicts": [verdict_dictionary(one) for one in found],
    }


def verdict_dictionary(one: "Verdict") -> dict[str, Any]:
    """One verdict for JSON, with all that it holds."""
    return {
        "key": one.key,
        "grade": one.grade,
        "subject": one.subject,
        "seen": one.seen,
        "number": one.number,
        "unit": one.unit,
        "cause": one.cause,
        "cure": one.cure,
        "proposals": [
            {"file": proposal.file, "changes": dict(proposal.changes)} for proposal in one.proposals
        ],
    }


def print_verdicts(found: "Sequence[Verdict]") -> None:
    """All verdicts, the most severe first, and how many there are of each."""
    from deltaid.cli.output import console, verdicts_shown
    from deltaid.view.check import tally, verdict_table

    console.print(verdicts_shown(verdict_table(found)))
    console.print()
    console.print(tally(found))


def _print_cures(cures: Sequence[Cure], written: "Mapping[File, Path]", *, wanted: bool) -> None:
    from deltaid.cli.output import console, styled

    for cure in cures:
        console.print()
        console.print(styled(f"into {_BELONGS[cure.file]}:"))
        console.print(cure.lines.rstrip())
    for file, path in written.items():
        how = (
            "use it in place of the robot" if file == "robot" else f"give it with --columns {path}"
        )
        console.print(f"wrote {path}; {how}")
    if wanted and not cures:
        console.print("nothing was written: no verdict proposes a line of robot file or mapping")
