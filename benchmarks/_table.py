"""Tables that studies leave in `benchmarks/tables`, with the command and the machine."""

import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from _timing import machine

TABLES = Path(__file__).with_name("tables")


def leave(head: Sequence[str], rows: Sequence[Sequence[object]], note: str, name: str = "") -> Path:
    """Write a Markdown table, named like the command where nothing else is said, and print it."""
    script = Path(sys.argv[0])
    command = " ".join(["python", f"benchmarks/{script.name}", *sys.argv[1:]])
    text = f"{note}\n\n`{command}`, {date.today()}\n\n{table(head, rows)}\n\n{machine()}\n"
    TABLES.mkdir(exist_ok=True)
    path = TABLES / f"{name or script.stem}.md"
    path.write_text(text, encoding="utf-8")
    print(text)
    return path


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """In Markdown."""
    lines = [" | ".join(map(str, row)) for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(f"| {line} |" for line in lines)
