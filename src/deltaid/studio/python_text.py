"""The Python that does what a step of the studio does, as text to copy into a script."""

from collections.abc import Mapping, Sequence
from typing import Any

from deltaid.studio.plan import Used


def show_text(robot: str, report: str) -> str:
    """A page of the robot at rest."""
    return f"""\
from pathlib import Path

import deltaid
from deltaid.dynamics.at_rest import AtRest
from deltaid.view.page import write_page
from deltaid.view.robot_page import robot_page
from deltaid.view.reach import reach, survey

model = deltaid.load({robot!r})
at_rest = AtRest(model.dynamics, model.p)
page = robot_page(at_rest, reach(at_rest), survey(at_rest), "Robot at rest")
write_page(page, Path({report!r}))
"""


def check_text(robot: str, used: Sequence[Used], settings: Mapping[str, Any]) -> str:
    """All verdicts."""
    logs = f", {_files(used)}" if used else ""
    return f"""\
import deltaid

verdicts = deltaid.check({robot!r}{logs}{_columns(used)}{_settings(settings)})
for verdict in verdicts:
    print(verdict.grade, verdict.key, verdict.sentence)
"""


def fit_text(
    robot: str,
    used: Sequence[Used],
    verify: Used | None,
    settings: Mapping[str, Any],
    *,
    force: bool,
    model: str,
) -> str:
    """An identification, saved."""
    forced = ",\n    force=True" if force else ""
    asked = _settings(settings, "\n    ")
    columns = _columns(used, "\n    ")
    text = f"""\
import deltaid

result = deltaid.identify(
    {robot!r},
    {_files(used)}{columns}{asked}{forced},
)
result.model.save({model!r})
"""
    if verify is not None:
        text += f"""
error, log = deltaid.validate(result.model, {verify.file!r}{_one_mapping(verify.mapping)})
print("normalised torque error of each drive:", error.nrmse)
"""
    return text


def validate_text(model: str, used: Used, *, keep_all: bool) -> str:
    """A model's torque errors on a recording."""
    kept = ", keep_all=True" if keep_all else ""
    return f"""\
import deltaid

model = deltaid.load({model!r})
error, log = deltaid.validate(model, {used.file!r}{_one_mapping(used.mapping)}{kept})
print("normalised torque error of each drive:", error.nrmse)
"""


def excite_text(robot: str, motion: str, *, duration: float, starts: int, seed: int) -> str:
    """A motion, optimised and written."""
    return f"""\
from pathlib import Path

import deltaid
from deltaid.motion.excitation.run import write_run

settings = deltaid.ExcitationSettings(duration={duration!r}, starts={starts}, seed={seed})
exciter = deltaid.Exciter(deltaid.load({robot!r}), settings)
result = exciter.optimise()
write_run(exciter.dynamics.kinematics, result.run, settings.rate, Path({motion!r}))
"""


def simulate_text(
    model: str, motion: str, mapping: str | None, controller: str, output: str
) -> str:
    """A controller on the model itself."""
    return f"""\
from pathlib import Path

import deltaid
import deltaid.cli.simulate as command
from deltaid.control.comparison import gains
from deltaid.control.control_model import ControlModel
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import open_trajectory

model = deltaid.load({model!r})
known = ControlModel(model.robot, model.p)
kinematics = model.dynamics.kinematics
path, _ = open_trajectory(Path({motion!r}), kinematics{_mapping_place(mapping)})
law = gains({controller!r}, known, path, 10.0)
result = track(model, law, known, path, Drives())
print("platform error rms [m]:", result.error.platform_rms)
command.as_table(result, command.sensed(model, result)).write_csv({output!r})
"""


def forces_text(
    model: str, motion: str, mapping: str | None, spacing: float | None, output: str
) -> str:
    """Forces along a motion."""
    columns = _mapping_place(mapping)
    apart = repr(spacing)
    return f"""\
from pathlib import Path

import deltaid
from deltaid.joint_forces.study import CsvFile, study, with_struts
from deltaid.identification.sources import model_filtered
from deltaid.recording.opening import open_log

model = with_struts(deltaid.load({model!r}), {apart}, None)
forces = deltaid.ConstraintForces(model.robot)
log = open_log(Path({motion!r}), forces.kinematics{columns}, need_torque=False)
with Path({output!r}).open("w", encoding="utf-8") as file:
    viewer = CsvFile(forces, file)
    result = study(model, forces, model_filtered(model, log), viewers=(viewer,))
for finding in result.findings:
    print(finding)
"""


def export_text(model: str, to: str, output: str) -> str:
    """A model in another form."""
    return f"""\
import deltaid

written = deltaid.export(deltaid.load({model!r}), {to!r}, {output!r})
print(written.paths)
"""


def _files(used: Sequence[Used]) -> str:
    return "[" + ", ".join(repr(one.file) for one in used) + "]"


def _columns(used: Sequence[Used], indent: str = " ") -> str:
    names = [one.mapping for one in used]
    if not any(names):
        return ""
    names = names[:1] if len(set(names)) == 1 else names
    given = ", ".join(f"deltaid.load_mapping({name!r})" if name else "None" for name in names)
    return f",{indent}columns=[{given}]"


def _one_mapping(name: str | None) -> str:
    return f", columns=deltaid.load_mapping({name!r})" if name else ""


def _mapping_place(name: str | None) -> str:
    return f", deltaid.load_mapping({name!r})" if name else ""


def _settings(settings: Mapping[str, Any], indent: str = " ") -> str:
    if not settings:
        return ""
    given = ", ".join(f"{key}={value!r}" for key, value in settings.items())
    return f",{indent}settings=deltaid.Settings({given})"
