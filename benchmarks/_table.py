"""Tables that studies leave in `benchmarks/tables`, with the command, the machine and the size.

The last line of a table says how much was run, and how much its study states as full:

    Size: rows=10 robots=200 (stated: rows=10 robots=200)

A smaller run leaves its table in `benchmarks/smaller`, so that it never replaces a larger one.
`tests/test_project_files.py` refuses tables that are smaller than what stands here.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

from _timing import machine

TABLES = Path(__file__).with_name("tables")
# Not part of the repository.
SMALLER = Path(__file__).with_name("smaller")

Size = Mapping[str, int]

# Sizes of full tables. Studies take their defaults from here. The house has as many rooms as it
# has.
STATED: dict[str, Size] = {
    "belt_picks": {"rows": 14, "picks": 40},
    "bodies_weighed": {"rows": 24, "seeds": 100},
    "calibrate": {"rows": 13, "machines": 40},
    "calibrate_times": {"rows": 2},
    "calibrated_identify": {"rows": 3, "machines": 8},
    "coverage_of_intervals": {"rows": 6, "seeds": 200},
    "coverage_of_labels": {"rows": 12, "robots": 20},
    "cutoff_rule": {"rows": 8},
    "damaged_files": {"files": 500, "cases": 20_000, "bits": 10_000},
    "drawn_against_simulated": {"rows": 2, "recordings": 40},
    "drift": {"rows": 10, "robots": 200},
    "drift_files": {"rows": 1, "robots": 200},
    "fleet": {"rows": 15, "samples": 100_000_000},
    "fleet_nights": {"rows": 4},
    "house": {},
    "leave_one_out": {"rows": 12, "kinds": 6, "seeds": 1},
    "masks": {"rows": 16, "seeds": 6},
    "mutants": {"rows": 60},
    "online": {"rows": 12, "robots": 6, "minutes": 6},
    "online_cycle": {"rows": 4},
    "online_hours": {"rows": 12, "minutes": 60},
    "population": {"rows": 38, "robots": 200, "types": 3},
    "posterior": {"rows": 4},
    "readers": {"rows": 20, "samples": 1_000_000, "repeats": 3},
    "real_data": {"rows": 8},
    "real_drives": {"rows": 59, "kinds": 6, "seeds": 5},
    "same_answer": {"rows": 7, "recordings": 60},
    "scales_and_sensors": {"rows": 10, "motions": 5},
    "single_precision": {"rows": 10, "robots": 7},
    "slow_drive4": {"rows": 10, "seeds": 5, "seconds": 20},
    "studio": {"rows": 23, "samples": 1_000_000},
    "tracking_load": {"rows": 12},
    "tracking_unlike": {"rows": 14, "robots": 5},
    "verdicts": {"rows": 44, "clean": 200, "faulty": 200},
    "wiring": {"rows": 39, "kinds": 4, "seeds": 20},
}
# Tables that were made at a smaller size, or before their study had all of its rows; nothing
# smaller than this replaces them. An entry goes as soon as its study has been run in full.
BEHIND: dict[str, Size] = {
    "bodies_weighed": {"rows": 12, "seeds": 100},
    "coverage_of_labels": {"rows": 12, "robots": 12},
    "readers": {"rows": 15, "samples": 1_000_000, "repeats": 3},
    "real_drives": {"rows": 59, "kinds": 6, "seeds": 2},
}


def leave(
    head: Sequence[str], rows: Sequence[Sequence[object]], note: str, name: str = "", **counts: int
) -> Path:
    """Write a Markdown table with its size, and print it.

    Args:
        name: of the table; that of the command where none is given.
        counts: how many of what was run, by the names in `STATED`.

    Returns:
        The file: in `smaller` where the run is smaller than a table has to be.
    """
    script = Path(sys.argv[0])
    name = name or script.stem
    command = " ".join(["python", f"benchmarks/{script.name}", *sys.argv[1:]])
    size = {"rows": len(rows), **counts}
    text = (
        f"{note}\n\n`{command}`, {date.today()}\n\n{table(head, rows)}\n\n{machine()}\n\n"
        f"{size_line(name, size)}\n"
    )
    missing = short_of(size, BEHIND.get(name, STATED.get(name, {})))
    path = (SMALLER if missing else TABLES) / f"{name}.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(text)
    if missing:
        print(f"Not a full table ({missing}): {path}", file=sys.stderr)
    return path


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [" | ".join(map(str, row)) for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(f"| {line} |" for line in lines)


def size_line(name: str, size: Size) -> str:
    """The last line of a table: what was run, and what is stated."""
    run, stated = (
        " ".join(f"{what}={count}" for what, count in counts.items())
        for counts in (size, STATED.get(name, {}))
    )
    return f"Size: {run} (stated: {stated or 'whatever there is'})"


def read_size(text: str) -> Size:
    """What was run, from the last line of a table; empty where it says nothing."""
    last = text.rstrip().rpartition("\n")[2]
    run = last.partition("(")[0] if last.startswith("Size: ") else ""
    return {what: int(count) for what, count in re.findall(r"(\w+)=(\d+)", run)}


def short_of(size: Size, needed: Size) -> str:
    """What a size lacks, such as 'robots 5 of 200'; empty where it lacks nothing."""
    lacks = (
        f"{what} {size.get(what, 0)} of {count}"
        for what, count in needed.items()
        if size.get(what, 0) < count
    )
    return ", ".join(lacks)
