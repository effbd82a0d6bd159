"""Steps of the studio as command lines and equivalent Python."""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from deltaid.model.record import Settings
from deltaid.studio.plan import Plan, Used
from deltaid.view.page import WIDEST

Kind = Literal[
    "new", "show", "check", "fit", "validate", "excite", "torque", "simulate", "forces", "export"
]


@dataclass(frozen=True)
class Step:
    """One command, run in the studio's folder.

    Attributes:
        kind: of the command.
        arguments: after `deltaid`, with names relative to the folder.
        python: an equivalent script.
        reads: input files in the folder.
    """

    kind: Kind
    arguments: tuple[str, ...]
    python: str
    reads: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """The command line, for copying."""
        words = ["deltaid", *self.arguments]
        return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def show_step(robot: str, report: str) -> Step:
    """Show the robot with its reach and limits."""
    return _step(
        "show", (robot,), {"report": report}, f"deltaid.load({robot!r}).robot.report({report!r})\n"
    )


def check_step(plan: Plan, folder: str) -> Step:
    """Check the robot and the recordings of fit and verification."""
    robot, files = plan.robot or "", [recording.file for recording in plan.used]
    seen = Settings(cutoff=plan.settings.cutoff, keep_all=plan.settings.keep_all)
    asked = {"columns": _mappings(plan.used)} | _changed_settings(seen)
    logs = (repr(files),) if files else ()
    python = f"""\
verdicts = {_call("deltaid.check", repr(robot), *logs, **asked)}
for verdict in verdicts:
    print(verdict.grade, verdict.key, verdict.sentence)
"""
    asked["report"] = f"{folder}/check.html"
    return _step("check", (robot, *files), asked, python, _reads(plan))


def fit_step(plan: Plan, folder: str) -> Step:
    """Fit a model to recordings, and test it on the one that verifies."""
    robot, used, verify = plan.robot or "", plan.fitted, plan.verified
    model, files = f"{folder}/model.yaml", [recording.file for recording in used]
    settings = _changed_settings(plan.settings)
    shared = {"columns": _mappings(plan.used), "verify": verify.file if verify else None}
    asked = shared | settings | {"force": plan.force}
    named = settings | {"columns": _mappings(used), "force": plan.force or None}
    python = f"""\
result = {_call("deltaid.identify", repr(robot), repr(files), **named)}
result.model.save({model!r})
"""
    if verify is not None:
        python += "\n" + _test("result.model", verify)
    asked |= _output_files(folder, model)
    return _step("fit", (robot, *files), asked, python, _reads(plan))


def validate_step(model: str, used: Used, folder: str, *, keep_all: bool = False) -> Step:
    """Compare a model with a recording."""
    asked = {"columns": used.mapping, "keep_all": keep_all, "report": f"{folder}/report.html"}
    return _step(
        "validate", (model, used.file), asked, _test(repr(model), used, keep_all=keep_all or None)
    )


def excite_step(
    robot: str, motion: str, folder: str, *, duration: float = 10.0, starts: int = 4
) -> Step:
    """Plan a motion to record next."""
    asked = {"duration": duration, "starts": starts, "seed": 0}
    python = f"""\
result = {_call("deltaid.excite", repr(robot), **asked)}
result.save({motion!r})
"""
    return _step("excite", (robot,), asked | _output_files(folder, motion), python)


AlongKind = Literal["torque", "simulate", "forces"]
# Steps along a motion: name of the output file, name of the option, and Python for the result.
_ALONG: dict[AlongKind, tuple[str, str, str]] = {
    "torque": (
        "feed-forward.csv",
        "periodic",
        """\
print("rows without torques at both ends:", result.without)
result.save({output!r})
""",
    ),
    "simulate": (
        "simulated.csv",
        "controller",
        """\
print("platform error rms [m]:", result.error.platform_rms)
result.table().write_csv({output!r})
""",
    ),
    "forces": (
        "forces.csv",
        "strut_spacing",
        """\
for finding in result.findings:
    print(finding)
result.save({output!r})
""",
    ),
}


def along_step(
    kind: AlongKind,
    model: str,
    motion: str,
    mapping: str | None,
    folder: str,
    option: str | float | bool | None = None,
) -> Step:
    """Apply a model along a motion: predicted torques, a controller that uses it, or forces in
    struts, joints and bearings.

    Args:
        option: whether the motion is periodic; the controller; the distance of a limb's struts [m].
    """
    file, name, shown = _ALONG[kind]
    output, asked = f"{folder}/{file}", {"columns": mapping, name: option or None}
    call = _call(f"deltaid.{kind}", repr(model), repr(motion), **asked)
    python = f"result = {call}\n{shown.format(output=output)}"
    asked |= {"output": output} if kind == "torque" else _output_files(folder, output)
    return _step(kind, (model, motion), asked, python)


def export_step(
    model: str,
    to: str,
    output: str,
    *,
    plain_friction: bool = False,
    without_friction: bool = False,
    functions: Sequence[str] = (),
    single: bool = False,
    fmi: str = "2",
) -> Step:
    """Export a model; `output` is a file, or a folder if it ends in a slash."""
    asked = {
        "plain_friction": plain_friction or None,
        "without_friction": without_friction or None,
        "single": single or None,
        "fmi": None if fmi == "2" else fmi,
    }
    named = asked | {"functions": list(functions) or None}
    python = f"""\
written = {_call("deltaid.export", repr(model), repr(to), repr(output), **named)}
print(written.paths, *written.warnings)
"""
    asked = {"to": to, "with": ",".join(functions) or None, **asked, "output": output}
    return _step("export", (model,), asked, python)


def insisting(step: Step) -> Step:
    """The step with acceptance of a poor model; its Python needs no change."""
    return replace(step, arguments=(*step.arguments, "--force"))


def _output_files(folder: str, output: str) -> dict[str, str]:
    return {"output": output, "report": f"{folder}/report.html"}


def _step(
    kind: Kind,
    given: tuple[str, ...],
    asked: dict[str, Any],
    python: str,
    reads: tuple[str, ...] = (),
) -> Step:
    """A step from the parts of its command.

    Args:
        kind: of the command.
        given: positional arguments, files and robots.
        asked: values of options by their Python names, with output files last.
        python: the equivalent script, without the import.
        reads: input files, unless they are `given` and one mapping.
    """
    command = "identify" if kind == "fit" else kind
    arguments = (command, *given, *(word for o in asked.items() for word in _option(*o)))
    files = reads or tuple(name for name in (*given, asked.get("columns")) if name)
    return Step(kind, arguments, f"import deltaid\n\n{python}", files)


def _test(model: str, used: Used, **asked: object) -> str:
    """Python for the errors of a model, which is given as Python, on a recording."""
    call = _call("deltaid.validate", model, repr(used.file), columns=used.mapping, **asked)
    return f"""\
error, log = {call}
print("normalised torque error of each drive:", error.nrmse)
"""


def _call(function: str, *given: str, **named: object) -> str:
    """A call as Python, without arguments that are None, split into several lines if it is long.

    Args:
        given: positional arguments, as Python.
        named: values of keyword arguments.
    """
    words = [*given, *(f"{name}={value!r}" for name, value in named.items() if value is not None)]
    line = f"{function}({', '.join(words)})"
    return line if len(line) <= WIDEST else f"{function}(\n    {', '.join(words)},\n)"


def _mappings(used: Sequence[Used]) -> str | list[str | None] | None:
    names = [recording.mapping for recording in used]
    return names if len(set(names)) > 1 else names[0] if names else None


def _reads(plan: Plan) -> tuple[str, ...]:
    names = [name for recording in plan.used for name in (recording.file, recording.mapping)]
    return tuple(dict.fromkeys(name for name in (plan.robot, *names) if name))


def _changed_settings(settings: Settings) -> dict[str, Any]:
    """Settings that differ from the defaults, as plain values."""
    default = Settings().model_dump()
    return {k: value for k, value in settings.model_dump().items() if value != default[k]}


def _option(key: str, value: Any) -> list[str]:
    """An option of the command line; empty for None and False."""
    name = "--" + key.replace("_", "-")
    match value:
        case bool() if key == "events":
            return ["--events" if value else "--no-events"]
        case None | False:
            return []
        case True:
            return [name]
        case list():
            return [word for each in value for word in (name, str(each))]
        case tuple():  # its text may begin with a minus
            return [f"{name}={typed(value)}"]
        case _:
            return [name, typed(value)]


def typed(value: Any) -> str:
    """A value as a user types it: lags in ms, an empty text for None."""
    if isinstance(value, tuple):
        return ",".join(f"{1e3 * lag:.10g}" for lag in value)
    return "" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
