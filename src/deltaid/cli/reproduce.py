"""`deltaid reproduce`: the paper's examples, from excitation to figures."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from deltaid.reproduce.surrogate_result import Reproduction


class Example(StrEnum):
    """Which of the paper's examples."""

    SURROGATE = "surrogate"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("reproduce")(reproduce)


def reproduce(
    example: Annotated[Example, typer.Argument(help="surrogate: the test model of Sec. VII.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for report, results, models and logs.")
    ],
    seed: Annotated[int, typer.Option(help="Of motions, regularisations and noise.", min=0)] = 0,
    starts: Annotated[int, typer.Option(help="Starts of each motion's search.", min=1)] = 4,
    quick: Annotated[
        bool, typer.Option("--quick", help="Short motions and few steps, for a first look.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Reproduce an example of the paper with simulated data, and compare with its numbers.

    The folder is made if it does not exist; files in it are replaced.
    """
    from deltaid.cli.output import print_json, progress
    from deltaid.report.page import write_page
    from deltaid.reproduce.surrogate import reproduce_surrogate
    from deltaid.reproduce.surrogate_files import (
        REPORT,
        as_dictionary,
        prepare_folder,
        write_files,
    )
    from deltaid.reproduce.surrogate_page import surrogate_page
    from deltaid.reproduce.surrogate_result import QUICK, SurrogateSettings

    settings = replace(QUICK if quick else SurrogateSettings(), seed=seed, starts=starts)
    prepare_folder(output)
    with progress(as_json) as say:
        result = reproduce_surrogate(settings, progress=say)
        say("writing")
        write_files(result, output)
        write_page(surrogate_page(result), output / REPORT)
    if as_json:
        print_json(as_dictionary(result))
    else:
        _print(result, output)


def _print(result: "Reproduction", folder: Path) -> None:
    from deltaid.cli.output import console, table
    from deltaid.reproduce.surrogate_page import comparison_columns, comparison_rows

    columns, rows = comparison_columns(result), comparison_rows(result)
    console.print(table("Sec. VII, simulated here: certified optimum (conic)", columns, rows))
    console.print()
    console.print(
        "ID1 and ID2 start from regularisations below and above the truth (RG1, RG2); the column "
        "“the paper” holds its own numbers, all others are simulated here"
    )
    console.print(f"wrote {folder}/report.html, results.json, models, robots and recordings")
