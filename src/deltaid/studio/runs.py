"""Runs of a studio: one folder each below `runs/`, with what it made and where it comes from."""

import contextlib
import json
import re
import shutil
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from deltaid.errors import DeltaidError
from deltaid.files import written_whole
from deltaid.robot.load import catalogue, parse, yaml_text
from deltaid.robot.part import Part
from deltaid.studio.folder import RUNS, Folder, refusing, sha256
from deltaid.studio.steps import Kind, Step

RECORD, OUTPUT, MESSAGES = "run.yaml", "output.json", "messages.txt"
_NAME = re.compile(r"(\d{4,})-(\w+)")
# Inputs of this many bytes at most are kept beside what was made of them.
_KEPT = 1 << 18


class Input(Part):
    """A file that went into a run."""

    file: str
    sha256: str


class Record(Part):
    """Provenance of a run: `run.yaml` in its folder."""

    kind: Kind
    command: str
    python: str
    version: str
    began: str
    seconds: float
    exit: int
    inputs: tuple[Input, ...] = ()
    of: str = ""
    robot: str = ""


@dataclass(frozen=True)
class FinishedRun:
    """A finished run.

    Attributes:
        folder: its name below the studio's folder, such as `runs/0003-fit`.
        record: where it comes from.
    """

    folder: str
    record: Record

    @property
    def name(self) -> str:
        """Name of its folder, such as `0003-fit`."""
        return self.folder.rpartition("/")[2]

    @property
    def succeeded(self) -> bool:
        """Whether it did what it was asked for."""
        return did_its_work(self.record.kind, self.record.exit)

    def file(self, name: str) -> str:
        """One of its files by a name inside the studio's folder."""
        return f"{self.folder}/{name}"


def did_its_work(kind: Kind, code: int) -> bool:
    """Whether a command that ended with a code did it; checks end with what they found."""
    return code == 0 or (kind == "check" and code in (3, 4))


def new_run(folder: Folder, kind: str) -> str:
    """Make the folder of a run that begins, numbered on; its name inside the studio's folder.

    Raises:
        DeltaidError: it cannot be made.
    """
    with refusing(RUNS):
        (folder.root / RUNS).mkdir(exist_ok=True)
        while True:
            name = next_run(folder, kind)
            # Another server may work in the same folder.
            with contextlib.suppress(FileExistsError):
                (folder.root / name).mkdir()
                return name


def next_run(folder: Folder, kind: str) -> str:
    """What the next run's folder will be called; nothing is made."""
    names = (_NAME.fullmatch(path.name) for path in (folder.root / RUNS).glob("*"))
    last = max((int(name[1]) for name in names if name), default=0)
    return f"{RUNS}/{last + 1:04d}-{kind}"


def inputs_of(folder: Folder, step: Step) -> tuple[Input, ...]:
    """Checksums of a step's files as they are now.

    Raises:
        DeltaidError: one cannot be read.
    """
    names = [name for name in step.reads if name not in catalogue()]
    with refusing(", ".join(names)):
        return tuple(
            Input(file=name, sha256=sha256(folder.path(name))) for name in names if folder.has(name)
        )


def keep_inputs(folder: Folder, run: str, step: Step) -> None:
    """Copies of the small files that a step reads: descriptions and mappings change later.

    Raises:
        DeltaidError: they cannot be made.
    """
    for name in step.reads:
        if folder.has(name) and name.endswith((".yaml", ".yml")) and "/" not in name:
            path, kept = folder.path(name), folder.root / run / "inputs" / name
            with refusing(name):
                if path.stat().st_size <= _KEPT:
                    kept.parent.mkdir(exist_ok=True)
                    shutil.copyfile(path, kept)


def write_record(folder: Folder, run: str, record: Record, out: str, messages: str) -> FinishedRun:
    """Write down how a run ended: its record last, so that what has one is complete."""
    text = yaml_text(record.model_dump(mode="json"))
    for name, content in ((OUTPUT, out), (MESSAGES, messages), (RECORD, text)):
        if content:
            with written_whole(folder.root / run / name) as file:
                file.write(content)
    return FinishedRun(run, record)


def runs(folder: Folder) -> list[FinishedRun]:
    """All runs that came to their end, the last one first."""
    found: list[FinishedRun] = []
    for path in (folder.root / RUNS).glob(f"*/{RECORD}"):
        record = _record(path, path.stat().st_mtime_ns) if path.is_file() else None
        if record is not None and _NAME.fullmatch(path.parent.name):
            found.append(FinishedRun(f"{RUNS}/{path.parent.name}", record))
    return sorted(found, key=lambda run: run.folder, reverse=True)


@lru_cache(512)
def _record(path: Path, changed: int) -> Record | None:
    """A run's record, read once as long as it is not changed; None if it is of another version."""
    try:
        return parse(path.read_text(encoding="utf-8"), Record, where=str(path))
    except (DeltaidError, OSError):
        return None


def output(folder: Folder, run: FinishedRun) -> dict[str, Any]:
    """What a run printed as JSON; empty if nothing."""
    path = folder.root / run.folder / OUTPUT
    if not path.is_file():
        return {}
    return json.loads(path.read_text(encoding="utf-8"))


def messages(folder: Folder, run: FinishedRun) -> str:
    """What a run said on standard error."""
    path = folder.root / run.folder / MESSAGES
    return path.read_text(encoding="utf-8") if path.is_file() else ""
