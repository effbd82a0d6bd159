"""`deltaid reproduce`: the paper's examples, from excitation to figures."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from deltaid.cli.options import AsJson
from deltaid.cli.output import console, print_json, progress
from deltaid.cli.screen import print_found
from deltaid.files import together
from deltaid.view.page import Table

if TYPE_CHECKING:
    from deltaid.progress import Progress
    from deltaid.reproduce.surrogate_page import Rows
    from deltaid.view.page import Page

Example = Literal["surrogate", "irb360"]
_Result = TypeVar("_Result")


def reproduce(
    example: Annotated[
        Example,
        typer.Argument(
            help="surrogate: the test model of Sec. VII; irb360: the industrial robot of Sec. VIII."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for report, results, models and logs.")
    ],
    seed: Annotated[int, typer.Option(help="Of motions, regularisations and noise.", min=0)] = 0,
    starts: Annotated[
        int, typer.Option(help="Starts of each motion's search.", min=1, max=1000)
    ] = 4,
    quick: Annotated[
        bool, typer.Option("--quick", help="Short motions and few steps, for a first look.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Reproduce an example of the paper.

    Its data is simulated, and the result is compared with its numbers.

    The folder is made if it does not exist; files in it are replaced.
    """
    run = _surrogate if example == "surrogate" else _irb360
    run(output, seed=seed, starts=starts, quick=quick, as_json=as_json)


def _surrogate(folder: Path, *, seed: int, starts: int, quick: bool, as_json: bool) -> None:
    """Reproduce Sec. VII, and print its errors."""
    from deltaid.reproduce import surrogate_result
    from deltaid.reproduce.surrogate import reproduce_surrogate
    from deltaid.reproduce.surrogate_page import (
        comparison_columns,
        comparison_rows,
        surrogate_page,
    )
    from deltaid.reproduce.surrogate_result import QUICK, SurrogateSettings

    settings = replace(QUICK if quick else SurrogateSettings(), seed=seed, starts=starts)
    result = _reproduced(
        lambda say: reproduce_surrogate(settings, progress=say),
        surrogate_result, surrogate_page, folder, as_json,
    )  # fmt: skip
    if as_json:
        return
    fewest = min(result.fits, key=lambda fit: fit.accuracy.definite).accuracy
    _print(
        comparison_columns(result),
        comparison_rows(result),
        "Sec. VII, largest errors along the motion; certified optimum (conic)",
        (
            "ID1 and ID2 start from regularisations below and above the truth",
            "clean recordings have no noise",
            "the column “the paper” holds its own numbers, all others are simulated here",
            f"M has a Cholesky factor at {fewest.definite} of {fewest.samples} samples, in the "
            "worst of all fits",
        ),
        folder,
    )


def _irb360(folder: Path, *, seed: int, starts: int, quick: bool, as_json: bool) -> None:
    """Reproduce Sec. VIII, and print its errors."""
    from deltaid.reproduce import irb360
    from deltaid.reproduce.irb360 import QUICK, reproduce_irb360
    from deltaid.reproduce.irb360_page import irb360_page, rms_columns, rms_rows
    from deltaid.reproduce.surrogate_result import RecordingSettings

    settings = replace(QUICK if quick else RecordingSettings(), seed=seed, starts=starts)
    result = _reproduced(
        lambda say: reproduce_irb360(settings, progress=say),
        irb360, irb360_page, folder, as_json,
    )  # fmt: skip
    if as_json:
        return
    _print(
        rms_columns(result),
        rms_rows(result),
        "Sec. VIII with a simulated stand-in for the machine",
        ("rows “the paper” hold numbers of its own machine; all others are simulated here",),
        folder,
    )


def _reproduced(
    run: "Callable[[Progress], _Result]",
    files: ModuleType,
    page: "Callable[[_Result], Page]",
    folder: Path,
    as_json: bool,
) -> _Result:
    """The result of an example, which has been written into a folder."""
    from deltaid.reproduce.surrogate_result import REPORT, require_folder
    from deltaid.view.html import write_page

    require_folder(folder, files.FILES)
    with progress(as_json) as say:
        result = run(say)
        say("writing")
        with together():
            files.write_files(result, folder)
            write_page(page(result), folder / REPORT)
    if as_json:
        print_json(files.as_dictionary(result))
    return result


def _print(
    columns: tuple[str, ...], rows: "Rows", title: str, notes: Sequence[str], folder: Path
) -> None:
    print_found(notes, [Table(columns, rows, title=title)], full=True)
    console.print(f"wrote {folder}/report.html, results.json, models, robots and recordings")
