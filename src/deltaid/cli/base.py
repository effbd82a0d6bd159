"""`deltaid base`: which combinations of parameters torques can tell."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, ColumnFiles, Cutoff, Full, KeepAll, mappings
from deltaid.cli.output import print_json, progress
from deltaid.cli.screen import print_found
from deltaid.model.options import LeastSquaresMethod

if TYPE_CHECKING:
    from deltaid.dynamics.dynamics import Dynamics
    from deltaid.estimation.base_parameters import BaseParameters
    from deltaid.identification.least_squares import BaseEstimate


def base(
    robot: Annotated[str, typer.Argument(help="Catalogue name or YAML file of the robot.")],
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Recordings, to estimate the values as well.")
    ] = None,
    method: Annotated[
        LeastSquaresMethod, typer.Option(help="Least squares: W = I, diag(τ_max)⁻², or Σ⁻¹.")
    ] = "weighted",
    columns: ColumnFiles = None,
    cutoff: Cutoff = None,
    seed: Annotated[int, typer.Option(help="Seed of the random motion without a log.", min=0)] = 0,
    keep_all: KeepAll = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """List base parameters as formulas, or estimate them.

    Recordings are needed for their values.
    """
    from deltaid.dynamics.dynamics import compiled
    from deltaid.identification.generic_motion import measured_base
    from deltaid.robot.load import load_robot

    given = mappings(columns)
    dynamics = compiled(load_robot(robot))
    with progress(as_json) as say:
        if logs:
            from deltaid.identification.least_squares import identify_base

            say("reading logs")
            result, estimate = identify_base(
                dynamics, logs, method, columns=given, cutoff=cutoff, keep_all=keep_all
            )
        else:
            say("trying a random motion")
            result, estimate = measured_base(dynamics, seed), None
    if as_json:
        print_json(_as_dictionary(dynamics, result, estimate))
    else:
        _print(dynamics, result, estimate, full)


def _as_dictionary(
    dynamics: "Dynamics", result: "BaseParameters", estimate: "BaseEstimate | None"
) -> dict[str, Any]:
    layout = result.layout
    value = {
        "robot": dynamics.robot.name,
        "columns": len(layout.names),
        "nonzero_columns": len(layout.names) - len(result.invisible),
        "base_parameters": result.rank,
        "optimization_variables": _free(dynamics),
        "condition": result.condition,
        "groups": list(result.formulas),
        "invisible": [layout.names[i] for i in result.invisible],
    }
    if estimate is not None:
        value |= {
            "method": estimate.method,
            "values": estimate.values.tolist(),
            "std": estimate.std.tolist(),
            "low": (estimate.values - estimate.interval).tolist(),
            "high": (estimate.values + estimate.interval).tolist(),
        }
    return value


def _print(
    dynamics: "Dynamics", result: "BaseParameters", estimate: "BaseEstimate | None", full: bool
) -> None:
    from deltaid.view.model_tables import estimate_table

    robot, layout = dynamics.robot, result.layout
    measured = len(robot.measured) + sum(len(body.measured) for body in robot.bodies.values())
    beside = [*robot.sensors, *([f"{measured} measured values"] if measured else [])]
    where = "" if beside else " in torques"
    visible = len(layout.names) - len(result.invisible)
    lines = [
        robot.title or robot.name,
        f"{len(layout.names)} parameters, {visible} visible{where}, {result.rank} base "
        f"parameters; {_free(dynamics)} free in a consistent fit",
    ]
    if beside:
        lines.append(f"determined by torques together with {', '.join(beside)}")
    names = ", ".join(layout.names[i] for i in result.invisible)
    where = "anything that is measured" if beside else "any torque"
    lines.append(f"not visible in {where}: {names}")
    units = [layout.units[group.representative] for group in result.groups]
    print_found(lines, [estimate_table(result.formulas, units, estimate)], full=full)


def _free(dynamics: "Dynamics") -> int:
    """Number of optimisation variables of the consistent fit."""
    from deltaid.estimation.information import active_columns
    from deltaid.estimation.reduction import build_reduction

    return build_reduction(dynamics.robot, active_columns(dynamics)).size
