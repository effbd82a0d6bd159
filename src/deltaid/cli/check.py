"""`deltaid columns` and `check`: the columns of a recording, and faults of description and
recording."""

from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.options import (
    YAML,
    AsJson,
    ColumnFiles,
    Cutoff,
    KeepAll,
    Report,
    Robot,
    bounded,
    output_file,
    require_outputs,
)
from deltaid.cli.output import (
    console,
    print_found,
    print_json,
    print_next,
    print_written,
    progress,
    remark,
    write_files,
)
from deltaid.errors import DeltaidError
from deltaid.model.verdict import File

# Exit codes by the most severe verdict; 1 and 2 have their usual meaning.
EXIT = {"good": 0, "cannot tell": 3, "doubtful": 3, "wrong": 4}
# Last part of a proposed file's name, by file.
_ENDS: dict[File, str] = {"robot": "robot", "mapping": "columns"}
# Example units of quantities, for logs that do not state them.
_UNITS = {
    "position": "'360/65536 deg' for 65536 counts a turn, and --gear if there is one",
    "torque": "'0.0235 N*m' for a per mille of 23.5 N m",
}


def columns(
    log: Annotated[Path, typer.Argument(help="Recording of any kind, with any column names.")],
    robot: Annotated[
        str | None, typer.Argument(help="Catalogue name or file of the robot.")
    ] = None,
    output: Annotated[
        Path | None,
        output_file("--output", "-o", help="Mapping file to write (YAML).", endings=YAML),
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(help="Unit of a quantity, such as torque='0.0235 N*m'. Repeatable."),
    ] = None,
    gear: Annotated[
        float | None, bounded(help="Motor turns per joint turn, for motor columns.")
    ] = None,
    torque_constant: Annotated[
        float | None, bounded(help="Torque constant at the motor, N m per A.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Propose which column of a recording holds which quantity.

    Each proposal has a reason and states any doubt.

    Exit code 0: no doubt; 3: a quantity is in doubt or missing.
    """
    require_outputs([log, robot], {"--output": output})
    given = dict(_unit(text) for text in unit or ())
    proposal = deltaid.columns(log, robot, units=given, gear=gear, torque_constant=torque_constant)
    remark("warning", *proposal.warnings)
    if output is not None:
        proposal.save(output)
    if as_json:
        print_json(
            {
                "certain": proposal.certain,
                "missing": list(proposal.missing),
                "mapping": proposal.data,
                "found": [
                    {
                        "quantity": part.quantity,
                        "columns": list(part.columns),
                        "units": list(part.units),
                        "reasons": list(part.reasons),
                        "doubts": list(part.open_questions),
                    }
                    for part in proposal.found
                ],
            }
        )
    else:
        _print(proposal, log)
        if output is not None:
            console.print(f"wrote {output}; give it with --columns {output}")
    raise typer.Exit(EXIT["good" if proposal.certain else "doubtful"])


def _unit(text: str) -> tuple[str, str]:
    """A quantity and its unit, from text such as 'torque=N*m'.

    Raises:
        DeltaidError: the quantity is unknown, or the unit is not one of this quantity.
    """
    from deltaid.recording.column_meanings import kind_of

    quantity, _, unit = (part.strip() for part in text.partition("="))
    kind = kind_of(unit) if unit else ""
    if quantity not in ("time", "position", "velocity", "acceleration", "torque"):
        raise DeltaidError(
            f"'{text}' names no quantity",
            where="--unit",
            cure="write it as torque='0.0235 N*m', or with time, position, velocity, acceleration",
        )
    if kind != quantity and (quantity, kind) != ("torque", "current"):
        raise DeltaidError(
            f"'{unit}' is no unit of {quantity}",
            where="--unit",
            cure="write it as in s, ms, rad, deg, rad/s, rpm, N*m, mN*m, A; a number may stand "
            "before it",
        )
    return quantity, unit


def _print(proposal: "deltaid.MappingProposal", log: Path) -> None:
    """Print the verdict, each quantity with its reasons and doubts, and the next step."""
    parts = [f"{len(proposal.doubts)} in doubt"] * bool(proposal.doubts)
    parts += [f"missing: {', '.join(proposal.missing)}"] * bool(proposal.missing)
    lines = [f"{log.name}: {'; '.join(parts) or 'certain'}"]
    for part in proposal.found:
        names = part.columns if len(part.columns) < 3 else (part.columns[0], part.columns[-1])
        named = (" … " if len(part.columns) > 2 else ", ").join(names)
        unit = part.unit or ", ".join(dict.fromkeys(part.units)) or "unit unknown"
        lines.append(f"{part.quantity}: {named} in {unit}, {'; '.join(part.reasons)}")
        lines += [f"  in doubt: {text}" for text in part.open_questions]
    print_found(lines, full=True)
    units = [text.removeprefix("unit of ") for text in proposal.missing if text.startswith("unit")]
    if units:
        step = f"give the unit: --unit {units[0]}={_UNITS.get(units[0], _UNITS['torque'])}"
    elif "torque_constant" in proposal.missing:
        step = "give --torque-constant in N m per A at the motor, and --gear if there is one"
    elif proposal.missing:
        step = "name what is missing in a mapping file (docs: The mapping file)"
    else:
        step = "write it (-o columns.yaml), check it, and give it with --columns columns.yaml"
    if proposal.missing or proposal.doubts:
        print_next(step)


def check(
    robot: Robot,
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Recordings. Default: the description only.")
    ] = None,
    columns: ColumnFiles = None,
    cutoff: Cutoff = None,
    write: Annotated[
        Path | None,
        output_file(help="Robot file or mapping to write, with all proposed fixes.", endings=YAML),
    ] = None,
    report: Report = None,
    keep_all: KeepAll = False,
    full: Annotated[
        bool, typer.Option("--full", help="List good verdicts too, with their numbers.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Detect faults of a description or a recording.

    Each verdict states the likeliest cause and the fix.

    Exit code 0: all verdicts are good; 3: one is doubtful or undecided; 4: one is wrong.
    """
    from deltaid.checks.verdicts import as_written, files_of
    from deltaid.recording.mapping import FOUND, as_words
    from deltaid.view import check as view

    # Destination of each file if there are proposals for both.
    logs, targets = logs or [], {
        file: write.with_name(f"{write.stem}-{end}{write.suffix}")
        for file, end in _ENDS.items()
        if write is not None
    }  # fmt: skip
    for path in (write, *targets.values()):
        require_outputs([robot, *logs, *(columns or ())], {"--write": path, "--report": report})
    with progress(as_json) as say:
        settings = deltaid.Settings(cutoff=cutoff, keep_all=keep_all)
        verdicts = deltaid.check(robot, logs, columns=columns, settings=settings, progress=say)
    guessed = {
        log: as_words(mapping)
        for log, mapping in zip(logs, verdicts.mappings, strict=False)  # unless broken
        if mapping is not None and mapping.source == FOUND
    }
    for text in verdicts.warnings:
        if not any(words in text for words in guessed.values()):  # which the notes say
            remark("warning", text)
    for log, words in guessed.items():
        remark("note", f"{log}: {words}; `deltaid columns {log} {robot}` says why")
    with progress(as_json):
        cured = verdicts.cured_files()
    if "mapping" not in cured and "mapping" in files_of(verdicts):
        remark("note", "to have a mapping corrected, check its recording alone")
    if write is not None and len(cured) == 1:
        targets = dict.fromkeys(cured, write)
    write_files(
        *((targets.get(file), text) for file, (_, text) in cured.items()),
        (report, verdicts.report),
    )
    if as_json:
        keys = ("key", "grade", "subject", "seen", "number", "unit", "cause", "cure")
        print_json(
            {
                "robot": as_written(robot).get("name"),
                "grade": verdicts.grade,
                "verdicts": [
                    {key: getattr(verdict, key) for key in keys}
                    | {
                        "proposals": [
                            {"file": proposal.file, "changes": dict(proposal.changes)}
                            for proposal in verdict.proposals
                        ]
                    }
                    for verdict in verdicts
                ],
                "warnings": list(verdicts.warnings),
            }
        )
        raise typer.Exit(EXIT[verdicts.grade])
    listed = verdicts if full else verdicts.poor
    print_found([view.tally(verdicts)], [view.screen_table(listed)] * bool(listed), full=True)
    for lines, _ in cured.values():
        console.print()
        console.print(lines)
    for file in cured if write else ():
        with_it = f"give it with --columns {targets[file]}"
        use = "use it in place of the robot" if file == "robot" else with_it
        console.print(f"wrote {targets[file]}; {use}")
    if write is not None and not cured:
        console.print("nothing was written: no verdict proposes a line of robot file or mapping")
    print_written(report)
    raise typer.Exit(EXIT[verdicts.grade])
