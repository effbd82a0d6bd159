"""`deltaid columns`: which column of a foreign recording is what."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import deltaid
from deltaid.cli.options import AsJson, bounded, output_file
from deltaid.cli.output import console, print_json, styled
from deltaid.cli.output_files import require_outputs
from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.recording.mapping import FoundColumns

# Exit code where something is in doubt or missing; 1 and 2 mean what they mean everywhere.
DOUBTFUL = 3


def columns(
    log: Annotated[Path, typer.Argument(help="A recording of any kind, with any names.")],
    robot: Annotated[
        str | None, typer.Argument(help="Catalogue name or file; its drives are sought.")
    ] = None,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Where to write the mapping (YAML).")
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(help="Unit of a quantity, such as torque='0.0235 N*m'; repeated."),
    ] = None,
    gear: Annotated[
        float | None, bounded(help="Motor turns per joint turn, for columns of the motors.")
    ] = None,
    torque_constant: Annotated[
        float | None, bounded(help="N m per A at the motor, for currents.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find out which column of a recording is what.

    It says how sure that is, and why.

    Exit code 0: it is certain; 3: something is in doubt or missing.
    """
    require_outputs([log, robot], {"--output": output})
    given = dict(_unit(text) for text in unit or ())
    found = deltaid.columns(log, robot, units=given, gear=gear, torque_constant=torque_constant)
    if output is not None:
        found.save(output)
    if as_json:
        parts = [
            {
                "quantity": part.quantity,
                "columns": list(part.columns),
                "units": list(part.units),
                "reasons": list(part.reasons),
                "doubts": list(part.open_questions),
            }
            for part in found.found
        ]
        missing = list(found.missing)
        print_json(
            {"certain": found.certain, "missing": missing, "mapping": found.data, "found": parts}
        )
    else:
        _print(found, log)
        if output is not None:
            console.print(f"wrote {output}; give it with --columns {output}")
    raise typer.Exit(0 if found.certain else DOUBTFUL)


def _unit(text: str) -> tuple[str, str]:
    """A quantity and its unit.

    Raises:
        DeltaidError: it is neither, or the unit is of something else.
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


def _print(found: "deltaid.MappingProposal", log: Path) -> None:
    """The verdict, each quantity with its doubts or else its reasons, and what to do next."""
    parts = [f"{len(found.doubts)} in doubt"] * bool(found.doubts)
    parts += [f"missing: {', '.join(found.missing)}"] * bool(found.missing)
    console.print(styled(f"{log.name}:"), "; ".join(parts) or "certain")
    for part in found.found:
        console.print()
        console.print(styled(part.quantity), _listed(part))
        _print_line("because", "; ".join(part.reasons))
        for text in part.open_questions:
            _print_line("in doubt", text)
    console.print()
    if found.missing or found.doubts:
        _print_line("→", _next(found))


def _listed(part: "FoundColumns") -> str:
    """'Axis1.ActPos … Axis3.ActPos [deg]'."""
    names = part.columns if len(part.columns) < 3 else (part.columns[0], part.columns[-1])
    unit = part.unit or ", ".join(dict.fromkeys(part.units)) or "unit unknown"
    return f"{(' … ' if len(part.columns) > 2 else ', ').join(names)} in {unit}"


def _next(found: "deltaid.MappingProposal") -> str:
    units = [text.removeprefix("unit of ") for text in found.missing if text.startswith("unit")]
    if units:
        return f"give the unit: --unit {units[0]}='0.0235 N*m' for a per mille of 23.5 N m"
    if "torque_constant" in found.missing:
        return "give --torque-constant in N m per A at the motor, and --gear if there is one"
    if found.missing:
        return "name what is missing in a mapping file (docs: The mapping file)"
    return "write it (-o columns.yaml), check it, and give it with --columns columns.yaml"


def _print_line(mark: str, text: str) -> None:
    indent = f"  {mark:<9}" if len(mark) > 1 else f"{mark} "
    width = max(console.width, 40)
    console.print(
        textwrap.fill(text, width, initial_indent=indent, subsequent_indent=" " * len(indent))
    )
