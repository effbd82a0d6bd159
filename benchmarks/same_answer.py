"""Whether `identify` gives the same model on every machine: decisions and values under rounding.

    pip install -e '.[test]'
    python benchmarks/same_answer.py [--recordings N] [--processes N] [--keep FOLDER]

60 recordings of `tests/drives` (clean, with one fault, with several) are made once, then identified
as here and again with what machines differ by: kernels of OpenBLAS, the vector code of deltaid's
own kernels, and each recorded number changed by 1e-12 of itself. Prints which decisions differ
(corrections, friction laws, exclusions, refusals) and by how much values do, in half widths of
their 95 % intervals. Leaves `tables/same_answer.md`.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import _alone  # noqa: F401
import numpy as np
import polars as pl
from _table import STATED, leave
from _timing import options

from deltaid.checks.identify import identify
from deltaid.errors import DeltaidError
from deltaid.kernel.machine_code import VARIABLE
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from drives import KINDS, ROWS, case
from drives.identify import columns, described

# Relative change of each recorded number: larger than rounding, smaller than any sensor's noise.
CHANGE = 1e-12
CORES = ("Haswell", "Prescott", "SkylakeX", "Zen", "Sapphirerapids")
# What is changed, and how; the first one is what all others are compared with.
MACHINES: dict[str, dict[str, str]] = {
    "Haswell, 8-wide": {"OPENBLAS_CORETYPE": "Haswell", VARIABLE: "x86-64-v4"},
    **{f"{core}, 8-wide": {"OPENBLAS_CORETYPE": core, VARIABLE: "x86-64-v4"} for core in CORES[1:]},
    "Haswell, 4-wide": {"OPENBLAS_CORETYPE": "Haswell", VARIABLE: "x86-64-v3"},
    "Haswell, 4-wide without FMA": {"OPENBLAS_CORETYPE": "Haswell", VARIABLE: "x86-64-v2"},
    "Haswell, numbers changed": {
        "OPENBLAS_CORETYPE": "Haswell", VARIABLE: "x86-64-v4", "SAME_ANSWER_CHANGE": str(CHANGE),
    },
}  # fmt: skip
MIXED = ("three-laws", "realistic", "production", "production-undeclared", "homing", "unlogged")
HEAD = (
    "machine", "recordings with another decision", "of clean, one fault, several",
    "decisions that differ", "largest change of a value: equal decisions", "other decisions",
)  # fmt: skip
NOTE = """\
`identify` as it is, without options, on {count} recordings of `tests/drives`: {clean} clean,
{single} with one fault, {mixed} with several. Each line is compared with *{first}*. A decision is a
correction, a term of a friction law, a reason for which rows are excluded, or a refusal; counted
are those that one of two has and the other has not. Values are base parameters and parameters that
data decides, their change in half widths of the 95 % interval: 1 is as much as noise."""


def recordings(count: int) -> list[tuple[str, str, int]]:
    """Row, kind of robot and seed of each: a fifth clean, two fifths each with one and several."""
    single = [row for row in ROWS if row not in (*MIXED, "clean")]
    kinds = list(KINDS)
    return [
        *(("clean", kinds[k % len(kinds)], k) for k in range(count // 5)),
        *((single[k % len(single)], kinds[k % len(kinds)], k) for k in range(2 * count // 5)),
        *((MIXED[k % len(MIXED)], kinds[(k // len(MIXED) + k) % len(kinds)], k)
          for k in range(count - count // 5 - 2 * count // 5)),
    ]  # fmt: skip


def store(what: tuple[str, str, int], folder: Path) -> None:
    """Make a recording, once: what it is made by rounds otherwise on other machines, too."""
    made = case(*what)
    folder.mkdir(parents=True)
    for k, log in enumerate(made.logs):
        log.write_parquet(folder / f"log{k}.parquet")
    mappings = [m.model_dump(mode="json", exclude_unset=True) for m in columns(made) or ()]
    (folder / "columns.json").write_text(json.dumps(mappings))
    (folder / "robot.json").write_text(described(made).model_dump_json())


def answer(folder: Path) -> dict[str, Any]:
    """Decisions and values of one recording, in this process."""
    robot = RobotDescription.model_validate_json((folder / "robot.json").read_text())
    logs = [pl.read_parquet(path) for path in sorted(folder.glob("log*.parquet"))]
    stored = json.loads((folder / "columns.json").read_text())
    mappings = [ColumnMapping.model_validate(mapping) for mapping in stored]
    if change := float(os.environ.get("SAME_ANSWER_CHANGE", 0)):
        logs = [changed(log, change) for log in logs]
    try:
        model = identify(robot, logs, columns=mappings or None).model
    except DeltaidError as error:
        return {"decisions": [f"refused: {type(error).__name__}"], "values": {}}
    decisions = {f"correction {fix.kind} {fix.subject}".strip() for fix in model.corrections}
    terms = model.friction_choice.steps if model.friction_choice else ()
    decisions |= {f"law {term.joint} {term.addition}" for term in terms if term.useful}
    for source in model.sources:
        decisions |= {f"excluded {stretch.reason}" for stretch in source.left_out}
        decisions |= {f"{len(source.events)} events"} if source.events else set()
    values = {p.name: (p.value, half_width(p.low, p.high)) for p in model.parameters
              if p.determined_by == "data"}  # fmt: skip
    values |= {f"base {base.representative}": (base.value, half_width(base.low, base.high))
               for base in model.base_parameters}  # fmt: skip
    return {"decisions": sorted(decisions), "values": values}


def changed(log: pl.DataFrame, change: float) -> pl.DataFrame:
    """A recording whose measured numbers are larger or smaller by a share of themselves.

    Their last bit says which, so numbers that are equal stay so, as in a conversion of units. Whole
    numbers stay as they are: counters and signals.
    """

    def moved(column: pl.Series) -> pl.Series:
        x = column.to_numpy()
        sign = np.where(x.view(np.int64) & 1, 1.0, -1.0)
        return pl.Series(column.name, np.where(x == np.round(x), x, x * (1 + change * sign)))

    return log.with_columns(moved(column) for column in log if column.dtype == pl.Float64)


def half_width(low: float, high: float) -> float:
    return (high - low) / 2


def differences(first: dict[str, Any], second: dict[str, Any]) -> tuple[list[str], float]:
    """Decisions that differ, and the largest change of a value in half widths."""
    other = sorted(set(first["decisions"]) ^ set(second["decisions"]))
    values, others = first["values"], second["values"]
    changes = [abs(others[name][0] - value) / half for name, (value, half) in values.items()
               if name in others and half > 0]  # fmt: skip
    return other, max(changes, default=0.0)


def on(machine: str, keep: Path) -> list[dict[str, Any]]:
    """Answers of all recordings, in a process that is set up as that machine."""
    kept = keep / f"{machine}.jsonl"
    if kept.exists():
        lines = kept.read_text().splitlines()
    else:
        command = [sys.executable, __file__, "--keep", str(keep), "--answers"]
        environment = os.environ | MACHINES[machine]
        done = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=True
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
        kept.write_text("\n".join(lines))
    print(f"{machine}: done", flush=True)
    return [json.loads(line) for line in lines]


def rows(asked: list[tuple[str, str, int]], found: dict[str, list[Any]]) -> Iterator[list[str]]:
    """Of the table, with every difference printed."""
    first, *others = MACHINES
    for machine in others:
        pairs = [differences(*pair) for pair in zip(found[first], found[machine], strict=True)]
        for what, (other, change) in zip(asked, pairs, strict=True):
            if other:
                print(machine, *what, other, f"{change:.2g} half widths", sep="; ")
        odd = [what[0] for what, (other, _) in zip(asked, pairs, strict=True) if other]
        groups = [sum(kind(row) == group for row in odd) for group in range(3)]
        equal = max((change for other, change in pairs if not other), default=0.0)
        unequal = max((change for other, change in pairs if other), default=None)
        differ = str(sum(len(other) for other, _ in pairs))
        yield [
            machine, f"{len(odd)} of {len(pairs)}", ", ".join(map(str, groups)), differ,
            f"{equal:.2g}", "" if unequal is None else f"{unequal:.2g}",
        ]  # fmt: skip


def kind(row: str) -> int:
    """0 for a clean recording, 1 for one fault, 2 for several."""
    return 0 if row == "clean" else 2 if row in MIXED else 1


def main() -> None:
    count, processes = STATED["same_answer"]["recordings"], os.cpu_count() or 1
    asked = options(__doc__, recordings=count, processes=processes, keep=Path, answers=False)
    if asked.answers:
        for k in range(len(list(asked.keep.glob("recording-*")))):
            print(json.dumps(answer(asked.keep / f"recording-{k}")), flush=True)
        return
    wanted = recordings(asked.recordings)
    with tempfile.TemporaryDirectory() as folder:
        keep = asked.keep or Path(folder)
        for k, what in enumerate(wanted):
            if not (keep / f"recording-{k}").exists():
                store(what, keep / f"recording-{k}")
        with ThreadPoolExecutor(asked.processes) as pool:
            answers = pool.map(lambda machine: on(machine, keep), MACHINES)
            found = dict(zip(MACHINES, answers, strict=True))
    clean, single, mixed = (sum(kind(row) == g for row, _, _ in wanted) for g in range(3))
    counts = {"count": len(wanted), "clean": clean, "single": single, "mixed": mixed}
    note = NOTE.format(**counts, first=next(iter(MACHINES)))
    leave(HEAD, list(rows(wanted, found)), note, recordings=len(wanted))


if __name__ == "__main__":
    main()
