"""`deltaid show`, `base`, `schema` and `reproduce`: a robot, its base parameters, schemas of files,
and the paper's examples."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import deltaid
from deltaid.cli.options import (
    AsJson,
    ColumnFiles,
    Cutoff,
    Full,
    KeepAll,
    Robot,
    bounded,
    output_file,
    require_outputs,
    require_unset,
)
from deltaid.cli.output import (
    Finished,
    console,
    print_found,
    print_json,
    print_outcome,
    print_written,
    progress,
    remark,
    used,
)
from deltaid.files import together
from deltaid.model.options import LeastSquaresMethod
from deltaid.progress import Progress
from deltaid.view.page import Page

Kind = Literal["robot", "columns", "model", "sensors", "fleet", "measurements"]
Example = Literal["surrogate", "irb360"]
# Result of an example, its page, its table, and notes.
Reproduced = tuple[Any, Page, Finished, tuple[str, ...]]


def show(
    robot: Robot,
    report: Annotated[
        Path | None,
        output_file(
            "--report", "-o", help="HTML page to write: picture, workspace, reach, condition."
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Open a view in which you drag the platform.")
    ] = False,
    port: Annotated[
        int | None,
        bounded(
            help="Port of the live view. Default: 8080, or the next free one.",
            limits=(0, 65535),
        ),
    ] = None,
    full: Full = False,
) -> None:
    """Show a robot's workspace, limits and holding torques.

    The command computes reach, the limits that end it, condition, and torques at rest.

    Without options it prints tables.
    """
    from deltaid.dynamics.limits import AtRest
    from deltaid.view import html, own_page, reach, robots
    from deltaid.view.live import DEFAULT_PORT, LiveView, require_viser

    require_outputs([robot], {"--report": report})
    if not live:
        require_unset({"--port": port is not None}, "--live")
    else:
        require_viser()
        if port is not None:
            own_page.free_port((port,))
    model = deltaid.load(robot)
    reach.require_space(model.robot)
    with used(model, force=True, as_prior=False), progress(False) as say:
        say("compiling")
        at_rest = AtRest(model.dynamics, model.p)
    if report is not None:
        known = "identified" if model.identified else "prior"
        html.write_page(
            robots.rest_page(at_rest, f"Robot at rest, with its {known} parameters"), report
        )
        print_written(report)
    elif not live:
        reached, surveyed = reach.reach(at_rest), reach.survey(at_rest)
        remark("warning", *robots.rest_warnings(at_rest, surveyed))
        tables = {
            "drives": robots.rest_table(at_rest, surveyed).without("held at home"),
            "limits in the workspace": robots.use_table(at_rest, surveyed),
            "limits that end straight moves from home": robots.end_table(at_rest, reached),
        }
        print_found(
            robots.rest_lines(at_rest, reached, surveyed),
            [replace(table, title=title) for title, table in tables.items()],
            full=full,
        )
    if live:
        shown = LiveView(at_rest, DEFAULT_PORT if port is None else port)
        try:
            console.print(f"{at_rest.robot.name} is shown at {shown.url} until Ctrl-C")
            while True:  # what interrupts a sleep meets no lock that is half released
                time.sleep(own_page.POLL)
        except KeyboardInterrupt:
            console.print("closed")
        finally:
            shown.close()


def base(
    robot: Annotated[str, typer.Argument(help="Catalogue name or robot file.")],
    logs: Annotated[
        list[Path] | None,
        typer.Argument(help="Recordings to estimate values from. Default: formulas only."),
    ] = None,
    method: Annotated[
        LeastSquaresMethod, typer.Option(help="Least squares with W = I, diag(τ_max)⁻², or Σ⁻¹.")
    ] = "weighted",
    columns: ColumnFiles = None,
    cutoff: Cutoff = None,
    seed: Annotated[
        int, typer.Option(help="Seed of the random motion, without recordings.", min=0)
    ] = 0,
    keep_all: KeepAll = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """List base parameters as formulas, or estimate them.

    To estimate them, give recordings.
    """
    from deltaid.dynamics.dynamics import compiled
    from deltaid.estimation import information, reduction
    from deltaid.identification.generic_motion import measured_base
    from deltaid.view.model_tables import estimate_table

    description, estimate = deltaid.load_robot(robot), None
    dynamics = compiled(description)
    with progress(as_json) as say:
        if logs:
            # loads SciPy and polars, which formulas alone do not need
            from deltaid.identification.least_squares import identify_base

            say("reading logs")
            result, estimate = identify_base(
                dynamics, logs, method, columns=columns, cutoff=cutoff, keep_all=keep_all
            )
        else:
            say("trying a random motion")
            result = measured_base(dynamics, seed)
    columns_seen = information.active_columns(dynamics)
    layout, free = result.layout, reduction.build_reduction(description, columns_seen).size
    invisible = [layout.names[i] for i in result.invisible]
    visible = len(layout.names) - len(invisible)
    value: dict[str, Any] = {
        "robot": description.name,
        "columns": len(layout.names),
        "nonzero_columns": visible,
        "base_parameters": result.rank,
        "optimization_variables": free,
        "condition": result.condition,
        "groups": list(result.formulas),
        "invisible": invisible,
    }
    if estimate is not None:
        value |= {
            "method": estimate.method,
            "values": estimate.values,
            "std": estimate.std,
            "low": estimate.values - estimate.interval,
            "high": estimate.values + estimate.interval,
        }
    measured = len(description.measured) + sum(
        len(body.measured) for body in description.bodies.values()
    )
    beside = [*description.sensors, *([f"{measured} measured values"] if measured else [])]
    lines = [
        description.label,
        f"{len(layout.names)} parameters, {visible} visible{'' if beside else ' in torques'}, "
        f"{result.rank} base parameters; {free} free in a consistent fit",
        *([f"determined by torques together with {', '.join(beside)}"] if beside else []),
        f"not visible in {'anything that is measured' if beside else 'any torque'}: "
        f"{', '.join(invisible)}",
    ]
    units = [layout.units[group.representative] for group in result.groups]
    print_outcome(
        as_json, value, lines, [estimate_table(result.formulas, units, estimate)], full=full
    )


def schema(
    kind: Annotated[
        Kind,
        typer.Argument(
            help="Kind of file: robot, columns (mapping of a recording), model, sensors "
            "(offer), fleet (manifest) or measurements (of poses)."
        ),
    ] = "robot",
) -> None:
    """Print the JSON Schema of a file that deltaid reads."""
    from deltaid.fleets.manifest import Manifest

    models = {
        "robot": deltaid.RobotDescription,
        "columns": deltaid.ColumnMapping,
        "model": deltaid.IdentifiedModel,
        "sensors": deltaid.Offers,
        "fleet": Manifest,
        "measurements": deltaid.Measurements,
    }
    print_json(models[kind].model_json_schema())


def reproduce(
    example: Annotated[
        Example,
        typer.Argument(
            help="Example: surrogate, the simulated robot of Sec. VII, or irb360, the "
            "industrial robot of Sec. VIII."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="Folder to write report, results, models and recordings into."
        ),
    ],
    seed: Annotated[
        int, typer.Option(help="Seed of motions, regularisations and noise.", min=0)
    ] = 0,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the search for each motion.", min=1, max=1000)
    ] = 4,
    quick: Annotated[
        bool, typer.Option("--quick", help="Use short motions and few steps.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Reproduce an example of the paper.

    The command simulates the data and compares the result with the paper's numbers.

    It creates the folder if it is missing, and replaces files in it.
    """
    from deltaid.reproduce import files
    from deltaid.view.html import write_page

    of_surrogate = example == "surrogate"
    files.require_folder(output, files.SURROGATE_FILES if of_surrogate else files.IRB360_FILES)
    run = _surrogate if of_surrogate else _irb360
    with progress(as_json) as say:
        result, page, table, notes = run(say, quick, {"seed": seed, "starts": starts})
        say("writing")
        with together():
            files.write_files(result, output)
            write_page(page, output / files.REPORT)
    if as_json:
        print_json(files.as_dictionary(result))
    else:
        print_found(notes, [table], full=True)
        console.print(f"wrote {output}/report.html, results.json, models, robots and recordings")


def _surrogate(say: Progress, quick: bool, given: dict[str, int]) -> Reproduced:
    from deltaid.reproduce import surrogate, surrogate_page

    settings = replace(surrogate.QUICK if quick else surrogate.SurrogateSettings(), **given)
    result = surrogate.reproduce_surrogate(settings, progress=say)
    fewest = min(result.fits, key=lambda fit: fit.accuracy.definite).accuracy
    notes = (
        "ID1 and ID2 start from regularisations below and above the truth",
        "clean recordings have no noise",
        "the column “the paper” holds its own numbers, all others are simulated here",
        f"M has a Cholesky factor at {fewest.definite} of {fewest.samples} samples, in the worst "
        "of all fits",
    )
    page = surrogate_page.surrogate_page(result)
    return result, page, surrogate_page.comparison_table(result), notes


def _irb360(say: Progress, quick: bool, given: dict[str, int]) -> Reproduced:
    from deltaid.reproduce import irb360, irb360_page

    settings = replace(irb360.QUICK if quick else irb360.RecordingSettings(), **given)
    result = irb360.reproduce_irb360(settings, progress=say)
    notes = ("rows “the paper” hold numbers of its own machine; all others are simulated here",)
    return result, irb360_page.irb360_page(result), irb360_page.rms_table(result), notes
