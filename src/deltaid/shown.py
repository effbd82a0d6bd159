"""Display of values: a few lines, a card, a figure, a table, a page.

Classes of all rooms inherit the methods here. What these show is made in `view/`, which depends on
all other rooms and is imported by name when a method is called. So no lower room depends on it, and
nothing is imported until something is shown.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import polars as pl


class Named:
    """Base class whose completion lists only names of this package's classes."""

    def __dir__(self) -> list[str]:
        """Names of the package's own classes, without those of foreign base classes."""
        kinds = [k for k in type(self).__mro__ if k.__module__.partition(".")[0] == "deltaid"]
        fields = (vars(kind).get("__annotations__", {}) for kind in kinds)
        names = set[str]().union(vars(self), *map(vars, kinds), *fields) - _OF_PYDANTIC
        return sorted(name for name in names if not name.startswith("_"))


class Shown(Named):
    """Short text at a prompt, a card in a notebook, and completion of own names only."""

    def __repr__(self) -> str:
        """A few lines: the object and its main numbers."""
        return _notebook("text")(self)

    def _repr_html_(self) -> str:
        return _notebook("html")(self)


class Plotted:
    """Mixin for objects with a figure."""

    def plot(self) -> "go.Figure":
        """A Plotly figure, in the colours of the reports.

        Raises:
            DeltaidError: there is nothing to draw.
        """
        return _notebook("figure")(self)


class Tabled:
    """Mixin for objects that are tables."""

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> "pl.DataFrame": ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> "pd.DataFrame": ...
    def to_frame(self, library: str = "polars") -> Any:
        """Its numbers as a table of polars or, if installed, of pandas.

        Raises:
            DeltaidError: pandas is not installed, or the library is neither of the two.
        """
        return _notebook("frame")(self, library)


class Reported:
    """Mixin for objects with a page."""

    def report(self, path: str | Path) -> Path:
        """Write a page of text, tables and figures: one HTML file that works offline.

        Raises:
            DeltaidError: the file cannot be written, or what the page needs is missing.
        """
        return _notebook("report")(self, path)


# Names of pydantic that `Part` overrides and that users do not need.
_OF_PYDANTIC = {"model_config", "model_copy", "model_fields", "model_post_init"}


def _notebook(name: str) -> Any:
    return getattr(import_module("deltaid.view.show"), name)
