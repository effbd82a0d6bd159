"""Export targets and their files, written whole or not at all."""

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Literal, get_args

from deltaid.control.plant import LOADS, point_mass
from deltaid.errors import DeltaidError, Doubt, positive, typed, unknown
from deltaid.exports import (
    c_code,
    data_files,
    fmu,
    handover,
    mjcf,
    model_functions,
    structured_text,
    tree,
    urdf,
)
from deltaid.exports.options import FmiVersion, TargetName
from deltaid.exports.plain_friction import plain_friction as nearest_plain
from deltaid.exports.text import DOUBLE, SINGLE, Export, Precision
from deltaid.files import require_writable, together, write_bytes
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model, ModelLike, load
from deltaid.online.settings import OnlineSettings
from deltaid.progress import Progress, Watch, watched


@dataclass(frozen=True)
class Written:
    """Files of an export, and warnings about approximations of its target."""

    paths: tuple[Path, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Choices:
    """Options of a target.

    Attributes:
        precision: of the numbers in code.
        functions: names of additional functions in code.
        online: settings of the function of that name.
        fmi: version of the FMI standard.
        progress: called with each slow stage.
    """

    precision: Precision = DOUBLE
    functions: tuple[str, ...] = ()
    online: OnlineSettings = field(default_factory=OnlineSettings)
    fmi: FmiVersion = "2"
    progress: Progress = lambda _: None


Kind = Literal["code", "unit", "model"]


@dataclass(frozen=True)
class ExportTarget:
    """One target format of a model.

    Attributes:
        suffixes: endings of its files' names, the one that a user gives first.
        build: makes its content from a model, the file's name without ending, and the options.
        kind: which options apply: precision and functions to code, the FMI version to a unit.
        addition: text after the robot's name in a file name that is not given.
        longest: largest number of letters of the robot's name there.
    """

    suffixes: tuple[str, ...]
    build: Callable[[Model, str, Choices], Export]
    kind: Kind = "model"
    addition: str = ""
    longest: int = 30


def _st(subject: Model, stem: str, choices: Choices) -> Export:
    program = structured_text.plc_program(
        subject, stem, choices.precision, choices.functions, choices.online
    )
    return Export({".st": program.text, ".plcopen.xml": program.xml})


def _unit(subject: Model, stem: str, choices: Choices, *, forward: bool) -> Export:
    return fmu.fmu(subject, stem, forward=forward, version=choices.fmi, progress=choices.progress)


def _single(suffix: str, content: Callable[[Model], str | bytes]) -> ExportTarget:
    """A target of one file without options."""
    return ExportTarget((suffix,), lambda subject, *_: Export({suffix: content(subject)}))


TARGETS: Mapping[TargetName, ExportTarget] = {
    "c": ExportTarget(
        (".c", ".h"),
        lambda subject, stem, x: c_code.c_code(subject, stem, x.precision, x.functions, x.online),
        "code",
    ),
    "st": ExportTarget((".st", ".plcopen.xml"), _st, "code", longest=20),
    "fmu": ExportTarget((".fmu",), partial(_unit, forward=True), "unit"),
    "fmu-inverse": ExportTarget((".fmu",), partial(_unit, forward=False), "unit", "_inverse"),
    "casadi": _single(".casadi", data_files.casadi_file),
    "mjcf": _single(".xml", mjcf.mjcf),
    "urdf": ExportTarget((".urdf", ".loops.json"), lambda subject, *_: urdf.urdf(subject)),
    "npz": _single(".npz", data_files.npz_file),
}


def _require(kind: Kind, name: TargetName, what: str, option: str) -> None:
    if TARGETS[name].kind != kind:
        others = [other for other, target in TARGETS.items() if target.kind == kind]
        raise DeltaidError(
            f"{what}, and {name} is none",
            where=option,
            cure=f"leave it out, or choose {' or '.join(others)}",
        )


def output_path(target: TargetName, robot: str, output: str | Path) -> Path:
    """The file to write, for a file or a folder: an existing one, or a name that ends in a slash.

    Raises:
        DeltaidError: the name is empty, or its ending is not that of the target.
    """
    if not str(output).strip():
        cure = "give a file, or a folder with a slash at its end; ./ is this one"
        raise DeltaidError("is an empty name", where="--output", cure=cure)
    form, folder, output = TARGETS[target], str(output).endswith(("/", os.sep)), Path(output)
    suffix = form.suffixes[0]
    if folder or os.path.isdir(output):  # a valid identifier begins with a letter
        name = re.sub(r"[^A-Za-z0-9]+", "_", robot).strip("_") or "robot"
        name = name if name[0].isalpha() else f"robot_{name}"
        return output / f"{name[: form.longest].rstrip('_')}{form.addition}{suffix}"
    if output.suffix.lower() != suffix:
        raise DeltaidError(
            f"must end in {suffix} for --to {target}, or be a folder",
            where=str(output),
            cure=f"a folder that is not there yet ends in a slash: {output}/",
        )
    return output


def export(
    model: ModelLike,
    to: TargetName,
    output: str | Path,
    inputs: tuple[Path, ...] = (),
    *,
    payload: str | float | None = None,
    without_friction: bool = False,
    plain_friction: bool = False,
    single: bool = False,
    functions: Sequence[str] = (),
    online: OnlineSettings | None = None,
    fmi: str | int = "2",
    progress: Watch = None,
) -> Written:
    """Write a model in the format of a target, all files or none.

    Args:
        model: a model or a robot, by value, name or file.
        to: the target, such as "c", "mjcf" or "fmu".
        output: a file; or a folder to hand over, with files named after the robot, a README, test
            vectors, and for code a program that runs them. The name of a new folder ends in a
            slash.
        inputs: files that must not be overwritten.
        payload: permanent load of the tool: a mass [kg], or the name of a load that the model was
            identified with.
        without_friction: exclude all friction.
        plain_friction: replace additional friction terms by the nearest viscous and Coulomb
            friction, as MJCF and URDF require; a warning states the error.
        single: write code in single precision (float, REAL).
        functions: additional functions of code: `constraint-forces`, `passive-joints`, `regressor`,
            `online`; a list, or words separated by commas.
        online: settings of the function of that name; 1000 cycles a second if None.
        fmi: version of the FMI standard.
        progress: a function that is called with each stage; True or False to show it or not.

    Raises:
        DeltaidError: the target or a function does not exist, the target cannot represent the
            model, or a file cannot be written.
    """
    if str(to) not in TARGETS:
        raise unknown(to, TARGETS, "target", "export")
    further, version = _names(functions), _fmi_version(fmi)
    typed("output", output, (str, os.PathLike), "a file or a folder")
    typed("inputs", inputs, (tuple, list), "a list of files")
    _require_options(to, further, version, online, single=single)
    subject, warnings = _prepared(load(model), payload, without_friction, plain_friction)
    form, precision = TARGETS[to], SINGLE if single else DOUBLE
    path = output_path(to, subject.robot.name, output)
    paths, companions = [path.with_suffix(suffix) for suffix in form.suffixes], dict[str, str]()
    if path != Path(output):
        names = [part.name for part in paths]
        companions = handover.handover(subject, to, path.stem, names, precision)
    paths += [path.parent / name for name in companions]
    for part in paths:
        require_writable(part, inputs)
    with watched(progress, "export") as say:
        choices = Choices(precision, further, online or OnlineSettings(), version, say)
        made = form.build(subject, path.stem, choices)
    with together():
        for part, content in zip(paths, (*made.parts.values(), *companions.values()), strict=True):
            write_bytes(part, content if isinstance(content, bytes) else content.encode())
    return Written(tuple(paths), (*warnings, *made.warnings, *_notes(subject, further)))


def _require_options(
    to: TargetName,
    further: Sequence[str],
    version: FmiVersion,
    online: OnlineSettings | None,
    *,
    single: bool,
) -> None:
    if single or further:
        what = "precision and further functions are of code"
        _require("code", to, what, "--single" if single else "--with")
    if version != "2":
        _require("unit", to, "FMI is of units", "--fmi")
    typed("online", online, (OnlineSettings, NoneType), "OnlineSettings")
    if online is not None and "online" not in further:
        what = "settings are given of the function online, which is not asked for"
        cure = "add functions=['online'], or leave them out"
        raise DeltaidError(what, where="online", cure=cure)


def _prepared(
    subject: Model, payload: str | float | None, without_friction: bool, plain: bool
) -> tuple[Model, tuple[str, ...]]:
    """The model with its payload and its friction as asked, and warnings."""
    if without_friction and plain:
        what = "no friction is left to approximate with --without-friction"
        raise DeltaidError(what, where="--plain-friction", cure="give one of the two")
    if payload is not None:
        subject = _holding(subject, payload)
    if without_friction:
        subject = subject.without_friction()
    subject, warnings = nearest_plain(subject) if plain else (subject, ())
    tree.require_physical(subject, "identify the model again; its result is always consistent")
    return subject, warnings


def _names(functions: Sequence[str]) -> tuple[str, ...]:
    """Names of additional functions, from a list or from words separated by commas."""
    names = functions.split(",") if isinstance(functions, str) else functions
    typed("functions", names, Sequence, "a list of names")
    for name in names:
        typed("functions", name, str, "a list of names")
    return tuple(name.strip() for name in names if name.strip())


def _fmi_version(fmi: str | int) -> FmiVersion:
    versions: Mapping[str, FmiVersion] = {version: version for version in get_args(FmiVersion)}
    if str(fmi) not in versions:
        raise unknown(fmi, versions, "version of FMI", "export")
    return versions[str(fmi)]


def _notes(subject: Model, further: Sequence[str]) -> Iterator[str]:
    """Drives whose commands differ from their torques, and limits of additional functions."""
    if subject.identified is not None and (commands := subject.identified.commands):
        yield Doubt(
            "torques are those at the joints, and not what this robot's drives are commanded",
            cause="the identification found gains of the drives",
            cure=f"for them command {commands}",
        )
    if "constraint-forces" in further and (note := ConstraintForces(subject.robot).note):
        yield note
    if "online" in further and subject.identified is None:
        yield model_functions.NO_CONTACT


def _holding(model: Model, payload: str | float) -> Model:
    """A model with a permanent load at its tool: a named one, or a point mass in kg.

    Raises:
        DeltaidError: the payload is neither a known name nor a plausible mass.
    """
    names = [held.name for held in model.identified.loads] if model.identified else []
    if isinstance(payload, str) and payload in names:
        return model.with_load(payload)
    try:
        mass = float(payload)
    except (TypeError, ValueError):
        what = f"'{str(payload)[:40]}' is no mass, and no load that the model was identified with"
        cure = f"give kilograms, as 1.5{', or one of ' if names else ''}{', '.join(names)}"
        raise DeltaidError(what, where="--payload", cure=cure) from None
    positive("--payload", mass, LOADS)
    return model.with_load(point_mass(mass))
