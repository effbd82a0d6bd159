"""Runs of a studio, each in a folder below `runs/` with results and origin, and their
comparison."""

import contextlib
import hashlib
import json
import re
import shutil
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field

from deltaid.errors import DeltaidError
from deltaid.files import YAML_ENDINGS, refusing, write_bytes
from deltaid.model.model import load
from deltaid.robot.load import catalogue, parse, yaml_text
from deltaid.robot.part import Part
from deltaid.studio.folder import RUNS, UNUSABLE, Folder
from deltaid.studio.steps import Kind, Step
from deltaid.view.numbers import number, percent

RECORD, OUTPUT, MESSAGES = "run.yaml", "output.json", "messages.txt"
_NAME = re.compile(r"(\d{4,})-(\w+)")


class Input(Part):
    """An input file of a run."""

    file: str
    sha256: str


class FinishedRun(Part):
    """A finished run and its origin: `run.yaml` in its folder.

    Attributes:
        folder: its name in the studio's folder, such as `runs/0003-fit`; not in the file.
    """

    folder: str = Field(default="", exclude=True)
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

    @property
    def name(self) -> str:
        """Name of its folder, such as `0003-fit`."""
        return self.folder.rpartition("/")[2]

    @property
    def succeeded(self) -> bool:
        """Whether it succeeded; checks succeed whatever they find."""
        return self.exit == 0 or (self.kind == "check" and self.exit in (3, 4))

    def file(self, name: str) -> str:
        """Name of one of its files in the studio's folder."""
        return f"{self.folder}/{name}"


def new_run(folder: Folder, kind: str) -> str:
    """Make the numbered folder of a new run; returns its name in the studio's folder.

    Raises:
        DeltaidError: it cannot be made.
    """
    with refusing(RUNS, *UNUSABLE):
        (folder.root / RUNS).mkdir(exist_ok=True)
        while True:
            name = next_run(folder, kind)
            # Another server may use the same folder.
            with contextlib.suppress(FileExistsError):
                (folder.root / name).mkdir()
                return name


def next_run(folder: Folder, kind: str) -> str:
    """Name of the next run's folder, without making it."""
    names = (_NAME.fullmatch(path.name) for path in (folder.root / RUNS).glob("*"))
    last = max((int(name[1]) for name in names if name), default=0)
    return f"{RUNS}/{last + 1:04d}-{kind}"


def keep_inputs(folder: Folder, run: str, step: Step) -> tuple[Input, ...]:
    """Checksums of a step's input files, and copies of small ones, which may change later.

    Raises:
        DeltaidError: one cannot be read, or copied.
    """
    inputs: list[Input] = []
    for name in step.reads:
        if name in catalogue() or not folder.has(name):
            continue
        path, kept = folder.path(name), folder.root / run / "inputs" / name
        with refusing(name, *UNUSABLE):
            if name.endswith(YAML_ENDINGS) and "/" not in name:
                kept.parent.mkdir(exist_ok=True)
                shutil.copyfile(path, kept)
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        inputs.append(Input(file=name, sha256=digest))
    return tuple(inputs)


def write_record(folder: Folder, run: FinishedRun, out: str, messages: str) -> None:
    """Write the record of a finished run as its last file, so that every recorded run is
    complete."""
    text = yaml_text(run.model_dump(mode="json"))
    for name, content in ((OUTPUT, out), (MESSAGES, messages), (RECORD, text)):
        if content:
            write_bytes(folder.root / run.file(name), content.encode())


def runs(folder: Folder) -> list[FinishedRun]:
    """All finished runs, the latest first."""
    finished = [
        _record(path, path.stat().st_mtime_ns)
        for path in sorted((folder.root / RUNS).glob(f"*/{RECORD}"), reverse=True)
        if path.is_file() and _NAME.fullmatch(path.parent.name)
    ]
    return [run for run in finished if run is not None]


@lru_cache(512)
def _record(path: Path, changed: int) -> FinishedRun | None:
    """A run, cached until its file changes; None if it is of another version or unreadable."""
    try:
        return parse(path.read_text(encoding="utf-8"), FinishedRun, where=str(path)).changed(
            folder=f"{RUNS}/{path.parent.name}"
        )
    except (DeltaidError, OSError):
        return None


def output(folder: Folder, run: FinishedRun) -> dict[str, Any]:
    """JSON output of a run; empty if there is none."""
    return json.loads(text_of(folder, run, OUTPUT) or "{}")


def text_of(folder: Folder, run: FinishedRun, name: str) -> str:
    """Content of one of a run's files; empty if the file does not exist."""
    path = folder.root / run.folder / name
    return path.read_text(encoding="utf-8") if path.is_file() else ""


_KINDS = {"good": "good", "poor": "bad"}


def describe_fit(folder: Folder, run: FinishedRun) -> list[tuple[str, str]]:
    """Sentences about a fit, each with its kind of note: '', 'good', 'doubt' or 'bad'."""
    summary = output(folder, run).get("summary")
    if not isinstance(summary, dict):
        return []
    return [
        (str(summary["sentence"]), _KINDS.get(str(summary["grade"]), "doubt")),
        ("\n".join(summary["lines"]), ""),
    ]


def comparison(folder: Folder, pair: Sequence[FinishedRun]) -> list[tuple[str, ...]]:
    """Rows of a table of runs: errors, noise, rank, settings, and the most different parameters."""
    outputs = [output(folder, run) for run in pair]
    rows: list[tuple[str, ...]] = [
        ("verdict", *(str(result.get("summary", {}).get("sentence", "–")) for result in outputs)),
        ("robot", *(str(result.get("robot", "")) for result in outputs)),
        (
            "recordings",
            *(
                ", ".join(r.file for r in run.inputs if not r.file.endswith(YAML_ENDINGS))
                for run in pair
            ),
        ),
        ("error on them", *(_share(result.get("nrmse")) for result in outputs)),
        (
            "error on an unseen motion",
            *(_share((result.get("verify") or {}).get("nrmse")) for result in outputs),
        ),
        ("torque noise", *(percent(result["noise_level"]) for result in outputs)),
        ("base parameters", *(str(result["base_parameters"]) for result in outputs)),
        ("corrections", *(str(len(result["corrections"])) for result in outputs)),
        ("γ", *(number(result["gamma"], 3) for result in outputs)),
    ]
    return rows + _parameters(folder, pair)


def _parameters(folder: Folder, pair: Sequence[FinishedRun]) -> list[tuple[str, ...]]:
    try:
        models = [load(folder.root / run.file("model.yaml")).identified for run in pair]
    except DeltaidError:
        return []
    known = [{p.name: p for p in model.parameters} for model in models if model]
    if len(known) != 2 or len(pair) != 2:
        return []
    left, right = known
    shared = [name for name in left if name in right and left[name].value != right[name].value]

    def apart(name: str) -> float:
        scale = left[name].std + right[name].std
        return -abs(left[name].value - right[name].value) / scale if scale else 0.0

    return [
        (
            f"{name} [{left[name].unit}]",
            *(f"{side[name].value:.4g} ({side[name].low:.3g} … {side[name].high:.3g})"
              for side in (left, right)),
        )
        for name in sorted(shared, key=apart)[:12]
    ]  # fmt: skip


def _share(values: Sequence[float] | None) -> str:
    return percent(max(values)) if values else "–"
