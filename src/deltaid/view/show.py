"""From a value to what shows it: the module of its kind, looked up by the name of its class."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deltaid.errors import DeltaidError
from deltaid.view import card

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Class, by the module that it lives in, and the module here that shows it.
_KINDS = {
    "model.verdict.Verdict": "verdicts",
    "checks.verdicts.Verdicts": "verdicts",
    "control.simulate.Comparison": "simulations",
    "control.simulate.Simulation": "simulations",
    "control.simulation.Path": "values",
    "dynamics.dynamics.Dynamics": "robots",
    "dynamics.dynamics.Terms": "values",
    "dynamics.forward_dynamics.ForwardDynamics": "robots",
    "motion.excitation.excite.Excitation": "motions",
    "motion.excitation.excite.Exciter": "exciters",
    "motion.excitation.run.Run": "runs",
    "joint_forces.constraint_forces.ConstraintForces": "robots",
    "joint_forces.forces.Forces": "forces",
    "estimation.base_parameters.BaseParameters": "values",
    "identification.identify.Identification": "identifications",
    "identification.torque_error.TorqueError": "values",
    "identification.validation.Validation": "validations",
    "mechanism.kinematics.BodyPoses": "values",
    "mechanism.kinematics.Kinematics": "robots",
    "mechanism.regularity.Regularity": "values",
    "model.model.Model": "models",
    "model.record.IdentifiedModel": "models",
    "model.samples.Samples": "samples",
    "motion.fourier.FourierMotion": "runs",
    "sensors.planning.offers.Offers": "values",
    "sensors.planning.plan.SensorPlan": "plans",
    "recording.log.Log": "logs",
    "recording.mapping.ColumnMapping": "mappings",
    "recording.memory.Recording": "recordings",
    "recording.recording.Recording": "logs",
    "robot.description.RobotDescription": "robots",
}


def text(value: object) -> str:
    """A few lines for a prompt."""
    return card.text(_shower(value).card(value))


def html(value: object) -> str:
    """A card for a notebook."""
    return card.html(_shower(value).card(value))


def figure(value: object) -> "go.Figure":
    """A Plotly figure that is read on light and dark pages."""
    themed = import_module("deltaid.view.theme").themed
    return themed(_shower(value).figure(value))


def frame(value: object, library: str) -> Any:
    """A table of polars or pandas.

    Raises:
        DeltaidError: there is no such library, or it is not installed.
    """
    if library not in ("polars", "pandas"):
        raise DeltaidError(
            f"there are no tables of '{library}'",
            where="to_frame",
            cure="choose from polars and pandas",
        )
    if library == "pandas" and find_spec("pandas") is None:
        raise DeltaidError(
            "pandas is not installed",
            where="to_frame",
            cure="pip install pandas, or take to_frame(), a table of polars",
        )
    found = _shower(value).frame(value)
    if library == "polars":
        return found
    columns = {
        name: column.to_numpy() if column.dtype.is_numeric() else column.to_list()
        for name, column in ((name, found[name]) for name in found.columns)
    }
    return import_module("pandas").DataFrame(columns)


def report(value: object, path: str | Path, *more: object) -> Path:
    """Write the page of a value.

    Raises:
        DeltaidError: the file cannot be written, or its name does not end in .html.
    """
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise DeltaidError("must end in .html", where=str(path), cure="a report is a page")
    page = _shower(value).page(value, *more)
    import_module("deltaid.view.page").write_page(page, path)
    return path


def _shower(value: object) -> Any:
    for kind in type(value).__mro__:
        name = f"{kind.__module__.removeprefix('deltaid.')}.{kind.__qualname__}"
        if name in _KINDS:
            return import_module(f"deltaid.view.{_KINDS[name]}")
    raise TypeError(f"nothing shows a {type(value).__name__}")
