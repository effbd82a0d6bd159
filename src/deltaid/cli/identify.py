"""`deltaid identify` and `validate`: from a robot and its logs to a model, and its errors."""

import gc
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

import deltaid
from deltaid.cli.gather import are_factor_files, compared, in_folders, require_open
from deltaid.cli.identified import as_dictionary, error_dictionary, print_result
from deltaid.cli.options import (
    CORRECTIONS,
    YAML,
    AsJson,
    ColumnFiles,
    Columns,
    Compliance,
    Cutoff,
    Events,
    Force,
    Full,
    KeepAll,
    Lag,
    ModelOrRobot,
    Report,
    Robot,
    bounded,
    output_file,
    require_outputs,
)
from deltaid.cli.output import (
    console,
    note_prior,
    print_json,
    print_next,
    print_outcome,
    print_written,
    progress,
    remark,
    write_files,
)
from deltaid.errors import DeltaidError, counted
from deltaid.model.options import (
    GAMMA_LIMITS,
    SPREAD_LIMITS,
    EffectsChoice,
    FrictionLaws,
    IntervalChoice,
    Method,
    RegularizerName,
)
from deltaid.robot.parameter import PRIOR_SPREAD

_FIT = "Fit"


def identify(
    robot: Robot,
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="Recordings: CSV, Parquet, MATLAB, HDF5, bags, …; or files of `deltaid gather`."
        ),
    ],
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Model file to write (YAML).", endings=YAML)
    ] = None,
    verify: Annotated[
        Path | None, typer.Option(help="Recording of another motion to test the model on.")
    ] = None,
    columns: ColumnFiles = None,
    method: Annotated[
        Method,
        typer.Option(
            help="Solver: conic certifies the optimum; log-cholesky is the paper's.",
            rich_help_panel=_FIT,
        ),
    ] = "conic",
    regularizer: Annotated[
        RegularizerName,
        typer.Option(help="Distance from the prior that the fit penalises.", rich_help_panel=_FIT),
    ] = "euclidean",
    gamma: Annotated[
        float | None,
        bounded(
            help="Weight of the prior. Default: from the noise of the data.",
            limits=GAMMA_LIMITS,
            panel=_FIT,
        ),
    ] = None,
    prior_spread: Annotated[
        float,
        bounded(
            help="Standard deviation of the prior, as a share of its values.",
            limits=SPREAD_LIMITS,
            panel=_FIT,
        ),
    ] = PRIOR_SPREAD,
    cutoff: Cutoff = None,
    report: Report = None,
    friction: Annotated[
        FrictionLaws,
        typer.Option(
            help="Friction laws: as described, or with additional terms that the data requires.",
            rich_help_panel=CORRECTIONS,
        ),
    ] = "choose",
    lag: Lag = "estimate",
    compliance: Compliance = "estimate",
    effects: Annotated[
        EffectsChoice,
        typer.Option(
            help="Zeros, gear ratios, lengths, tilt, forces and ripples: correct them where the "
            "recording requires it, or none.",
            rich_help_panel=CORRECTIONS,
        ),
    ] = "correct",
    keep_all: KeepAll = False,
    events: Events = True,
    intervals: Annotated[
        IntervalChoice,
        typer.Option(
            help="Parameter intervals: linearised about the fit, or from posterior samples.",
            rich_help_panel=_FIT,
        ),
    ] = "linear",
    force: Force = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Identify dynamic parameters from recordings.

    Recordings contain joint positions and motor torques.
    """
    # Imports create many permanent objects; scanning them in garbage collection would take a fifth
    # of the time.
    gc.disable()
    from deltaid.checks.identify import identify as run
    from deltaid.identification.prediction import noted, remarks
    from deltaid.recording.source import opened

    gc.enable()
    gc.freeze()

    logs = in_folders(logs)
    settings = deltaid.Settings(
        method=method,
        regularizer=regularizer,
        gamma=gamma,
        prior_spread=prior_spread,
        cutoff=cutoff,
        friction=friction,
        keep_all=keep_all,
        events=events,
        lag=lag,
        compliance=compliance,
        effects=effects,
        intervals=intervals,
    )
    require_outputs(
        [robot, *logs, verify, *(columns or ())], {"--output": output, "--report": report}
    )
    if verify is not None:
        with opened(verify):
            pass  # raises before the fit
    model = deltaid.load(robot)
    if model.identified is not None:
        remark("note", f"{model.source} is a model: its robot is identified anew, from its prior")
    mappings, of_verify = [deltaid.load_mapping(path) for path in columns or ()], None
    if verify is not None and len(mappings) not in (0, 1, len(logs) + 1):
        raise DeltaidError(
            f"is given {len(mappings)} times for {counted(len(logs), 'recording')} and "
            "one to verify on",
            where="--columns",
            cure="give it once for all, or once for each recording and at last for --verify",
        )
    if verify is not None and mappings:
        mappings, of_verify = mappings[:-1] or mappings, mappings[-1]
    from_factors = are_factor_files(logs)
    if from_factors:
        require_open(
            {"--columns": columns is not None, "--cutoff": cutoff is not None,
             "--lag": lag != "estimate", "--compliance": compliance != "estimate",
             "--effects": effects != "correct",
             "--keep-all": keep_all, "--no-events": not events},
            report,
        )  # fmt: skip
    if verify is not None and are_factor_files([verify]):
        require_open({}, report)
    with progress(as_json) as say:
        if from_factors:
            from deltaid.fleets import factor_file, identify_gathered

            say(f"merging {len(logs)} factor files")
            result = identify_gathered.identify_gathered(
                robot, [factor_file.read(log) for log in logs], settings
            )
        else:
            result = run(
                model, logs, columns=mappings, settings=settings, force=force, progress=say
            )
        verification, error, log, kept = None, None, None, result.model
        doubts = list(result.model.warnings)
        if verify is not None:
            say(f"verifying on {verify}")
            verification = compared(deltaid.load(result.model), verify, of_verify, keep_all)
            error, log = verification
            doubts += [f"{verify}: {text}" for text in remarks(result.model, log, error)]
            kept = noted(result.model, log, error, str(verify))
    remark("warning", *doubts)
    with_samples = verification if isinstance(verification, deltaid.Validation) else None
    write_files((output, kept.save), (report, lambda path: result.report(path, with_samples)))
    if as_json:
        print_json(as_dictionary(result, error, log))
    else:
        print_result(result, error, log, full=full)
        if verify is None:
            print_next("--verify LOG says how well it predicts another motion")
        if output is None:
            print_next("-o MODEL.yaml saves the model")
        else:
            console.print(f"saved {output}")
        print_written(report)


def validate(
    model: ModelOrRobot,
    log: Annotated[
        Path, typer.Argument(help="Recording in any supported format, or its factor file.")
    ],
    columns: Columns = None,
    report: Report = None,
    keep_all: KeepAll = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Compare a model's torques with a recording."""
    from deltaid.identification import prediction, sources
    from deltaid.view import corrections, model_tables, summary

    require_outputs((model, log, columns), {"--report": report})
    if are_factor_files([log]):
        require_open({"--columns": columns is not None, "--keep-all": keep_all}, report)
    known = deltaid.load(model)
    with progress(as_json) as say:
        say(f"comparing with {log}")
        comparison = compared(known, log, columns, keep_all)
        error, seen = comparison
        if isinstance(comparison, deltaid.Validation):
            about: dict[str, Any] = {"log": log.name, "sha256": comparison.log.sha256}
            about["clock"] = asdict(sources.model_filtered(known, comparison.log).clock)
            missing = sources.left_out(comparison.log, known.robot.drives, error)
            write_files((report, comparison.report))
        else:
            _, record = comparison
            about = {"log": record.log, "sha256": record.sha256}
            missing = record.model.sources[0].left_out
    if known.identified is None:
        note_prior(known)
    remark("warning", *(f"{log}: {text}" for text in prediction.remarks(known, seen, error)))
    said = summary.summary(known, error, seen)
    excluded = corrections.left_out_table([(log.name, missing)])
    print_outcome(
        as_json,
        about | error_dictionary(error) | {"left_out": [span.model_dump() for span in missing]},
        [said.sentence, *said.lines],
        [model_tables.error_table(known, error)],
        [excluded] if excluded is not None else [],
        full=full,
        files=(report,),
    )
