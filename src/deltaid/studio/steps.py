"""Each step of the studio as what it literally is: a command line, and the Python for it."""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from deltaid.model.record import Settings
from deltaid.studio.plan import Plan, Used

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
    python = f"""\
import deltaid

deltaid.load({robot!r}).robot.report({report!r})
"""
    return Step("show", ("show", robot, "--report", report), python, (robot,), (report,))


def check_step(plan: Plan, folder: str) -> Step:
    """All checks of the robot and of the recordings that are fitted and tested on."""
    robot, used, report = _robot(plan), plan.used, f"{folder}/check.html"
    asked = _given(Settings(cutoff=plan.settings.cutoff, keep_all=plan.settings.keep_all))
    files = [recording.file for recording in used]
    arguments = ("check", robot, *files, *_columns(used), *_options(asked), "--report", report)
    logs = (repr(files),) if files else ()
    python = f"""\
import deltaid

verdicts = {_call("deltaid.check", repr(robot), *logs, columns=_mappings(used), **asked)}
for verdict in verdicts:
    print(verdict.grade, verdict.key, verdict.sentence)
"""
    return Step("check", arguments, python, _reads(plan, used), (report,))


def fit_step(plan: Plan, folder: str) -> Step:
    """A model from the recordings, tested on the one that verifies."""
    robot, used, verify = _robot(plan), plan.fitted, plan.verified
    model, report = f"{folder}/model.yaml", f"{folder}/report.html"
    asked, files = _given(plan.settings), [recording.file for recording in used]
    options = {"verify": verify.file if verify else None, **asked, "force": plan.force}
    arguments = (
        "identify", robot, *files, *_columns(plan.used), *_options(options),
        "--output", model, "--report", report,
    )  # fmt: skip
    asked |= {"columns": _mappings(used), "force": plan.force or None}
    python = f"""\
import deltaid

result = {_call("deltaid.identify", repr(robot), repr(files), **asked)}
result.model.save({model!r})
"""
    if verify is not None:
        python += "\n" + _test("result.model", verify)
    return Step("fit", arguments, python, _reads(plan, plan.used), (model, report))


def validate_step(model: str, used: Used, folder: str, *, keep_all: bool = False) -> Step:
    """A model beside a recording."""
    report, kept = f"{folder}/report.html", {"keep_all": True} if keep_all else {}
    columns = _options({"columns": used.mapping})
    arguments = ("validate", model, used.file, *columns, *_options(kept), "--report", report)
    python = "import deltaid\n\n" + _test(repr(model), used, **kept)
    return Step("validate", arguments, python, _present(model, used.file, used.mapping), (report,))


def excite_step(
    robot: str, motion: str, folder: str, *, duration: float = 10.0, starts: int = 4, seed: int = 0
) -> Step:
    """A motion that makes parameters visible."""
    report, asked = f"{folder}/report.html", {"duration": duration, "starts": starts, "seed": seed}
    arguments = ("excite", robot, *_options(asked), "--output", motion, "--report", report)
    python = f"""\
import deltaid

result = {_call("deltaid.excite", repr(robot), **asked)}
result.save({motion!r})
"""
    return Step("excite", arguments, python, (robot,), (motion, report))


def simulate_step(
    model: str, motion: str, mapping: str | None, folder: str, controller: str = "computed-torque"
) -> Step:
    """A controller that knows a model, along a motion."""
    report, output = f"{folder}/report.html", f"{folder}/simulated.csv"
    asked = {"controller": controller, "columns": mapping}
    arguments = (
        "simulate", model, motion, *_options(asked), "--output", output, "--report", report,
    )  # fmt: skip
    python = f"""\
import deltaid

result = {_call("deltaid.simulate", repr(model), repr(motion), **asked)}
print("platform error rms [m]:", result.error.platform_rms)
result.table().write_csv({output!r})
"""
    reads = _present(model, motion, mapping)
    return Step("simulate", arguments, python, reads, (output, report))


def forces_step(
    model: str, motion: str, mapping: str | None, folder: str, spacing: float | None = None
) -> Step:
    """What struts, joints and bearings carry along a motion."""
    report, output = f"{folder}/report.html", f"{folder}/forces.csv"
    asked = {"columns": mapping, "strut_spacing": spacing}
    arguments = ("forces", model, motion, *_options(asked), "--output", output, "--report", report)
    python = f"""\
import deltaid

result = {_call("deltaid.forces", repr(model), repr(motion), **asked)}
for finding in result.findings:
    print(finding)
result.save({output!r})
"""
    return Step("forces", arguments, python, _present(model, motion, mapping), (output, report))


def export_step(model: str, to: str, output: str) -> Step:
    """A model in a form that another program runs; `output` is a file or a folder with a slash."""
    arguments = ("export", model, "--to", to, "--output", output)
    python = f"""\
import deltaid

written = {_call("deltaid.export", repr(model), repr(to), repr(output))}
print(written.paths)
"""
    return Step("export", arguments, python, (model,), (output,))


def _test(model: str, used: Used, **asked: object) -> str:
    """Python for the errors of a model, which is given as Python too, on a recording."""
    call = _call("deltaid.validate", model, repr(used.file), columns=used.mapping, **asked)
    return f"""\
error, log = {call}
print("normalised torque error of each drive:", error.nrmse)
"""


# Letters of a line of Python, as formatters have it.
_LINE = 80


def _call(function: str, *given: str, **named: object) -> str:
    """A call as Python, with what is not None; over several lines where one is too long.

    Args:
        given: arguments by place, as Python.
        named: values of arguments by name.
    """
    words = [*given, *(f"{name}={value!r}" for name, value in named.items() if value is not None)]
    line = f"{function}({', '.join(words)})"
    return line if len(line) <= _LINE else f"{function}(\n    {', '.join(words)},\n)"


def _robot(plan: Plan) -> str:
    assert plan.robot is not None
    return plan.robot


def _mappings(used: Sequence[Used]) -> str | list[str | None] | None:
    """Mappings as Python takes them: none, one for all, or one each."""
    names = [recording.mapping for recording in used]
    return names if len(set(names)) > 1 else names[0] if names else None


def _columns(used: Sequence[Used]) -> list[str]:
    """Mappings as the command takes them: none, one for all, or one each."""
    names = _mappings(used)
    each = names if isinstance(names, list) else [names] if names else []
    return [word for name in each for word in ("--columns", str(name))]


def _present(*names: str | None) -> tuple[str, ...]:
    return tuple(name for name in names if name)


def _reads(plan: Plan, used: Sequence[Used]) -> tuple[str, ...]:
    names = _present(
        _robot(plan), *(name for recording in used for name in (recording.file, recording.mapping))
    )
    return tuple(dict.fromkeys(names))


def _given(settings: Settings) -> dict[str, Any]:
    """Settings that are not the default ones, as a user writes them."""
    plain, default = settings.model_dump(), Settings().model_dump()
    return {key: value for key, value in plain.items() if value != default[key]}


def _options(asked: dict[str, Any]) -> list[str]:
    """Options of the command line; those that are None or False are left out."""
    return [word for key, value in asked.items() for word in _option(key, value)]


def _option(key: str, value: Any) -> list[str]:
    name = "--" + key.replace("_", "-")
    if key == "events":
        return ["--events" if value else "--no-events"]
    if value is None or isinstance(value, bool):
        return [name] if value else []
    if key == "lag" and isinstance(value, tuple):
        return [f"{name}={','.join(f'{1e3 * x:.10g}' for x in value)}"]
    return [name, f"{value:.10g}" if isinstance(value, float) else str(value)]
