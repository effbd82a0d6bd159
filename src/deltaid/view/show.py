"""From a value to what shows it: the module of its kind, looked up by the name of its class."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deltaid.errors import DeltaidError
from deltaid.view import card

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Class, by the module that it lives in: its kind, and the modules here of the functions that make
# its card and frame, and its figure and page, such as 'run_card'.
_KINDS = {
    "calibration.calibrate.Calibration": ("calibration", "calibration", "calibration"),
    "model.verdict.Verdict": ("verdicts", "check", "check"),
    "checks.verdicts.Verdicts": ("verdicts", "check", "check"),
    "control.simulate.Comparison": ("simulation", "simulations", "simulations"),
    "control.simulate.Simulation": ("simulation", "simulations", "simulations"),
    "control.simulation.StatePath": ("fields", "card", "card"),
    "dynamics.dynamics.Dynamics": ("robot", "robots", "robots"),
    "dynamics.dynamics.Terms": ("fields", "card", "card"),
    "dynamics.forward_dynamics.ForwardDynamics": ("robot", "robots", "robots"),
    "motion.excitation.excite.Excitation": ("excitation", "motions", "excitation"),
    "motion.excitation.excite.Exciter": ("exciter", "motions", "excitation"),
    "motion.excitation.run.Run": ("run", "motions", "excitation"),
    "joint_forces.constraint_forces.ConstraintForces": ("robot", "robots", "robots"),
    "joint_forces.forces.Forces": ("forces", "forces", "forces"),
    "estimation.base_parameters.BaseParameters": ("fields", "card", "card"),
    "identification.identify.Identification": ("identification", "models", "model_pages"),
    "identification.prediction.Validation": ("validation", "models", "model_pages"),
    "identification.torque_error.TorqueError": ("fields", "card", "card"),
    "mechanism.kinematics.BodyPoses": ("fields", "card", "card"),
    "mechanism.kinematics.Kinematics": ("robot", "robots", "robots"),
    "mechanism.regularity.Regularity": ("fields", "card", "card"),
    "model.model.Model": ("model", "models", "model_pages"),
    "model.record.IdentifiedModel": ("model", "models", "model_pages"),
    "model.samples.Samples": ("samples", "samples", "samples"),
    "motion.fourier.FourierMotion": ("run", "motions", "excitation"),
    "sensors.planning.offers.Offers": ("fields", "card", "card"),
    "sensors.planning.plan.SensorPlan": ("plan", "sensor_plan", "sensors"),
    "recording.log.Log": ("log", "recordings", "recordings"),
    "recording.mapping.ColumnMapping": ("mapping", "recordings", "recordings"),
    "recording.memory.Recording": ("recording", "recordings", "recordings"),
    "recording.recording.PreparedRecording": ("log", "recordings", "recordings"),
    "robot.description.RobotDescription": ("robot", "robots", "robots"),
}


def text(value: object) -> str:
    """A few lines for a prompt."""
    return card.text(_function(value, "card")(value))


def html(value: object) -> str:
    """A card for a notebook."""
    return card.html(_function(value, "card")(value))


def figure(value: object) -> "go.Figure":
    """A Plotly figure that is read on light and dark pages."""
    themed = import_module("deltaid.view.style").themed
    return themed(_function(value, "figure")(value))


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
    found = _function(value, "frame")(value)
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
    page = _function(value, "page")(value, *more)
    import_module("deltaid.view.html").write_page(page, path)
    return path


def _function(value: object, act: str) -> Callable[..., Any]:
    """What makes the card, frame, figure or page of a value."""
    for kind in type(value).__mro__:
        name = f"{kind.__module__.removeprefix('deltaid.')}.{kind.__qualname__}"
        if name in _KINDS:
            title, of_cards, of_pages = _KINDS[name]
            module = of_cards if act in ("card", "frame") else of_pages
            return getattr(import_module(f"deltaid.view.{module}"), f"{title}_{act}")
    raise TypeError(f"nothing shows a {type(value).__name__}")
