"""Tables of an identified model, for the terminal and for its page: built once, here."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from deltaid.model.friction_record import AdditionKind, FrictionChoice
from deltaid.report.numbers import WIDTH, number, percent, with_uncertainty
from deltaid.report.table import Table
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_text import written

if TYPE_CHECKING:  # `deltaid base` prints a table without what reading recordings needs
    from deltaid.identification.least_squares import BaseEstimate
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.model import Model
    from deltaid.model.record import BaseParameter, IdentifiedModel, Parameter

# What ± stands for in tables.
_HALF_WIDTH = "± (95 %)"
ADDITIONS: dict[AdditionKind, str] = {
    "offset": "offset",
    "both_ways": "both ways",
    "power": "power of speed",
    "stribeck": "Stribeck",
    "load": "load",
}


def parameter_table(model: "IdentifiedModel", truth: Sequence[float] | None = None) -> Table:
    """Prior, value, interval and origin of every parameter that is not zero by structure.

    Args:
        truth: of a surrogate robot, parameter by parameter.
    """
    shown = [(k, p) for k, p in enumerate(model.parameters) if p.determined_by != "structure"]
    rows = tuple(
        (
            parameter.name,
            number(parameter.prior),
            *([] if truth is None else [number(truth[k])]),
            *_value(parameter),
            parameter.unit,
            origin(parameter),
        )
        for k, parameter in shown
    )
    true = () if truth is None else ("truth",)
    return Table(
        ("parameter", "prior", *true, "identified", _HALF_WIDTH, "unit", "from"),
        rows,
        "Inertias and first moments are about the origin of the body's link frame. Parameters "
        "that are zero by structure are left out. Grey rows are not decided by the data: behind "
        "“prior” stands how far that may be off; “fixed” is held by the description; "
        "“consistency” is a lower bound.",
        frozenset(i for i, (_, p) in enumerate(shown) if p.determined_by != "data"),
        model.robot.title or model.robot.name,
    )


def origin(parameter: "Parameter") -> str:
    """What decided a parameter; where it was the prior, how wide the interval of that is."""
    if parameter.determined_by != "prior" or parameter.high is None or not parameter.prior:
        return parameter.determined_by
    return f"prior ± {percent((parameter.high - parameter.prior) / abs(parameter.prior))}"


def _value(parameter: "Parameter") -> tuple[str, str]:
    """Value and half the width of its 95 % interval, if the data decided it."""
    if parameter.determined_by == "data":
        if parameter.high is None:  # a model of an earlier version
            return with_uncertainty(parameter.value, WIDTH * parameter.std)
        return with_uncertainty(parameter.value, parameter.high - parameter.value)
    bound = "≥ " if parameter.determined_by == "consistency" else ""
    return bound + number(parameter.value), ""


def base_table(parameters: "Sequence[BaseParameter]") -> Table:
    """Formula, value and interval of base parameters that a model holds."""
    return _base(
        [p.formula for p in parameters],
        [(p.value, p.high - p.value, p.unit) for p in parameters],
    )


def estimate_table(
    formulas: Sequence[str], units: Sequence[str], estimate: "BaseEstimate | None"
) -> Table:
    """The same of an estimate; without one, formulas alone."""
    if estimate is None:
        return _base(formulas, None)
    return _base(formulas, list(zip(estimate.values, estimate.interval, units, strict=True)))


def _base(formulas: Sequence[str], values: list[tuple[float, float, str]] | None) -> Table:
    rows = []
    for i, formula in enumerate(formulas):
        row = [f"{i + 1}", formula]
        if values is not None:
            value, half, unit = values[i]
            row += [*with_uncertainty(value, half), unit]
        rows.append(tuple(row))
    return Table(
        ("", "base parameter", *(() if values is None else ("value", _HALF_WIDTH, "unit"))),
        tuple(rows),
        "Combinations of parameters that the torques determine, each named by its first term.",
    )


def error_table(model: "Model", verification: "TorqueError | None") -> Table:
    """Torque errors per drive, on the identification's recordings and on another one."""
    fit, units = model.identified and model.identified.fit, model.robot.drive_units
    errors = [error for error in (fit, verification) if error is not None]
    alike, first = len(set(units.values())) == 1, next(iter(units.values()))
    heading = (f"{first.effort} error, {first.force}",) if alike else ("error of drive", "unit")
    rows = tuple(
        (
            drive,
            *(() if alike else (units[drive].force,)),
            *(
                cell
                for error in errors
                for cell in (
                    number(error.rms[i], 3),
                    percent(error.nrmse[i]),
                    number(error.rms_unfiltered[i], 3),
                )
            ),
        )
        for i, drive in enumerate(model.robot.drives)
    )
    second = ("verify rms", "share", "unfiltered") if len(errors) > 1 else ()
    return Table(
        (*heading, "rms", "share", "unfiltered", *second),
        rows,
        "Root mean square of measured minus predicted torque or force, also as a share of the "
        "measured one's own root mean square. Unfiltered is against what was recorded, with all "
        "its noise.",
    )


def choice_table(choice: FrictionChoice, robot: RobotDescription) -> Table:
    """For each joint what every addition alone gains, and the law that was chosen."""
    gains = {(t.joint, t.addition): t for t in choice.trials}
    rows = []
    for joint, law in robot.friction.items():
        row = [joint]
        for addition in ADDITIONS:
            trial = gains.get((joint, addition))
            gain = max(trial.gain, 0.0) if trial else 0.0
            row.append("–" if trial is None else percent(gain) if trial.useful else "chance")
        rows.append((*row, written(law)))
    title = (
        "friction laws: gain of each term alone on stretches the fit has not seen "
        f"({choice.folds} folds)"
    )
    return Table(
        ("joint", *ADDITIONS.values(), "chosen law"), tuple(rows), f"{title}.", title=title
    )


def choice_sentence(choice: FrictionChoice) -> str:
    """The torque error on unseen stretches before and after the choice."""
    return (
        f"torque error on unseen stretches {percent(choice.plain_error)} of the largest torque "
        f"with viscous and Coulomb friction, {percent(choice.chosen_error)} with the chosen laws"
    )
