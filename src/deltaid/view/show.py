"""Cards that represent values as text or HTML, and the dispatch from a value to its card, figure
and page."""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltaid.errors import DeltaidError, visible
from deltaid.view.page import Table

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Limits of a text representation: number of lines, and characters of a line.
_LINES, _LINE = 10, 140
_COLOURS = {
    "good": "#1a7f37", "fair": "#8a6100", "doubtful": "#8a6100", "poor": "#b42318",
    "wrong": "#b42318",
}  # fmt: skip
# Limits of values in a card: numbers of an array that is written in full, and characters of a text.
_WRITTEN, _CHARACTERS = 16, 60


# For each class, by its module: the prefix of its functions, such as 'run' in 'run_card'; the
# module of its card and frame, and that of its figure and page, in this room or in one above. Other
# classes have a card of their fields; a class without a function for its frame has a table.
_KINDS = {
    "calibration.calibrate.Calibration": ("calibration", "calibration", "calibration"),
    "model.verdict.Verdict": ("verdicts", "check", "check"),
    "checks.verdicts.Verdicts": ("verdicts", "check", "check"),
    "control.comparison.Comparison": ("simulation", "tracking", "tracking"),
    "control.simulate.Simulation": ("simulation", "tracking", "tracking"),
    "dynamics.dynamics.Dynamics": ("robot", "robots", "robots"),
    "dynamics.forward_dynamics.ForwardDynamics": ("robot", "robots", "robots"),
    "fleets.run.FleetRun": ("fleet_run", "fleets.run_card", "fleets.run_card"),
    "motion.excitation.excite.Excitation": ("excitation", "excitation", "excitation"),
    "motion.excitation.excite.Exciter": ("exciter", "excitation", "excitation"),
    "motion.excitation.run.Run": ("run", "excitation", "excitation"),
    "joint_forces.constraint_forces.ConstraintForces": ("robot", "robots", "robots"),
    "joint_forces.forces.Forces": ("forces", "forces", "forces"),
    "identification.identify.Identification": ("identification", "models", "model_pages"),
    "identification.prediction.FeedForward": ("feed_forward", "models", "models"),
    "identification.prediction.Validation": ("validation", "models", "model_pages"),
    "mechanism.kinematics.Kinematics": ("robot", "robots", "robots"),
    "model.model.Model": ("model", "models", "model_pages"),
    "model.record.IdentifiedModel": ("model", "models", "model_pages"),
    "model.samples.Samples": ("samples", "models", "models"),
    "motion.fourier.FourierMotion": ("run", "excitation", "excitation"),
    "sensors.planning.plan.SensorPlan": ("plan", "sensor_plan", "sensors"),
    "recording.log.Log": ("log", "recordings", "recordings"),
    "recording.mapping.ColumnMapping": ("mapping", "recordings", "recordings"),
    "recording.memory.Recording": ("recording", "recordings", "recordings"),
    "recording.recording.PreparedRecording": ("log", "recordings", "recordings"),
    "robot.description.RobotDescription": ("robot", "robots", "robots"),
}


@dataclass(frozen=True)
class Card:
    """Representation of a value.

    Attributes:
        title: what the value is.
        lines: sentences; the first is the verdict if there is a grade.
        apart: whether a prompt shows each fact on its own line.
        prompt_lines: additional sentences for a prompt, in place of a notebook's table.
        grade: a word of `Grade`, of models or of checks; empty if the value has none.
        facts: its main numbers, by name.
        table: the numbers as a table, for notebooks; None if facts suffice.
        more: sections that unfold in a notebook: title, and text or table.
        methods: useful next calls, such as '.plot()'.
    """

    title: str
    lines: tuple[str, ...] = ()
    grade: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    table: Table | None = None
    more: tuple[tuple[str, "str | Table"], ...] = ()
    methods: tuple[str, ...] = ()
    prompt_lines: tuple[str, ...] = ()
    apart: bool = False

    def text(self) -> str:
        """A few lines for a prompt."""
        facts = [f"{name} {value}" for name, value in self.facts]
        sentences = (
            textwrap.shorten(line, 2 * _LINE, placeholder=" …")
            for line in (*self.lines, *self.prompt_lines)
        )
        shown = [f"  {fact}" for fact in facts] if self.apart else [", ".join(facts)] * bool(facts)
        folded = list[str]()
        for line in (self.title, *sentences, *shown):
            folded += textwrap.wrap(visible(line), 100, subsequent_indent="  ") or [""]
        if len(folded) > _LINES - 1:
            folded = [*folded[: _LINES - 2], "  …"]
        return "\n".join([*folded, *([f"→ {'  '.join(self.methods)}"] if self.methods else [])])

    def html(self) -> str:
        """A short piece of HTML for a notebook."""
        lines, verdict = self.lines, ""
        if self.grade and lines:
            (verdict, *lines), (head, colon, rest) = lines, lines[0].partition(": ")
            if colon and head.lower() == self.grade:  # the label shows the grade
                verdict = rest
        table = self.table or (Table(("", ""), self.facts) if self.facts else None)
        colour = _COLOURS.get(self.grade, "#57606a")
        return (
            import_module("deltaid.view.html")
            .environment()
            .get_template("card.html.jinja")
            .render(card=self, lines=lines, verdict=verdict, table=table, colour=colour)
        )


def fields_card(value: Any) -> Card:
    """Card of the fields of a data class, or of a part of a description."""
    names = [f.name for f in fields(value)] if is_dataclass(value) else type(value).model_fields
    facts = (
        (name, _short_text(getattr(value, name))) for name in names if not name.startswith("_")
    )
    return Card(type(value).__name__, facts=tuple(facts), apart=True)


def _short_text(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    if isinstance(value, np.ndarray):
        written = " ".join(np.array2string(value, precision=4, separator=", ").split())
        return written if value.size <= _WRITTEN else f"array of shape {value.shape}"
    if isinstance(value, dict | tuple | list) and len(repr(value)) > _CHARACTERS:
        few = ", ".join(str(entry) for entry in list(value)[:4] if isinstance(entry, str))
        return f"{len(value)} entries" + (f": {few}, …" if few else "")
    return text if len(text) <= _CHARACTERS else f"{text[: _CHARACTERS - 1]}…"


def text(value: object) -> str:
    return _function(value, "card")(value).text()


def html(value: object) -> str:
    return _function(value, "card")(value).html()


def figure(value: object) -> "go.Figure":
    """A Plotly figure for light and dark pages."""
    return import_module("deltaid.view.style").themed(_function(value, "figure")(value))


def frame(value: object, library: str) -> Any:
    """A table of polars or pandas.

    Raises:
        DeltaidError: there is no such library, or it is not installed.
    """
    if library not in ("polars", "pandas"):
        what, cure = f"there are no tables of '{library}'", "choose from polars and pandas"
        raise DeltaidError(what, where="to_frame", cure=cure)
    if library == "pandas" and find_spec("pandas") is None:
        cure = "pip install pandas, or take to_frame(), a table of polars"
        raise DeltaidError("pandas is not installed", where="to_frame", cure=cure)
    table = _function(value, "frame")(value)
    if library == "polars":
        return table
    columns = ((c.name, c.to_numpy() if c.dtype.is_numeric() else c.to_list()) for c in table)
    return import_module("pandas").DataFrame(dict(columns))


def report(value: object, path: str | Path, *more: object) -> Path:
    """Write the page of a value.

    Raises:
        DeltaidError: the file cannot be written, or its name does not end in .html.
    """
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise DeltaidError("must end in .html", where=str(path), cure="a report is a page")
    import_module("deltaid.view.html").write_page(_function(value, "page")(value, *more), path)
    return path


def _function(value: Any, act: str) -> Callable[..., Any]:
    for kind in type(value).__mro__:
        name = f"{kind.__module__.removeprefix('deltaid.')}.{kind.__qualname__}"
        if name in _KINDS:
            title, of_cards, of_pages = _KINDS[name]
            module = of_cards if act in ("card", "frame") else of_pages
            room = "deltaid" if "." in module else "deltaid.view"
            functions = vars(import_module(f"{room}.{module}"))
            return functions.get(f"{title}_{act}") or type(value).table
    return fields_card
