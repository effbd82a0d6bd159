"""`deltaid identify`: from a robot and its logs to a model."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.imports import uncollected
from deltaid.cli.options import ColumnFiles, KeepAll, mappings, output_file
from deltaid.errors import DeltaidError
from deltaid.model.options import (
    GAMMA_LIMITS,
    SPREAD_LIMITS,
    ComplianceChoice,
    FrictionLaws,
    Method,
    RegularizerName,
)

if TYPE_CHECKING:
    from deltaid.identification.identify import Identification
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.record import Source
    from deltaid.recording.log import Log
    from deltaid.recording.mapping import ColumnMapping


# Events that the terminal lists.
_EVENTS = 20


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("identify")(identify)


def identify(
    robot: Annotated[str, typer.Argument(help="Catalogue name, or a robot or model file.")],
    logs: Annotated[
        list[Path], typer.Argument(help="Recordings: CSV, Parquet, MATLAB, HDF5, bags, …")
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
    cutoff: Annotated[
        float | None, typer.Option(help="Low-pass cut-off in Hz. Default: from the data.")
    ] = None,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures of all results, works offline.")
    ] = None,
    friction: Annotated[
        FrictionLaws,
        typer.Option(help="choose: further terms where the data shows one; described: none."),
    ] = "choose",
    lag: Annotated[
        str,
        typer.Option(
            help="Lag of torques behind positions: estimate, none, or ms, for all drives (2) or "
            "each (2,2,2,-1.5)."
        ),
    ] = "estimate",
    compliance: Annotated[
        ComplianceChoice,
        typer.Option(
            help="Gears that wind up: estimate where the description states no stiffness, or none."
        ),
    ] = "estimate",
    keep_all: KeepAll = False,
    events: Annotated[
        bool,
        typer.Option(
            help="Look for contacts, stops, spikes and play in gears, and leave them out."
        ),
    ] = True,
    force: Annotated[
        bool, typer.Option("--force", help="Go on with what the checks call wrong.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Identify a robot's dynamic parameters from recordings of joint positions and torques."""
    with uncollected():
        from deltaid.check.identified import identify as run
        from deltaid.cli.output import (
            console,
            lag_of,
            positive,
            print_json,
            print_note,
            print_warnings,
            progress,
            require_outputs,
        )
        from deltaid.files import together
        from deltaid.identification.validation import remarks, validate
        from deltaid.model.model import load
        from deltaid.model.record import Settings
        from deltaid.recording.source import opened

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
    with progress(as_json) as say:
        result = run(model, logs, columns=given, settings=settings, force=force, progress=say)
        verification, log, doubts = None, None, list(result.model.warnings)
        if verify is not None:
            say(f"verifying on {verify}")
            verification, log = validate(result.model, verify, columns=of_verify, keep_all=keep_all)
            texts = remarks(result.model, log, verification)
            doubts += [f"{log.path}: {text}" for text in texts]
    print_warnings(doubts)
    with together():
        if output is not None:
            result.model.save(output)
        if report is not None:
            write_report(result, log, verification, report)
    if as_json:
        print_json(as_dictionary(result, verification))
    else:
        print_result(result, verification, output)
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


def write_report(
    result: "Identification", log: "Log | None", error: "TorqueError | None", path: Path
) -> None:
    """The page of a result, with a recording that it has been verified on."""
    from deltaid.identification.as_identified import model_filtered
    from deltaid.report.identification import Verification, identification_page
    from deltaid.report.page import write_page

    verification = None
    if log is not None and error is not None:
        verification = Verification(model_filtered(result.model, log), error)
    write_page(identification_page(result, verification), path)


def as_dictionary(result: "Identification", verification: "TorqueError | None") -> dict[str, Any]:
    """The result as one JSON object."""
    from deltaid.cli.validate import error_dictionary

    model, layout = result.model, result.model.layout
    value = {
        "robot": model.robot.name,
        "method": model.settings.method,
        "regularizer": model.settings.regularizer,
        **model.fit.model_dump(),
        "samples": round(result.problem.information.mean_samples),
        "cutoff_hz": [source.cutoff_hz for source in model.sources],
        "corrections": [one.model_dump() for one in model.corrections],
        "loads": [one.model_dump() for one in model.loads],
        "left_out": [
            {"log": source.log, **one.model_dump()}
            for source in model.sources
            for one in source.left_out
        ],
        "events": [
            {"log": source.log, **one.model_dump()}
            for source in model.sources
            for one in source.events
        ],
        "clock": [{"log": one.path.name, **asdict(one.clock)} for one in result.recordings],
        "friction": {
            "joints": list(model.robot.friction_joints),
            "viscous": model.p[layout.viscous].tolist(),
            "coulomb": model.p[layout.coulomb].tolist(),
            "laws": {
                joint: law.model_dump(exclude_none=True)
                for joint, law in model.robot.friction.items()
            },
            "choice": model.friction_choice and model.friction_choice.model_dump(),
            "curves": [one.model_dump() for one in model.friction_curves],
        },
        "consistent": model.consistent,
        "parameters": [parameter.model_dump() for parameter in model.parameters],
        "base_values": [parameter.model_dump() for parameter in model.base_parameters],
        "warnings": list(model.warnings),
    }
    if verification is not None:
        value["verify"] = error_dictionary(verification)
    return value


def print_result(
    result: "Identification", verification: "TorqueError | None", output: Path | None
) -> None:
    """The result as tables."""
    from deltaid.cli.output import console, shown
    from deltaid.model.model import load
    from deltaid.report.model_tables import (
        choice_sentence,
        choice_table,
        error_table,
        parameter_table,
    )
    from deltaid.report.put_right import put_right_tables

    model = result.model
    console.print(shown(parameter_table(model)))
    console.print()
    console.print(shown(error_table(load(model), verification)))
    console.print()
    if model.friction_choice is not None and model.friction_choice.steps:
        console.print(shown(choice_table(model.friction_choice, model.robot)))
        console.print(choice_sentence(model.friction_choice))
        console.print()
    for table in put_right_tables(model, _EVENTS):
        console.print(shown(table))
        console.print()
    for line in summary(result):
        console.print(line)
    if output is not None:
        console.print(f"saved {output}")


def _of_positions(source: "Source") -> str:
    """Their cut-off, where it is another one."""
    if source.motion_cutoff_hz is None or source.motion_cutoff_hz == source.cutoff_hz:
        return ""
    return f", positions at {source.motion_cutoff_hz:.3g} Hz"


def summary(result: "Identification") -> list[str]:
    """Sentences about the fit: filter, optimum, rank, consistency."""
    from deltaid.identification.fit import SOLVERS
    from deltaid.recording.repairs import WHY_REPAIRED
    from deltaid.report.left_out import reversals
    from deltaid.report.shares import shares_sentence

    fit, model = result.model.fit, result.model
    lines = []
    for source in model.sources:
        filtered = (
            f"zero-phase low-pass at {source.cutoff_hz:.3g} Hz{_of_positions(source)}, thinned to "
            f"{source.used_samples}"
            if source.cutoff_hz
            else "not filtered"
        )
        lines.append(
            f"{source.log}: {source.samples} samples at {source.rate_hz:.6g} Hz, {filtered}"
            f"{reversals(source.left_out)}"
        )
    if fit.duality_gap is None:
        certificate = "no certificate: this regulariser is not convex"
    elif SOLVERS[model.settings.method].certifies:
        certificate = f"global optimum, duality gap {fit.duality_gap:.1e}"
    else:
        share = fit.duality_gap / fit.objective
        certificate = f"{fit.duality_gap:.1e} ({100 * share:.2g} %) above the certified optimum"
    if any(one.reason in WHY_REPAIRED for source in model.sources for one in source.left_out):
        certificate += ", of the rows that events have left"
    lines += [
        f"objective {fit.objective:.4e}, {certificate}; γ = {fit.gamma:.2e}",
        f"{fit.optimization_variables} free parameters, {fit.base_parameters} base parameters, "
        f"condition {fit.base_condition:.0f}; torque noise {100 * fit.noise_level:.2g} % of the "
        "largest torque",
        shares_sentence(model),
        "all bodies physically consistent",
    ]
    return [line for line in lines if line]
