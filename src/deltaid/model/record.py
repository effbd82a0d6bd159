"""Identified model: parameters, intervals and their origin, saved as YAML and loaded back."""

import hashlib
import re
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.checksum import EMPTY, is_intact, sealed
from deltaid.dynamics.parameters import ParameterLayout, least_margin, parameter_layout
from deltaid.errors import DescriptionError
from deltaid.files import written_whole
from deltaid.model.corrections import Correction, FittedEffect, FittedSensor, Inseparable, Source
from deltaid.model.parameter_record import (
    BaseParameter,
    FrictionChoice,
    FrictionCurve,
    HeldLoad,
    Parameter,
    PosteriorRecord,
    place,
)
from deltaid.model.settings import Settings
from deltaid.progress import Watch
from deltaid.recording.columns import Readings
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.load import bound, parse, read_text
from deltaid.robot.part import NotNegative, Part
from deltaid.robot.yaml_edit import yaml_text
from deltaid.shown import Plotted, Reported, Shown, Tabled

if TYPE_CHECKING:
    from deltaid.dynamics.dynamics import Dynamics
    from deltaid.model.samples import Samples

# Version of the model file; files of all earlier versions load. 2: base parameters name their
# representative. 3: corrections, and `rests_on` of parameters. 4: the posterior, and the method of
# intervals.
FORMAT = 5
_OF_DRIVES = ("rms", "nrmse", "rms_unfiltered")
CHANGED = "the file was changed after deltaid wrote it: its checksum is another"
UNSEALED = "the file was changed after deltaid wrote it: its checksum is missing"
# Limit of YAML nodes in a file: ten years of daily recordings with 50 nodes each.
_MOST_NODES = 200_000
_VERSION = re.compile(r"^format: *(\d{1,9}) *$", re.MULTILINE)


def above(module: str, name: str) -> Any:
    """A function of a higher room, by its module's name without the package.

    Users expect `model.sample` at the model, but the sampler imports identification, which imports
    models. Such methods therefore import their function when they are called, so no module of this
    room depends on higher ones.
    """
    return getattr(import_module(f"deltaid.{module}"), name)


class Fit(Part):
    """Result of the fit; torque errors are per drive.

    `lower_bound` is the certified lower bound of the objective and `duality_gap` its distance from
    `objective`; both are None for an objective without a certificate.
    """

    objective: float
    lower_bound: float | None = None
    duality_gap: float | None = None
    gamma: float
    status: str
    iterations: int
    optimization_variables: int
    base_parameters: int
    base_condition: float
    noise_level: float
    rms: tuple[NotNegative, ...]
    nrmse: tuple[NotNegative, ...]
    rms_unfiltered: tuple[NotNegative, ...]


class Consistency(Part):
    """Eigenvalues of each body's pseudo-inertia matrix (12), ascending, all positive."""

    body: str
    eigenvalues: tuple[float, float, float, float]


class Verification(Part):
    """Prediction errors on a recording of another motion, for each drive."""

    log: str
    sha256: str
    rms: tuple[float, ...]
    nrmse: tuple[float, ...]
    remarks: tuple[str, ...] = Field(default=(), description="doubts about this recording")


class IdentifiedModel(Shown, Plotted, Tabled, Reported, Part):
    """A robot with identified parameters."""

    format: Annotated[int, Field(ge=1, le=FORMAT)] = FORMAT
    deltaid: str = Field(description="version of deltaid that wrote the file")
    robot: RobotDescription
    parameters: tuple[Parameter, ...]
    base_parameters: tuple[BaseParameter, ...] = ()
    consistency: tuple[Consistency, ...]
    fit: Fit
    settings: Settings
    loads: tuple[HeldLoad, ...] = Field(
        default=(),
        description="loads that the recordings held; the model is of the robot without them",
    )
    sensors: tuple[FittedSensor, ...] = Field(
        default=(), description="sensors of the recordings besides those of the drives"
    )
    corrections: tuple[Correction, ...] = Field(
        default=(), description="corrections that were made; missing in earlier files"
    )
    readings: Readings | None = Field(
        default=None,
        description="corrections of positions and torques that the drives misread; missing in "
        "earlier files",
    )
    effects: tuple[FittedEffect, ...] = Field(
        default=(),
        description="permanent torques besides those of the robot; the model is of the robot "
        "without them; missing in earlier files",
    )
    absolute: tuple[str, ...] | None = Field(
        default=None,
        description="quantities besides the torques that are known in kg or N m: loads, sensors, "
        "weighed bodies; missing in earlier files",
    )
    inseparable: tuple[Inseparable, ...] = Field(
        default=(),
        description="causes that the recordings do not separate; missing in earlier files",
    )
    friction_choice: FrictionChoice | None = None
    friction_curves: tuple[FrictionCurve, ...] = Field(
        default=(), description="friction over speed with intervals; missing in earlier files"
    )
    posterior: PosteriorRecord | None = Field(
        default=None, description="posterior that models are drawn from; missing in earlier files"
    )
    sources: tuple[Source, ...]
    warnings: tuple[str, ...] = ()
    undecided: tuple[str, ...] = Field(
        default=(), description="warnings that only state that something is undecided"
    )
    wrong: tuple[str, ...] = Field(
        default=(), description="faults that the checks found and --force ignored"
    )
    unexplained: float = Field(
        default=0.0, ge=0.0, description="largest share of a drive's torque that no cause explains"
    )
    identified_on: date | None = Field(
        default=None, description="day of the fit; missing in earlier files"
    )
    verification: Verification | None = Field(
        default=None,
        description="errors on a motion that the fit did not use; missing in earlier files",
    )

    @property
    def layout(self) -> ParameterLayout:
        """Names and indices of the parameters."""
        return parameter_layout(self.robot)

    @property
    def p(self) -> Float[np.ndarray, " parameters"]:
        """The identified parameter vector."""
        return np.array([parameter.value for parameter in self.parameters])

    @property
    def digest(self) -> str:
        """First twelve digits of the SHA-256 of all content but the date."""
        data = self.model_dump_json(exclude={"identified_on"})
        return hashlib.sha256(data.encode()).hexdigest()[:12]

    @property
    def consistent(self) -> bool:
        """Whether all bodies are physically consistent and all friction positive."""
        return least_margin(self.layout, self.p)[1] > 0

    @property
    def gains(self) -> Float[np.ndarray, " drives"]:
        """Torque of each drive at the joint for a recorded 1 N m (or 1 N)."""
        corrected = {c.subject: c.value for c in self.corrections if c.kind == "gain"}
        return np.array([corrected.get(drive) or 1.0 for drive in self.robot.drives])

    @property
    def commands(self) -> str:
        """Commands of drives whose gain is not 1, as functions of joint torques: "tau2 / 1.25"."""
        gains = enumerate(self.gains.tolist(), 1)
        return ", ".join(f"tau{i} / {gain:.6g}" for i, gain in gains if gain != 1.0)

    @property
    def dynamics(self) -> "Dynamics":
        """The robot's dynamics with these parameters, as `Model.dynamics`."""
        return above("model.model", "load")(self).dynamics

    def value(self, name: str) -> float:
        """One parameter by name, such as 'U.mcx' or 'viscous.drive1'.

        Raises:
            UnknownNameError: the robot has no such parameter; the message suggests the nearest.
        """
        return float(self.p[place(self.layout, name, self.robot.name)])

    def __getitem__(self, name: str) -> float:
        """The same as `value`, by index."""
        return self.value(name)

    def parameter(self, name: str) -> Parameter:
        """One parameter with its interval, its prior and what determines it.

        Raises:
            UnknownNameError: as `value`.
        """
        return self.parameters[place(self.layout, name, self.robot.name)]

    def sample(
        self, n: int, seed: int = 0, limb_tolerance: float = 0.0, *, progress: Watch = None
    ) -> "Samples":
        """Consistent models drawn from the posterior, as by `Model.sample`."""
        return above("model.model", "load")(self).sample(n, seed, limb_tolerance, progress=progress)

    def save(self, path: str | Path) -> None:
        """Save as YAML with a checksum in the last line; numbers keep every bit.

        Raises:
            DeltaidError: the file cannot be written.
        """
        text = yaml_text(self.model_dump(mode="json", exclude_none=True))
        data = sealed(f"{text}# {EMPTY}\n".encode())
        with written_whole(Path(path)) as file:
            file.write(data.decode())

    @classmethod
    def load(cls, path: str | Path) -> "IdentifiedModel":
        """Load a saved model; adds a warning if the file was changed by hand.

        Raises:
            DescriptionError: the file is no model, is of a later version, or its bodies are not
                consistent.
        """
        text, where = read_text(Path(path)), str(path)
        version = _VERSION.search(text)
        if version and int(version[1]) > FORMAT:  # reported before any other error
            raise DescriptionError(
                f"is a model of format {version[1]}, and this deltaid reads up to {FORMAT}",
                where=where,
                cure="update deltaid, or identify the model again with this one",
            )
        model = parse(text, cls, where=where, most=_MOST_NODES)
        warnings = model.warnings
        intact = is_intact(text.replace("\r\n", "\n").encode())
        if intact is None and model.format == FORMAT:  # earlier files may have none
            warnings = (UNSEALED, *warnings)
        if intact is False:
            warnings = (CHANGED, *warnings)
        return model.changed(robot=bound(model.robot, where), warnings=warnings)

    @model_validator(mode="after")
    def _check(self) -> "IdentifiedModel":
        self.layout.require_entries([(entry.name, entry.unit) for entry in self.parameters])
        base = [(entry.representative, entry.unit) for entry in self.base_parameters]
        self.layout.require_units("base_parameters", base)
        drives = len(self.robot.drives)
        counted = {f"fit.{name}": getattr(self.fit, name) for name in _OF_DRIVES}
        if (seen := self.verification) is not None:
            counted |= {"verification.rms": seen.rms, "verification.nrmse": seen.nrmse}
        for k, source in enumerate(self.sources):  # empty: not corrected
            several = {name: getattr(source, name) for name in ("delay", "filters", "drift")}
            counted |= {f"sources.{k}.{name}": x for name, x in several.items() if x}
        for name, numbers in counted.items():
            if len(numbers) != drives:
                raise ValueError(f"{name} must have one number a drive, that is {drives}")
        for k, correction in enumerate(self.corrections):
            if correction.kind != "gain" or correction.value is None:
                continue
            if correction.subject not in self.robot.drives:
                raise ValueError(f"corrections.{k}.subject is no drive: {correction.subject}")
            if correction.value <= 0:
                raise ValueError(f"corrections.{k}.value must be positive: it is a gain")
        known = set(self.layout.names)
        if self.posterior is not None and (strange := self.posterior.names - known):
            raise ValueError(f"posterior names {min(strange)}, which is no parameter of the robot")
        worst, margin = least_margin(self.layout, self.p)
        if margin <= 0:
            raise ValueError(f"parameters {_why_inconsistent(self.layout, self.p, worst)}")
        return self


def _why_inconsistent(
    layout: ParameterLayout, p: Float[np.ndarray, " parameters"], worst: str
) -> str:
    if worst in layout.bodies:
        reason = RigidBody(p[layout.body(worst)]).why_inconsistent
        text = f"body {worst} cannot exist: {reason or 'it lies at the edge of consistency'}"
    else:
        k = layout.names.index(worst)
        value, high = p[k], layout.parameters[k].high
        bound = f"between 0 and {high:g}" if np.isfinite(high) else "positive"
        text = f"{worst} must be {bound}, not {value:.4g}"
    return f"{text}; if the file was edited by hand, take back what `deltaid identify` wrote"
