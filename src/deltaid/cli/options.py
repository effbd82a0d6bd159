"""Options of several commands, types of options, and options that are refused together."""

import glob
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from deltaid.errors import DeltaidError, positive, within
from deltaid.files import require_writable
from deltaid.model.options import ComplianceChoice, lag_of


def output_file(*names: str, help: str, endings: tuple[str, ...] = ()) -> Any:
    """An option with the name of a file to write; missing folders are made when it is written.

    Args:
        endings: of a name that has one, so that no other kind of file is replaced.
    """

    def file(text: str) -> Path:
        path = Path(text)
        if text.endswith(("/", os.sep)):
            raise DeltaidError("is a folder; give the name of a file", where=text)
        if endings and path.suffix and path.suffix.lower() not in endings:
            raise DeltaidError(f"must end in {' or '.join(endings)}", where=text)
        return path

    return typer.Option(*names, help=help, metavar="PATH", parser=file, autocompletion=_complete)


# Endings of robots, models and mappings, and of tables.
YAML, CSV = (".yaml", ".yml"), (".csv",)


def _complete(incomplete: str) -> list[str]:
    """Files and folders that begin with the typed text."""
    return [
        path + "/" * os.path.isdir(path)
        for path in sorted(glob.glob(f"{glob.escape(incomplete)}*"))
    ]


# Panel of `--help` for rarely needed options.
CORRECTIONS = "Corrections and filters"


def bounded(
    *names: str,
    help: str,
    limits: tuple[float, float] = (0.0, math.inf),
    panel: str | None = None,
) -> Any:
    """An option with a number within limits; without an upper limit the number is positive."""

    # Typer identifies a callback's arguments by position where they lack its types.
    def checked(_: Any, parameter: Any, value: float | None) -> float | None:
        if value is not None:
            is_positive = limits[0] > 0 or limits[1] == math.inf
            (positive if is_positive else within)(parameter.opts[0], value, limits)
        return value

    return typer.Option(*names, help=help, callback=checked, rich_help_panel=panel)


# Arguments of commands with a robot or a model.
Robot = Annotated[str, typer.Argument(help="Catalogue name, or a robot or model file.")]
ModelOrRobot = Annotated[
    str, typer.Argument(help="Saved model; or catalogue name or robot file, for its prior.")
]

# Options of all commands that read torques.
KeepAll = Annotated[
    bool,
    typer.Option(
        "--keep-all",
        help="Exclude no rows: keep rest, brakes, stops, saturation, reversals.",
        rich_help_panel=CORRECTIONS,
    ),
]
Columns = Annotated[Path | None, typer.Option(help="Mapping file: columns and their units (YAML).")]
MotionColumns = Annotated[
    Path | None, typer.Option(help="Mapping file: columns of MOTION and their units (YAML).")
]
# Arguments of all commands with several recordings.
ColumnFiles = Annotated[
    list[Path] | None,
    typer.Option(
        help="Mapping file: columns, units and loads (YAML). Repeatable: one for all "
        "recordings, or one each."
    ),
]

# Options of all commands that fit recordings, or gather them for a fit.
Cutoff = Annotated[
    float | None,
    bounded(help="Low-pass cut-off, Hz. Default: from the data.", panel=CORRECTIONS),
]
Lag = Annotated[
    Any,
    typer.Option(
        help="Lag of torques behind positions: estimate, none, or a number of ms, "
        "for all drives (2) or each (2,2,2,-1.5).",
        metavar="LAG",
        parser=lag_of,
        rich_help_panel=CORRECTIONS,
    ),
]
Compliance = Annotated[
    ComplianceChoice,
    typer.Option(
        help="Compliance of gears: estimate it unless the description states a stiffness, or none.",
        rich_help_panel=CORRECTIONS,
    ),
]
Events = Annotated[
    bool,
    typer.Option(
        help="Detect and exclude contacts, stops, spikes and backlash.",
        rich_help_panel=CORRECTIONS,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Continue although deltaid detects a fault.")]

UsePoor = Annotated[bool, typer.Option("--force", help="Use a poor model.")]

# Options of all commands with a result.
Report = Annotated[
    Path | None, output_file(help="HTML page to write, with figures and tables; works offline.")
]
Full = Annotated[
    bool, typer.Option("--full", help="Print every table and row, not only what fits a screen.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def names(text: str) -> tuple[str, ...]:
    """Names from a list such as 'strut,upper_arm'."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def require_unset(given: Mapping[str, bool], needs: str) -> None:
    """Refuse options that have no effect without another one.

    Args:
        given: options, and whether each differs from its default.
        needs: the missing option, with a value if it takes one.

    Raises:
        DeltaidError: one of these options is given.
    """
    for option, is_given in given.items():
        if is_given:
            raise DeltaidError(
                f"has no effect without {needs.split()[0]}",
                where=option,
                cure=f"add {needs}, or leave it out",
            )


def require_outputs(inputs: Iterable[str | Path | None], files: Mapping[str, Path | None]) -> None:
    """Raise, before any work, for files that cannot be written, or would replace an input or each
    other.

    Args:
        inputs: names of files or of robots in the catalogue; None for one that is not given.
        files: by option, such as '--output'; that of '--report' must be a page.
    """
    given = [Path(name) for name in inputs if name is not None]
    taken: dict[Path, str] = {}
    for option, path in files.items():
        if path is None:
            continue
        if option == "--report" and path.suffix.lower() != ".html":
            raise DeltaidError("must end in .html", where=f"--report {path}")
        require_writable(path, given)
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise DeltaidError(
                f"is the file of {other} as well; give another name", where=f"{option} {path}"
            )
