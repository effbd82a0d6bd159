"""`deltaid reproduce`: the paper's examples, from excitation to figures."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from deltaid.cli.options import AsJson
from deltaid.cli.output import Finished, console, print_found, print_json, progress
from deltaid.files import together
from deltaid.progress import Progress
from deltaid.view.page import Page

Example = Literal["surrogate", "irb360"]
# Result of an example as JSON, its table, and notes.
Reproduced = tuple[dict[str, Any], Finished, tuple[str, ...]]


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
    with progress(as_json) as say:
        value, table, notes = run(output, say, quick, {"seed": seed, "starts": starts})
    if as_json:
        print_json(value)
    else:
        print_found(notes, [table], full=True)
        console.print(f"wrote {output}/report.html, results.json, models, robots and recordings")


def _surrogate(folder: Path, say: Progress, quick: bool, given: dict[str, int]) -> Reproduced:
    from deltaid.reproduce import files, surrogate, surrogate_page

    files.require_folder(folder, files.SURROGATE_FILES)
    settings = replace(surrogate.QUICK if quick else surrogate.SurrogateSettings(), **given)
    result = surrogate.reproduce_surrogate(settings, progress=say)
    value = _written(result, surrogate_page.surrogate_page, folder, say)
    fewest = min(result.fits, key=lambda fit: fit.accuracy.definite).accuracy
    notes = (
        "ID1 and ID2 start from regularisations below and above the truth",
        "clean recordings have no noise",
        "the column “the paper” holds its own numbers, all others are simulated here",
        f"M has a Cholesky factor at {fewest.definite} of {fewest.samples} samples, in the worst "
        "of all fits",
    )
    return value, surrogate_page.comparison_table(result), notes


def _irb360(folder: Path, say: Progress, quick: bool, given: dict[str, int]) -> Reproduced:
    from deltaid.reproduce import files, irb360, irb360_page

    files.require_folder(folder, files.IRB360_FILES)
    settings = replace(irb360.QUICK if quick else irb360.RecordingSettings(), **given)
    result = irb360.reproduce_irb360(settings, progress=say)
    value = _written(result, irb360_page.irb360_page, folder, say)
    notes = ("rows “the paper” hold numbers of its own machine; all others are simulated here",)
    return value, irb360_page.rms_table(result), notes


def _written(
    result: Any, page: Callable[[Any], Page], folder: Path, say: Progress
) -> dict[str, Any]:
    """An example as JSON, after its files and its page were written."""
    from deltaid.reproduce import files
    from deltaid.view.html import write_page

    say("writing")
    with together():
        files.write_files(result, folder)
        write_page(page(result), folder / files.REPORT)
    return files.as_dictionary(result)
