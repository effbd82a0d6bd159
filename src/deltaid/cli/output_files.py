"""Files that a command writes: none is an input, all are whole, and their names are printed."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from deltaid.cli.output import console
from deltaid.errors import DeltaidError
from deltaid.files import require_writable, together, write_bytes
from deltaid.view.numbers import number as number
from deltaid.view.numbers import percent as percent  # for the commands too


def require_outputs(inputs: Iterable[str | Path | None], files: Mapping[str, Path | None]) -> None:
    """Refuse before any work files that could not be written, would replace an input or each other.

    Args:
        inputs: names of files, of robots in the catalogue, or None for what is not given.
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


def write_files(*files: tuple[Path | None, str | Callable[[Path], object]]) -> None:
    """Write the files that were asked for, all or none: a text, or what a function writes."""
    with together():
        for path, content in files:
            if path is None:
                continue
            if isinstance(content, str):
                write_bytes(path, content.encode())
            else:
                content(path)


def print_written(*paths: Path | None) -> None:
    """Names of files that have been written; None for one that was not asked for."""
    for path in paths:
        if path is not None:
            console.print(f"wrote {path}")
