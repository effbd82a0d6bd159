"""What a prompt asks of a value: a few lines, a card, a figure, a table, a page.

Classes of all rooms inherit the methods here; what these show is put together in the room
`view/`, which stands on all others and is looked up by name when a method is called. So a low
room depends on no upper one, and nothing is imported until something is shown.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import polars as pl


class Named:
    """Completed by names of its own only."""

    def __dir__(self) -> list[str]:
        """Names of the package's own classes, without those of what they are built on."""
        own = {name for name in vars(self) if not name.startswith("_")}
        for kind in type(self).__mro__:
            if kind.__module__.partition(".")[0] == "deltaid":
                own |= {name for name in vars(kind) if not name.startswith("_")}
                own |= {n for n in vars(kind).get("__annotations__", {}) if not n.startswith("_")}
        return sorted(own - _OF_PYDANTIC)


class Shown(Named):
    """Short at a prompt, a card in a notebook, and completed by names of its own only."""

    def __repr__(self) -> str:
        """A few lines: what it is, and its main numbers."""
        return _notebook("show", "text")(self)

    def _repr_html_(self) -> str:
        return _notebook("show", "html")(self)


class Plotted:
    """What can be drawn."""

    def plot(self) -> "go.Figure":
        """A Plotly figure, in the colours of the reports.

        Raises:
            DeltaidError: there is nothing to draw.
        """
        return _notebook("show", "figure")(self)


class Tabled:
    """What is a table at heart."""

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> "pl.DataFrame": ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> "pd.DataFrame": ...
    def to_frame(self, library: str = "polars") -> Any:
        """Its numbers as a table, of polars; or of pandas where that is installed.

        Raises:
            DeltaidError: pandas is asked for and not installed, or it is another library.
        """
        return _notebook("show", "frame")(self, library)


class Reported:
    """What has a page."""

    def report(self, path: str | Path) -> Path:
        """Write a page of text, tables and figures: one HTML file that works offline.

        Raises:
            DeltaidError: the file cannot be written, or what the page needs is missing.
        """
        return _notebook("show", "report")(self, path)


# Methods of `Part`, overridden there, that pydantic knows and users do not need.
_OF_PYDANTIC = {"model_config", "model_copy", "model_fields", "model_post_init"}


def _notebook(module: str, name: str) -> Any:
    return getattr(import_module(f"deltaid.view.{module}"), name)
