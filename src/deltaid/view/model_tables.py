"""Tables of an identified model, shared by the terminal and pages."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from deltaid.model.parameter_record import AdditionKind, FrictionChoice, FrictionTrial
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import law_in_words
from deltaid.robot.inertia import MOMENTS_OF_INERTIA
from deltaid.view.numbers import measured, number, percent, span, with_uncertainty
from deltaid.view.page import Table

if TYPE_CHECKING:  # `deltaid base` prints a table without loading recordings' modules
    from deltaid.identification.least_squares import BaseEstimate
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.model import Model
    from deltaid.model.parameter_record import BaseParameter, Parameter
    from deltaid.model.record import IdentifiedModel

# Origins of intervals other than the parameter's own prior; those that need no priors of others.
MEASURED = ("data", "measured", "sum", "limit")
BY_ITSELF = ("data", "measured")
# Ratio of both sides of an interval above which a table shows its ends.
_LOPSIDED = 2.0
# Meaning of ± in tables.
_HALF_WIDTH = "± (95 %)"
_VERIFY = (
    " The columns from “verify rms” on are of the recording that the model was compared with, "
    "those before them of the ones that it was identified from."
)
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
        truth: true parameters of a surrogate robot, shown in place of the prior.
    """
    shown = [(k, p) for k, p in enumerate(model.parameters) if p.determined_by != "structure"]
    return Table(
        (
            "parameter",
            "prior" if truth is None else "truth",
            "identified",
            _HALF_WIDTH,
            "unit",
            "from",
        ),
        tuple(
            (
                parameter.name,
                number(parameter.prior if truth is None else truth[k]),
                *value_and_width(parameter),
                parameter.unit,
                parameter.determined_by,
            )
            for k, parameter in shown
        ),
        "Inertias and first moments are about the origin of the body's link frame. Parameters "
        "that are zero by structure are omitted. “Sum”: torques show only a sum of the parameter "
        "and others; its value depends on their priors, its interval does not. "
        "“Measured”: mostly what a scale or the like said. “Limit”: as small as physics allows. "
        "Grey rows are not decided by the data: beside “prior” stands how far that may be off, as "
        "a share or a factor; “fixed” is held by the description; “consistency” is a lower bound. "
        + " ".join(sums(model)),
        frozenset(i for i, (_, p) in enumerate(shown) if p.determined_by not in MEASURED),
        f"parameters{', intervals: posterior' * (model.settings.intervals == 'posterior')}",
    )


def sums(model: "IdentifiedModel") -> list[str]:
    """A sentence on parameters that torques determine only as sums, with the parameters whose
    priors they need."""
    resting = [p for p in model.parameters if p.determined_by == "sum" and p.rests_on]
    pairs = [f"{p.name} on {' and '.join(p.rests_on)}" for p in resting]
    return [f"Known as sums, with the priors of others: {', '.join(pairs)}."] if pairs else []


def value_and_width(parameter: "Parameter") -> tuple[str, str]:
    """Value, and half the width or the ends of its 95 % interval; for a prior, the prior's
    width."""
    if parameter.determined_by not in MEASURED:
        bound = "≥ " if parameter.determined_by == "consistency" else ""
        return bound + number(parameter.value), _prior_width(parameter)
    if parameter.high is None or parameter.low is None:  # a model of an earlier version
        from deltaid.estimation.scatter import NORMAL

        return with_uncertainty(parameter.value, NORMAL * parameter.std)
    up, down = parameter.high - parameter.value, parameter.value - parameter.low
    known = parameter.determined_by in BY_ITSELF
    if known and max(up, down) < _LOPSIDED * min(up, down):
        return with_uncertainty(parameter.value, max(up, down))
    return number(parameter.value), span(parameter.low, parameter.high)


def _prior_width(parameter: "Parameter") -> str:
    """Uncertainty of a prior: a factor for moments of inertia, a share for other parameters."""
    if parameter.determined_by != "prior" or parameter.high is None or not parameter.prior:
        return ""
    if parameter.low and parameter.name.endswith(MOMENTS_OF_INERTIA):
        return f"×÷ {float(f'{parameter.high / parameter.prior:.2g}'):g}"
    return percent((parameter.high - parameter.prior) / abs(parameter.prior))


def base_table(parameters: "Sequence[BaseParameter]") -> Table:
    """Formula, value and interval of a model's base parameters."""
    return _base(
        [p.formula for p in parameters],
        [(p.value, p.high - p.value, p.unit) for p in parameters],
    )


def estimate_table(
    formulas: Sequence[str], units: Sequence[str], estimate: "BaseEstimate | None"
) -> Table:
    """Formula, value and interval of an estimate; without one, formulas alone."""
    return _base(
        formulas, estimate and list(zip(estimate.values, estimate.interval, units, strict=True))
    )


def _base(formulas: Sequence[str], values: list[tuple[float, float, str]] | None) -> Table:
    cells: Sequence[tuple[str, ...]] = [()] * len(formulas)
    if values is not None:
        cells = [(*with_uncertainty(value, half), unit) for value, half, unit in values]
    return Table(
        ("", "base parameter", *(() if values is None else ("value", _HALF_WIDTH, "unit"))),
        tuple((f"{i + 1}", formula, *cells[i]) for i, formula in enumerate(formulas)),
        "Combinations of parameters that the torques determine, each named by its first term.",
        title="base parameters",
    )


def error_table(model: "Model", verification: "TorqueError | None") -> Table:
    """Torque errors of each drive, on the identification's recordings and on another one."""
    fit, units = model.identified and model.identified.fit, model.robot.drive_units
    errors = [error for error in (fit, verification) if error is not None]
    alike, first = len(set(units.values())) == 1, next(iter(units.values()))
    heading = (f"{first.effort} error, {first.force}",) if alike else ("error of drive", "unit")
    second = ("verify rms", "share", "unfiltered") if len(errors) > 1 else ()
    return Table(
        (*heading, "rms", "share", "unfiltered", *second),
        tuple(
            (
                drive,
                *(() if alike else (units[drive].force,)),
                *(
                    cell
                    for error in errors
                    for cell in (
                        measured(error.rms[i]),
                        percent(error.nrmse[i]),
                        measured(error.rms_unfiltered[i]),
                    )
                ),
            )
            for i, drive in enumerate(model.robot.drives)
        ),
        "Root mean square of measured minus predicted torque or force, also as a share of the "
        "measured one's own root mean square. Unfiltered is against what was recorded, with all "
        "its noise." + (_VERIFY if second else ""),
    )


def choice_table(choice: FrictionChoice, robot: RobotDescription) -> Table:
    """Gain of every additional term alone, joint by joint, and the chosen law."""
    gains = {(t.joint, t.addition): t for t in choice.trials}
    rows = tuple(
        (joint, *(_gain(gains.get((joint, key))) for key in ADDITIONS), law_in_words(law))
        for joint, law in robot.friction.items()
    )
    title = "friction laws: share of the squared error that each term alone explains"
    return Table(("joint", *ADDITIONS.values(), "chosen law"), rows, f"{title}.", title=title)


def _gain(trial: FrictionTrial | None) -> str:
    if trial is None:
        return "–"
    return percent(max(trial.gain, 0.0)) if trial.useful else "chance"


def choice_sentence(choice: FrictionChoice) -> str:
    """The torque error before and after the selection of laws."""
    return (
        f"torque error {percent(choice.plain_error)} of the largest torque with the described "
        f"laws, {percent(choice.chosen_error)} with the chosen ones"
    )
