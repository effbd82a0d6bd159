"""What identification buys: each controller with each model of one robot, on the same plant."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.control.controllers import (
    CONTROLLERS,
    NEED_MASS_MATRIX,
    Controller,
    ControlModel,
    tuned,
)
from deltaid.control.infeasible import MotionProblem, of_tracking
from deltaid.control.options import ControllerName
from deltaid.control.plant import Payload, Plant, as_plant
from deltaid.control.tracking import Drives, Tracking, track
from deltaid.control.trajectory import Trajectory
from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.errors import DeltaidError
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.record import IdentifiedModel

# M counts as positive definite with eigenvalues above this share of its own diagonal: below it the
# feedback of a computed torque is a hundred times weaker in one direction than it was tuned for.
_POSITIVE = 0.01
# Poses of a trajectory at which M is looked at.
_POSES = 400


@dataclass(frozen=True)
class ModelCandidate:
    """A model by name: 'prior', 'base parameters', 'identified'."""

    name: str
    model: ControlModel


@dataclass(frozen=True)
class ControllerRun:
    """One controller with one model.

    Attributes:
        controller: its name.
        model: the model's name; empty for a controller that needs none.
        tracking: what became of it; None where it cannot run.
        why_not: why not, then.
        ends: the same with loads at the ends of what they may be, by their mass [kg].
        problems: what no one would want on a robot: a limit that cuts, a robot that is lost.
    """

    controller: ControllerName
    model: str
    tracking: Tracking | None
    why_not: str = ""
    problems: tuple[MotionProblem, ...] = ()
    ends: tuple[tuple[float, Tracking], ...] = ()


def candidates(model: ModelLike) -> tuple[ModelCandidate, ...]:
    """The description's prior, the base parameters (if the file has them), the consistent model.

    A robot at its prior has only that.
    """
    model = load(model)
    vectors = {"prior": prior_parameters(model.robot)}
    if model.identified is not None:
        if model.identified.base_parameters:
            vectors["base parameters"] = base_vector(model.identified)
        vectors["identified"] = model.p
    return tuple(ModelCandidate(name, ControlModel(model.robot, p)) for name, p in vectors.items())


def base_vector(model: IdentifiedModel) -> Parameters:
    """A p with the torques of the base parameters: each on its representative, all else zero.

    Its torques, M and C are those of all p with the same base parameters, but its bodies are not
    those of a robot.
    """
    layout = parameter_layout(model.robot)
    p = np.zeros(len(layout.names))
    for parameter in model.base_parameters:
        if parameter.representative not in layout.names:
            raise DeltaidError(
                "the model's file says its base parameters in words only",
                where="base_parameters",
                cure="identify once more with this version, then compare",
            )
        p[layout.names.index(parameter.representative)] = parameter.value
    return p


def gains(
    name: ControllerName, model: ControlModel, trajectory: Trajectory, bandwidth: float
) -> Controller:
    """A controller tuned with a model's M along a trajectory; `bandwidth` in Hz.

    Raises:
        KinematicsError: the trajectory is out of reach.
    """
    return tuned(name, model.mass_diagonal(_poses(trajectory)), bandwidth)


def compare(
    plant: Model | Plant,
    models: Sequence[ModelCandidate],
    trajectory: Trajectory,
    drives: Drives,
    bandwidth: float,
    progress: Callable[[str], None] = lambda _: None,
    payload: Payload | None = None,
) -> tuple[ControllerRun, ...]:
    """All controllers with all models, tuned alike: with the mass matrix of the last model.

    A controller that needs a mass matrix does not run with a model whose M is not positive definite
    along the trajectory; base parameters by least squares promise torques only.

    Args:
        payload: what the plant carries; the last model then runs a second time, with its mass
            known, and all runs are repeated at both ends of what it may be.

    Raises:
        KinematicsError: the trajectory is out of reach.
    """
    plant, tuned_with, known = as_plant(plant), models[-1].model, models[-1:]
    if payload is not None:
        plant, last = plant.carrying(payload.mass), models[-1]
        known = (ModelCandidate(f"{last.name}, load known", last.model.holding(payload.mass)),)
        models = (*models, *known)
    runs = []
    for name in CONTROLLERS:
        law = gains(name, tuned_with, trajectory, bandwidth)
        for candidate in known if name == "pd" else models:
            label = "" if name == "pd" else candidate.name
            progress(f"{name} {label}")
            if name in NEED_MASS_MATRIX:
                why_not = _lack(candidate.model.least_eigenvalue(_poses(trajectory)))
                if why_not:
                    runs.append(ControllerRun(name, label, None, why_not))
                    continue
            done = track(plant, law, candidate.model, trajectory, drives)
            ends = tuple(
                (mass, track(plant.carrying(mass), law, candidate.model, trajectory, drives))
                for mass in (payload.ends if payload else ())
            )
            runs.append(ControllerRun(name, label, done, "", of_tracking(plant.model, done), ends))
    return tuple(runs)


def _lack(eigenvalue: float) -> str:
    return "" if eigenvalue > _POSITIVE else "M is not positive definite"


def _poses(trajectory: Trajectory) -> Float[np.ndarray, "poses dof"]:
    return trajectory.desired(np.linspace(0.0, trajectory.duration, _POSES)).q
