"""`deltaid identify`: from a robot and its logs to a model."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.imports import uncollected
from deltaid.cli.options import (
    AsJson,
    ColumnFiles,
    Compliance,
    Cutoff,
    Events,
    Force,
    KeepAll,
    Lag,
    Robot,
    mappings,
    output_file,
)
from deltaid.errors import DeltaidError
from deltaid.model.options import (
    GAMMA_LIMITS,
    SPREAD_LIMITS,
    EffectsChoice,
    FrictionLaws,
    IntervalChoice,
    Method,
    RegularizerName,
)

if TYPE_CHECKING:
    from deltaid.recording.mapping import ColumnMapping


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("identify")(identify)


def identify(
    robot: Robot,
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="Recordings: CSV, Parquet, MATLAB, HDF5, bags, …; or files of `deltaid gather`."
        ),
    ],
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Where to save the model (YAML).")
    ] = None,
    verify: Annotated[
        Path | None, typer.Option(help="A recording of another motion, to test the model on.")
    ] = None,
    columns: ColumnFiles = None,
    method: Annotated[
        Method, typer.Option(help="conic: certified optimum; log-cholesky: the paper's.")
    ] = "conic",
    regularizer: Annotated[
        RegularizerName, typer.Option(help="Distance that pulls towards the prior.")
    ] = "euclidean",
    gamma: Annotated[
        float | None, typer.Option(help="γ_p/γ_τ of eq. (15). Default: from the data's noise.")
    ] = None,
    prior_spread: Annotated[
        float, typer.Option(help="How far the prior may be off, as a share (one sigma).")
    ] = 0.5,
    cutoff: Cutoff = None,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures of all results, works offline.")
    ] = None,
    friction: Annotated[
        FrictionLaws,
        typer.Option(help="choose: further terms where the data shows one; described: none."),
    ] = "choose",
    lag: Lag = "estimate",
    compliance: Compliance = "estimate",
    effects: Annotated[
        EffectsChoice,
        typer.Option(
            help="Zeros, gear ratios, lengths, tilt, forces, ripples that the recording asks for."
        ),
    ] = "correct",
    keep_all: KeepAll = False,
    events: Events = True,
    intervals: Annotated[
        IntervalChoice,
        typer.Option(
            help="Of parameters: linear about the fit, or of models drawn from the posterior."
        ),
    ] = "linear",
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Identify a robot's dynamic parameters from recordings of joint positions and torques."""
    with uncollected():
        from deltaid.checks.identified import identify as run
        from deltaid.cli.gathered import (
            are_factor_files,
            identified,
            in_folders,
            require_open,
            validated,
        )
        from deltaid.cli.identified import as_dictionary, print_result, write_report
        from deltaid.cli.output import (
            console,
            lag_of,
            print_json,
            print_note,
            print_warnings,
            progress,
            require_outputs,
        )
        from deltaid.errors import positive
        from deltaid.files import together
        from deltaid.identification.validation import remarks, validate
        from deltaid.model.model import load
        from deltaid.model.record import Settings
        from deltaid.recording.source import opened

    logs = in_folders(logs)
    positive("--gamma", gamma, GAMMA_LIMITS)
    positive("--prior-spread", prior_spread, SPREAD_LIMITS)
    positive("--cutoff", cutoff)
    settings = Settings(
        method=method,
        regularizer=regularizer,
        gamma=gamma,
        prior_spread=prior_spread,
        cutoff=cutoff,
        friction=friction,
        keep_all=keep_all,
        events=events,
        lag=lag_of(lag),
        compliance=compliance,
        effects=effects,
        intervals=intervals,
    )
    inputs = [Path(robot), *logs, *([verify] if verify else ()), *(columns or ())]
    require_outputs(inputs, {"--output": output}, report)
    if verify is not None:
        with opened(verify):
            pass  # to miss it now, not after the fit
    model = load(robot)
    if model.identified is not None:
        print_note(f"{model.source} is a model: its robot is identified anew, from its prior")
    given, of_verify = _mappings(columns, len(logs), verify)
    from_factors = are_factor_files(logs)
    if from_factors:
        require_open(
            {"--columns": columns is not None, "--cutoff": cutoff is not None,
             "--lag": lag != "estimate", "--compliance": compliance != "estimate",
             "--effects": effects != "correct",
             "--keep-all": keep_all, "--no-events": not events},
            report,
        )  # fmt: skip
    verify_from_factors = verify is not None and are_factor_files([verify])
    if verify_from_factors:
        require_open({}, report)
    with progress(as_json) as say:
        if from_factors:
            say(f"merging {len(logs)} factor files")
            result = identified(robot, logs, settings)
        else:
            result = run(model, logs, columns=given, settings=settings, force=force, progress=say)
        verification, seen, surveyed = None, None, None
        doubts = list(result.model.warnings)
        if verify is not None:
            say(f"verifying on {verify}")
            if verify_from_factors:
                verification, seen = validated(load(result.model), verify)
            else:
                verification, surveyed = validate(
                    result.model, verify, columns=of_verify, keep_all=keep_all
                )
                seen = surveyed
            doubts += [f"{verify}: {text}" for text in remarks(result.model, seen, verification)]
    print_warnings(doubts)
    with together():
        if output is not None:
            result.model.save(output)
        if report is not None:
            write_report(result, surveyed, verification, report)
    if as_json:
        print_json(as_dictionary(result, verification, seen))
    else:
        print_result(result, verification, output, seen)
        if report is not None:
            console.print(f"wrote {report}")


def _mappings(
    columns: Sequence[Path] | None, logs: int, verify: Path | None
) -> "tuple[list[ColumnMapping] | None, ColumnMapping | None]":
    """The mappings of the recordings, and that of the recording to verify on."""
    given = mappings(columns)
    if given is None or verify is None or len(given) == 1:
        return given, given[0] if given else None
    if len(given) != logs + 1:
        raise DeltaidError(
            f"is given {len(given)} times for {logs} recording{'s' if logs > 1 else ''} and one to "
            "verify on",
            where="--columns",
            cure="give it once for all, or once for each recording and at last for --verify",
        )
    return given[:-1], given[-1]
