"""Options that many commands have."""

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.errors import DeltaidError
from deltaid.model.options import ComplianceChoice

if TYPE_CHECKING:
    from deltaid.recording.mapping import ColumnMapping

# Of every command that reads torques.
KeepAll = Annotated[
    bool,
    typer.Option(
        "--keep-all", help="Leave nothing out: rest, brakes, stops, saturation, reversals."
    ),
]

# Of every command that fits recordings, or gathers them for a fit.
Robot = Annotated[str, typer.Argument(help="Catalogue name, or a robot or model file.")]
Cutoff = Annotated[float | None, typer.Option(help="Low-pass cut-off in Hz. Default: by the data.")]
Lag = Annotated[
    str,
    typer.Option(
        help="Lag of torques behind positions: estimate, none, or ms, for all drives (2) or each "
        "(2,2,2,-1.5)."
    ),
]
Compliance = Annotated[
    ComplianceChoice,
    typer.Option(
        help="Gears that wind up: estimate where the description states no stiffness, or none."
    ),
]
Events = Annotated[
    bool,
    typer.Option(help="Look for contacts, stops, spikes and play in gears, and leave them out."),
]
Force = Annotated[bool, typer.Option("--force", help="Go on with what the checks call wrong.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]

# Of every command that takes several recordings.
ColumnFiles = Annotated[
    list[Path] | None,
    typer.Option(
        help="Which column is what, its unit, and loads held (YAML); repeated, one a recording."
    ),
]


def mappings(paths: Sequence[Path] | None) -> "list[ColumnMapping] | None":
    """The mappings of --columns, in their order; None without any."""
    from deltaid.recording.mapping import load_mapping

    return [load_mapping(path) for path in paths] if paths else None


def output_file(*names: str, help: str) -> Any:
    """An option with the name of a file to write; missing folders are made when it is written."""
    return typer.Option(*names, help=help, metavar="PATH", parser=_file, autocompletion=_complete)


def _file(text: str) -> Path:
    if text.endswith(("/", os.sep)):
        raise DeltaidError("is a folder; give the name of a file", where=text)
    return Path(text)


def _complete(incomplete: str) -> list[str]:
    """Files and folders that begin with what has been typed."""
    found = glob.glob(f"{glob.escape(incomplete)}*")
    return [path + "/" * os.path.isdir(path) for path in sorted(found)]
