"""Each step of the studio as what it literally is: a command line, and the Python for it."""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from deltaid.model.record import Settings
from deltaid.studio.plan import Plan, Used
from deltaid.studio.python_text import (
    check_text,
    excite_text,
    export_text,
    fit_text,
    forces_text,
    show_text,
    simulate_text,
    validate_text,
)

Kind = Literal["new", "show", "check", "fit", "validate", "excite", "simulate", "forces", "export"]


@dataclass(frozen=True)
class Step:
    """One command, run in the studio's folder.

    Attributes:
        kind: what it is.
        arguments: behind `deltaid`, with names relative to the folder.
        python: a script that does the same there.
        reads: files of the folder that go into it.
        writes: files that it makes.
    """

    kind: Kind
    arguments: tuple[str, ...]
    python: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """The command line, to be copied."""
        words = ["deltaid", *self.arguments]
        return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def show_step(robot: str, report: str) -> Step:
    """The robot to look at, with what it reaches and its limits."""
    arguments = ("show", robot, "--report", report)
    return Step("show", arguments, show_text(robot, report), (robot,), (report,))


def check_step(plan: Plan, folder: str) -> Step:
    """All checks of the robot and of the recordings that are fitted and tested on."""
    robot, used, report = _robot(plan), plan.used, f"{folder}/check.html"
    settings = plan.settings
    arguments = [
        "check", robot, *(one.file for one in used), *_columns(used),
        *_number("--cutoff", settings.cutoff),
        *(["--keep-all"] if settings.keep_all else ()),
        "--report", report,
    ]  # fmt: skip
    asked = Settings(cutoff=settings.cutoff, keep_all=settings.keep_all)
    python = check_text(robot, used, _given(asked))
    return Step("check", tuple(arguments), python, _reads(plan, used), (report,))


def fit_step(plan: Plan, folder: str) -> Step:
    """A model from the recordings, tested on the one that verifies."""
    robot, used, verify = _robot(plan), plan.fitted, plan.verified
    model, report = f"{folder}/model.yaml", f"{folder}/report.html"
    asked = _given(plan.settings)
    options = [word for key, value in asked.items() for word in _option(key, value)]
    everything = plan.used
    arguments = [
        "identify", robot, *(one.file for one in used), *_columns(everything),
        *(["--verify", verify.file] if verify else ()), *options,
        *(["--force"] if plan.force else ()),
        "--output", model, "--report", report,
    ]  # fmt: skip
    python = fit_text(robot, used, verify, asked, force=plan.force, model=model)
    return Step("fit", tuple(arguments), python, _reads(plan, everything), (model, report))


def validate_step(model: str, used: Used, folder: str, *, keep_all: bool = False) -> Step:
    """A model beside a recording."""
    report = f"{folder}/report.html"
    columns = ("--columns", used.mapping) if used.mapping else ()
    kept = ("--keep-all",) if keep_all else ()
    arguments = ("validate", model, used.file, *columns, *kept, "--report", report)
    python = validate_text(model, used, keep_all=keep_all)
    reads = (model, used.file, *((used.mapping,) if used.mapping else ()))
    return Step("validate", arguments, python, reads, (report,))


def excite_step(
    robot: str, motion: str, folder: str, *, duration: float = 10.0, starts: int = 4, seed: int = 0
) -> Step:
    """A motion that makes parameters visible."""
    report = f"{folder}/report.html"
    numbers = ("--duration", f"{duration:g}", "--starts", str(starts), "--seed", str(seed))
    arguments = ("excite", robot, *numbers, "--output", motion, "--report", report)
    python = excite_text(robot, motion, duration=duration, starts=starts, seed=seed)
    return Step("excite", arguments, python, (robot,), (motion, report))


def simulate_step(
    model: str, motion: str, mapping: str | None, folder: str, controller: str = "computed-torque"
) -> Step:
    """A controller that knows a model, along a motion."""
    report, output = f"{folder}/report.html", f"{folder}/simulated.csv"
    columns = ("--columns", mapping) if mapping else ()
    arguments = (
        "simulate", model, motion, "--controller", controller, *columns,
        "--output", output, "--report", report,
    )  # fmt: skip
    reads = (model, motion, *((mapping,) if mapping else ()))
    python = simulate_text(model, motion, mapping, controller, output)
    return Step("simulate", arguments, python, reads, (output, report))


def forces_step(
    model: str, motion: str, mapping: str | None, folder: str, spacing: float | None = None
) -> Step:
    """What struts, joints and bearings carry along a motion."""
    report, output = f"{folder}/report.html", f"{folder}/forces.csv"
    columns = ("--columns", mapping) if mapping else ()
    between = _number("--strut-spacing", spacing)
    arguments = (
        "forces", model, motion, *columns, *between, "--output", output, "--report", report,
    )  # fmt: skip
    reads = (model, motion, *((mapping,) if mapping else ()))
    python = forces_text(model, motion, mapping, spacing, output)
    return Step("forces", arguments, python, reads, (output, report))


def export_step(model: str, to: str, output: str) -> Step:
    """A model in a form that another program runs; `output` is a file or a folder with a slash."""
    arguments = ("export", model, "--to", to, "--output", output)
    return Step("export", arguments, export_text(model, to, output), (model,), (output,))


def _robot(plan: Plan) -> str:
    assert plan.robot is not None
    return plan.robot


def _columns(used: Sequence[Used]) -> list[str]:
    """Mappings as the command takes them: none, one for all, or one each."""
    names = [one.mapping for one in used]
    if not any(names):
        return []
    if len(set(names)) == 1:
        return ["--columns", str(names[0])]
    return [word for name in names for word in ("--columns", str(name))]


def _reads(plan: Plan, used: Sequence[Used]) -> tuple[str, ...]:
    names = (_robot(plan), *(name for one in used for name in (one.file, one.mapping) if name))
    return tuple(dict.fromkeys(names))


def _given(settings: Settings) -> dict[str, Any]:
    """Settings that are not the default ones, as a user writes them."""
    plain, default = settings.model_dump(), Settings().model_dump()
    return {key: value for key, value in plain.items() if value != default[key]}


def _option(key: str, value: Any) -> list[str]:
    name = "--" + key.replace("_", "-")
    if key == "events":
        return ["--events" if value else "--no-events"]
    if isinstance(value, bool):
        return [name] if value else []
    if key == "lag" and isinstance(value, tuple):
        return [f"{name}={','.join(f'{1e3 * x:.10g}' for x in value)}"]
    return [name, f"{value:.10g}" if isinstance(value, float) else str(value)]


def _number(name: str, value: float | None) -> list[str]:
    return [] if value is None else [name, f"{value:.10g}"]
