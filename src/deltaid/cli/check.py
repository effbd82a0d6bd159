"""`deltaid check`: what is wrong with a description and with recordings, before they are used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import output_file

if TYPE_CHECKING:
    from deltaid.check.mended import Changes, File
    from deltaid.check.verdict import Verdict
    from deltaid.recording.columns import ColumnMapping
    from deltaid.robot.description import RobotDescription

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
    columns: Annotated[
        Path | None, typer.Option(help="Which column is what, and its unit (YAML).")
    ] = None,
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
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell what is wrong with a robot's description and recordings, why, and how to mend it.

    Exit code 0: all is good; 3: something is doubtful or cannot be told; 4: something is wrong.
    """
    from deltaid.check.run import verdicts
    from deltaid.check.verdict import worst
    from deltaid.cli.output import console, positive, print_json, progress, require_outputs
    from deltaid.files import together
    from deltaid.model.record import Settings
    from deltaid.recording.columns import load_mapping
    from deltaid.robot.load import load_robot

    logs = logs or []
    positive("--cutoff", cutoff)
    inputs = [Path(robot), *logs, *([columns] if columns else [])]
    targets = _targets(write)
    require_outputs(inputs, {"--write": write}, report)
    if write is not None:
        require_outputs(inputs, {f"--write {write}": path for path in targets.values()}, report)
    description = load_robot(robot)
    mapping = load_mapping(columns) if columns else None
    with progress(as_json) as say:
        found = verdicts(
            description, logs, columns=mapping, settings=Settings(cutoff=cutoff), progress=say
        )
        cures = _cures(description, mapping, logs, found)
    with together():
        written = _write(cures, write, targets)
        if report is not None:
            _write_report(description, found, logs, cures, report)
    if as_json:
        print_json(as_dictionary(description, found))
    else:
        print_verdicts(found)
        _print_cures(cures, written, wanted=write is not None)
        if report is not None:
            console.print(f"wrote {report}")
    raise typer.Exit(EXIT[worst(found)])


@dataclass(frozen=True)
class Cure:
    """One file with all that is proposed for it."""

    file: "File"
    mended: "RobotDescription | ColumnMapping"
    changes: "Changes"

    @property
    def lines(self) -> str:
        """The changed keys, to paste."""
        from deltaid.check.mended import to_paste
        from deltaid.robot.load import yaml_text

        return yaml_text(to_paste(self.mended, self.changes))


def _cures(
    robot: "RobotDescription",
    mapping: "ColumnMapping | None",
    logs: Sequence[Path],
    found: "Sequence[Verdict]",
) -> tuple[Cure, ...]:
    from deltaid.check.mended import changes, files_of, mended_mapping, mended_robot, written_out
    from deltaid.dynamics.dynamics import compiled
    from deltaid.recording.log import resolved_table

    cures: list[Cure] = []
    for file in files_of(found):
        wanted = changes(found, file)
        if file == "robot":
            cures.append(Cure(file, mended_robot(robot, wanted), wanted))
        else:
            table, columns, _ = resolved_table(logs[0], compiled(robot).kinematics, mapping)
            linear = tuple(robot.is_linear(drive) for drive in robot.drives)
            full = written_out(mapping, table, columns, linear)
            cures.append(Cure(file, mended_mapping(full, wanted), wanted))
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
    from deltaid.robot.load import save_yaml

    written: dict[File, Path] = {}
    for cure in cures if write is not None else ():
        path = targets[cure.file] if len(cures) > 1 else write
        assert path is not None
        save_yaml(cure.mended, path, only_set=cure.file == "mapping")
        written[cure.file] = path
    return written


def _write_report(
    robot: "RobotDescription",
    found: "Sequence[Verdict]",
    logs: Sequence[Path],
    cures: Sequence[Cure],
    path: Path,
) -> None:
    from deltaid.report.check import check_page
    from deltaid.report.page import write_page

    lines = {_BELONGS[cure.file]: cure.lines for cure in cures}
    write_page(check_page(robot, found, [log.name for log in logs], lines), path)


def as_dictionary(robot: "RobotDescription", found: "Sequence[Verdict]") -> dict[str, Any]:
    """All verdicts as one JSON object."""
    from deltaid.check.verdict import worst

    return {
        "robot": robot.name,
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
    from deltaid.report.check_tables import tally, verdict_table

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
