"""Comparison of models in control: each controller with each model of a robot, on one plant."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltaid.control.controllers import CONTROLLERS, NEED_MASS_MATRIX, ControlModel
from deltaid.control.infeasible import MotionProblem, motion_problems, tracking_problems
from deltaid.control.options import ControllerName, ControlSettings
from deltaid.control.simulate import Conditions, conditions
from deltaid.control.tracking import Tracking, gains, poses
from deltaid.control.trajectory import Trajectory
from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.errors import DeltaidError, with_options
from deltaid.model.model import ModelLike, load
from deltaid.model.record import IdentifiedModel
from deltaid.motion.surrogate import Motion
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import MappingLike
from deltaid.recording.memory import RecordingLike
from deltaid.shown import Reported, Shown

# Least eigenvalue of an M scaled to a unit diagonal that counts as positive definite: below it the
# feedback of computed torque is a hundred times weaker in one direction than tuned.
_POSITIVE = 0.01


@dataclass(frozen=True)
class ControllerRun:
    """One controller with one model.

    Attributes:
        controller: its name.
        model: the model's name; empty for a controller that needs none.
        tracking: the resulting motion; None if it cannot run.
        why_not: why it cannot run.
        problems: faults of the resulting motion.
        ends: tracking with loads two standard deviations off, by mass [kg].
    """

    controller: ControllerName
    model: str
    tracking: Tracking | None
    why_not: str = ""
    problems: tuple[MotionProblem, ...] = ()
    ends: tuple[tuple[float, Tracking], ...] = ()


@dataclass(frozen=True, repr=False)
class Comparison(Shown, Reported):
    """Every controller with every model of a robot, on one plant.

    Attributes:
        conditions: plant, motion, drives.
        candidates: the models by name.
        runs: one for each controller and model.
        problems: limits of the plant that the motion itself exceeds.
    """

    conditions: Conditions
    candidates: dict[str, ControlModel]
    runs: tuple[ControllerRun, ...]
    problems: tuple[MotionProblem, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Held loads, and whether gears are elastic, in words."""
        payload = self.conditions.payload
        load = [f"the robot holds a load of {payload.mass:.4g} kg"] if payload else []
        return (*self.conditions.remarks, *load)


def compare_controllers(
    model: ModelLike,
    motion: RecordingLike | Motion | Trajectory,
    *,
    plant: ModelLike,
    columns: MappingLike | None = None,
    duration: float | None = None,
    settings: ControlSettings | None = None,
    progress: Watch = None,
    **options: Any,
) -> Comparison:
    """Compare tracking with the prior, the base parameters and the identified model.

    Every controller runs with every model on the plant. All have the same tuning, so they differ
    only in their knowledge of the robot. Arguments and errors are those of `simulate`.
    """
    asked = with_options(settings or ControlSettings(), options, "compare_controllers")
    with watched(progress, "compare") as say:
        on = conditions(asked, model, motion, plant, columns, duration, say)
        problems, models = motion_problems(on.loaded.model_at(0.0), on.motion), candidates(on.model)
        runs = compare(on, models, say)
    return Comparison(on, models, runs, problems)


def candidates(model: ModelLike) -> dict[str, ControlModel]:
    """Prior of the description, base parameters (if the file has them) and consistent model, by
    name: 'prior', 'base parameters', 'identified'.

    A robot without a model has only the prior.
    """
    model = load(model)
    vectors = {"prior": prior_parameters(model.robot)}
    if model.identified is not None:
        if model.identified.base_parameters:
            vectors["base parameters"] = base_vector(model.identified)
        vectors["identified"] = model.p
    return {name: ControlModel(model.robot, p) for name, p in vectors.items()}


def base_vector(model: IdentifiedModel) -> Parameters:
    """A p with the torques of the base parameters: each at its representative, all others zero.

    Its torques, M and C are those of all p with the same base parameters, but its bodies are not
    physically possible.
    """
    names = parameter_layout(model.robot).names
    p = np.zeros(len(names))
    for parameter in model.base_parameters:
        if parameter.representative not in names:
            raise DeltaidError(
                "the model's file says its base parameters in words only",
                where="base_parameters",
                cure="identify once more with this version, then compare",
            )
        p[names.index(parameter.representative)] = parameter.value
    return p


def compare(
    on: Conditions,
    models: dict[str, ControlModel],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[ControllerRun, ...]:
    """Run all controllers with all models, all tuned by the mass matrix of the last model.

    A controller that needs a mass matrix does not run with a model whose M is not positive definite
    along the trajectory; least squares of base parameters ensure only torques. With a load the last
    model runs a second time with the mass known, and all runs are repeated with masses two standard
    deviations below and above.

    Raises:
        KinematicsError: the trajectory is out of reach.
    """
    last, tuned = list(models.items())[-1]
    known = tuned
    if on.payload is not None:
        known = tuned.holding(on.payload.mass)
        models = {**models, f"{last}, load known": known}
    runs = []
    for name in CONTROLLERS:
        law = gains(name, tuned, on.motion, on.bandwidth)
        for label, model in ({"": known} if name == "pd" else models).items():
            progress(f"{name} {label}")
            needs = name in NEED_MASS_MATRIX
            if needs and (why := _why_not(model.least_eigenvalue(poses(on.motion)))):
                runs.append(ControllerRun(name, label, None, why))
                continue
            done, ends = on.tracked(law, model)
            problems = tracking_problems(on.plant.model, done)
            runs.append(ControllerRun(name, label, done, "", problems, ends))
    return tuple(runs)


def _why_not(eigenvalue: float) -> str:
    return "" if eigenvalue > _POSITIVE else "M is not positive definite"
