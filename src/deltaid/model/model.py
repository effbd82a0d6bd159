"""A robot with its parameters and their origin: the input of all commands and functions."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled, compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import (
    ParameterLayout,
    parameter_layout,
    prior_parameters,
    with_prior,
)
from deltaid.errors import DescriptionError, unknown
from deltaid.model.parameter_record import place
from deltaid.model.record import IdentifiedModel, above
from deltaid.progress import Watch, watched
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import TERMS
from deltaid.robot.inertia import RigidBody
from deltaid.robot.load import (
    catalogue,
    holds_a_model,
    load_robot,
    read_text,
    require_name,
)
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.robot.platform import PASSIVE_JOINTS
from deltaid.shown import Plotted, Reported, Shown, Tabled

if TYPE_CHECKING:
    from deltaid.model.samples import Samples


# Kinds of joint coefficients, some of which a robot may lack.
_COEFFICIENTS = {*(term.kind for term in TERMS), "spring", "rotor"}


@dataclass(frozen=True, eq=False, repr=False)
class Model(Shown, Plotted, Tabled, Reported):
    """A robot with physically possible parameters.

    Attributes:
        robot: its description.
        p: parameters in the order of the layout.
        source: name of the file or catalogue robot that they come from.
        identified: the identification behind them, with its intervals; None for a prior.
        altered: changes of the parameters since, in words.

    Raises:
        DescriptionError: the parameters do not match the robot or are not finite, or a body with
            them is impossible.
    """

    robot: RobotDescription
    p: Parameters
    source: str = ""
    identified: IdentifiedModel | None = None
    altered: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        p, where = np.array(self.p), self.source or self.robot.name
        p.flags.writeable = False
        object.__setattr__(self, "p", p)
        if self.p.shape != (len(self.layout.names),):
            raise DescriptionError(
                f"has {self.p.size} parameters, but the robot has {len(self.layout.names)}",
                where=where,
                cure="give one for each name in model.layout.names, in that order",
            )
        self.layout.require_finite(self.p)
        for name in self.layout.bodies:  # plates and lines are allowed
            if reason := RigidBody(self.body(name)).with_thickness().why_inconsistent:
                raise DescriptionError(
                    f"body {name} cannot exist: {reason}",
                    where=where,
                    cure="take parameters of a consistent fit, such as `deltaid identify` makes",
                )

    @property
    def origin(self) -> str:
        """Origin of the parameters, in words."""
        if self.identified is None:
            return "the prior of its description"
        return f"identified from {', '.join(source.log for source in self.identified.sources)}"

    @cached_property
    def layout(self) -> ParameterLayout:
        """Names, units and indices of the parameters."""
        return parameter_layout(self.robot)

    @cached_property
    def dynamics(self) -> Dynamics:
        """The robot's dynamics with these parameters, compiled on first use."""
        return compiled(self.robot).with_parameters(self.p)

    @cached_property
    def forward(self) -> ForwardDynamics:
        """The robot's forward dynamics with these parameters, compiled on first use."""
        return compiled_as(ForwardDynamics, self.robot).with_parameters(self.p)

    @property
    def prior_spread(self) -> float:
        """Relative standard deviation of the prior that the identification assumed."""
        return PRIOR_SPREAD if self.identified is None else self.identified.settings.prior_spread

    def body(self, name: str) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters of one body, about its link frame.

        Raises:
            UnknownNameError: the robot has no such body.
        """
        if name not in self.layout.bodies:
            raise unknown(name, self.layout.bodies, "body", self.source or self.robot.name)
        return self.p[self.layout.body(name)]

    def __getitem__(self, name: str) -> float:
        """One parameter by name, such as model["P.m"] or model["viscous.drive1"].

        Raises:
            UnknownNameError: the robot has no such parameter; the message suggests the nearest.
        """
        return float(self.p[place(self.layout, name, self.source or self.robot.name)])

    def value(self, name: str) -> float:
        """The same; zero for a joint coefficient that the robot lacks, such as 'rotor.drive1'.

        Raises:
            UnknownNameError: no robot has such a parameter.
        """
        kind, _, joint = name.partition(".")
        absent = name not in self.layout.names and kind in _COEFFICIENTS
        joints = (*self.robot.drives, *self.robot.friction_joints, *PASSIVE_JOINTS)
        return 0.0 if absent and joint in joints else self[name]

    @property
    def gains(self) -> Float[np.ndarray, " drives"]:
        """Torque of each drive at the joint for a recorded or commanded 1 N m (or 1 N), as
        identified."""
        known = self.identified
        return np.ones(len(self.robot.drives)) if known is None else known.gains

    def with_load(self, load: str | Float[np.ndarray, " 10"], body: str | None = None) -> "Model":
        """The same robot with a permanent load.

        Args:
            load: name of a load that the model was identified with, or ten inertia parameters.
            body: that carries it; ignored for a named load; by default EE, or P if there is no EE.

        Raises:
            UnknownNameError: the model was identified with no load of that name.
            DescriptionError: the robot has no such body, or a body with the load is impossible.
        """
        if isinstance(load, str):
            known = {held.name: held for held in self.identified.loads} if self.identified else {}
            if load not in known:
                raise unknown(load, known, "load", self.source or self.robot.name)
            body, ten = known[load].body, known[load].p
        else:
            ten = load
        carrier = body or self.robot.load_carrier
        if carrier not in self.layout.bodies:
            raise DescriptionError(
                f"has no body {body}" if body else "has no body EE or P that would carry a load",
                where=self.source or self.robot.name,
                cure=f"name what does, in Python: one of {', '.join(self.layout.bodies)}",
            )
        p = self.p.copy()
        p[self.layout.body(carrier)] += ten
        return self._altered(p, f"with a load of {ten[0]:.6g} kg")

    def without_friction(self) -> "Model":
        """The same robot with all friction coefficients zero."""
        p = self.p.copy()
        p[self.layout.friction] = 0.0
        return self._altered(p, "without friction")

    def _altered(self, p: Parameters, how: str) -> "Model":
        return replace(self, p=p, altered=(*self.altered, how))

    def sample(
        self, n: int, seed: int = 0, limb_tolerance: float = 0.0, *, progress: Watch = None
    ) -> "Samples":
        """Consistent models drawn from the posterior of data, prior and consistency.

        Args:
            n: number of models.
            seed: equal seeds give equal models.
            limb_tolerance: relative standard deviation of masses and second moments between limbs,
                whose mean over the limbs is kept; 0 for identical limbs.
            progress: whether to show progress; None to show it in interactive sessions.

        Raises:
            DescriptionError: the model is a prior, or its file is of a version without a posterior.
            IdentificationError: the draws are not reliable.
        """
        with watched(progress, "sample") as say:
            say(f"drawing {n} models")
            return above("estimation.posterior_draws", "draw")(self, n, seed, limb_tolerance)

    def as_description(self) -> RobotDescription:
        """The robot with these parameters as its prior."""
        return self.robot if self.identified is None else with_prior(self.robot, self.p)

    @property
    def home(self) -> Float[np.ndarray, " dof"]:
        """A pose z in the middle of the workspace."""
        return self.dynamics.kinematics.home

    @property
    def name(self) -> str:
        """The robot's name for files of other programs."""
        return _printable(self.robot.name) or "robot"

    @property
    def provenance(self) -> str:
        """One line on the origin of the parameters, for the head of a file."""
        named = ", ".join((_printable(self.robot.title) or self.name, *self.altered))
        line = f"{named}, from {_printable(self.source)} by deltaid {version('deltaid')}"
        return line if self.identified is None else f"{line}. {self._quality(self.identified)}"

    def _quality(self, known: IdentifiedModel) -> str:
        """Verdict and verification of the model, and its changes since."""
        verdict = _printable(above("view.summary", "summary")(self).sentence)
        seen, made = known.verification, known.identified_on
        day = "" if made is None else f" of {made}"
        on = "" if seen is None else f" Verified on {_printable(seen.log)}."
        line = f"{verdict}{on} Model {known.digest}{day}, deltaid {known.deltaid}"
        drives = f". Torques are at the joints; for them command {known.commands}"
        return line + drives * bool(known.commands)


@runtime_checkable
class HasModel(Protocol):
    """Result of an identification."""

    @property
    def model(self) -> IdentifiedModel:
        """The identified model of a result."""
        ...


# Inputs that `load` accepts: a catalogue name, a robot or model file, a value, or the dictionary of
# either file.
ModelLike = Model | IdentifiedModel | HasModel | RobotDescription | Mapping[str, Any] | str | Path


def load(source: ModelLike) -> Model:
    """A robot with its parameters.

    Args:
        source: a catalogue name, a robot file or a model file; a description, the result of
            `deltaid.identify`, or the content of either file as a dictionary. A robot has the
            parameters of its prior.

    Raises:
        DescriptionError: there is no such robot or file, or the file is neither.
    """
    match source:
        case Model():
            return source
        case IdentifiedModel():
            return Model(source.robot, source.p, source.robot.name, source)
        case RobotDescription():
            return Model(source, prior_parameters(source), source.name)
        case HasModel():
            return load(source.model)
        case Mapping() if "parameters" in source:
            return load(IdentifiedModel.from_dict(source, "model"))
        case Mapping():
            return load(load_robot(source))
        case _:
            require_name(source)
            return _from_file(source)


def _from_file(source: str | Path) -> Model:
    name, is_shipped = Path(source).name, str(source) in catalogue()
    if not is_shipped and os.path.exists(source) and holds_a_model(read_text(Path(source))):
        identified = IdentifiedModel.load(source)
        return Model(identified.robot, identified.p, name, identified)
    robot = load_robot(source)
    return Model(robot, prior_parameters(robot), name)


def _printable(text: str) -> str:
    """Text on one line without control characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
