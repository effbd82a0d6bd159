"""Simulation of a controller with one model on a plant with another, along a motion."""

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from deltaid.control.controllers import CONTROLLERS, Controller, ControlModel
from deltaid.control.infeasible import MotionProblem, motion_problems, tracking_problems
from deltaid.control.options import ControllerName, ControlSettings
from deltaid.control.plant import Payload, Plant, as_payload
from deltaid.control.tracking import ENCODER_STEP, Drives, Tracking, TrackingError, gains, track
from deltaid.control.trajectory import MotionTrajectory, Trajectory, open_trajectory
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, positive, unknown, with_options
from deltaid.mechanism.one_or_many import numbered
from deltaid.model.model import Model, ModelLike, load
from deltaid.motion.surrogate import Motion
from deltaid.progress import Progress, Watch, watched
from deltaid.recording.mapping import MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike, as_source
from deltaid.sensors.robot_sensors import simulated_sensors
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Tracking with other loads, by mass [kg].
Ends = tuple[tuple[float, Tracking], ...]


@dataclass(frozen=True)
class Conditions:
    """Conditions of a simulation: models, motion, drives.

    Attributes:
        model: of the controller.
        plant: the robot that it moves, without the load.
        motion: the desired motion; `path` is its name.
        bandwidth: of the feedback [Hz].
        payload: load at the tool, if any.
        warnings: about the motion's file.
    """

    model: Model
    plant: Plant
    motion: Trajectory
    path: str
    drives: Drives
    bandwidth: float
    payload: Payload | None
    warnings: tuple[str, ...]

    @cached_property
    def loaded(self) -> Plant:
        """The plant with its load."""
        return self.plant if self.payload is None else self.plant.carrying(self.payload.mass)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Whether gears are elastic, in words."""
        return ("gears wind up, with the encoders on the motors",) * self.plant.elastic

    def tracked(self, law: Controller, known: ControlModel) -> tuple[Tracking, Ends]:
        """Tracking of a controller with a model on the plant with its load, and with loads two
        standard deviations off, by mass [kg]."""
        run = partial(
            track, controller=law, model=known, trajectory=self.motion, drives=self.drives
        )
        masses = self.payload.ends if self.payload else ()
        return run(self.loaded), tuple((mass, run(self.plant.carrying(mass))) for mass in masses)


@dataclass(frozen=True, repr=False)
class Simulation(Shown, Plotted, Tabled, Reported):
    """A simulated motion under a controller.

    Attributes:
        controller: its name.
        conditions: models, motion, drives.
        tracking: the desired and the resulting motion.
        problems: faults of the desired and of the resulting motion.
        payload_known: whether the controller knows the mass of the load.
        ends: tracking with loads two standard deviations off, by mass [kg].
    """

    controller: ControllerName
    conditions: Conditions
    tracking: Tracking
    problems: tuple[MotionProblem, ...]
    payload_known: bool
    ends: Ends

    @property
    def error(self) -> TrackingError:
        """Tracking errors and torques."""
        return self.tracking.error

    @property
    def remarks(self) -> tuple[str, ...]:
        """Held loads, and whether gears are elastic, in words."""
        payload, lines = self.conditions.payload, [*self.conditions.remarks]
        if payload is not None:
            known = f"{payload.mass:.4g} kg" if self.payload_known else "nothing"
            load = f"with a load of {payload.mass:.4g} kg"
            lines.append(f"{load}, of which the controller knows {known}")
        for mass, result in self.ends:
            lost = "" if result.ended is None else f", and lost after {result.ended:.3g} s"
            lines.append(
                f"with {mass:.4g} kg (two standard deviations off): "
                f"{1e3 * result.error.platform_rms:.3g} mm rms and "
                f"{1e3 * result.error.platform_max:.3g} mm at most{lost}"
            )
        return tuple(lines)

    def table(self) -> pl.DataFrame:
        """Motion and torques with the default names of a log, sensor readings, and the desired
        motion.

        It ends where the robot left its workspace, so that it can be read as a log.
        """
        result, task = self.tracking, self.tracking.task.names
        columns = {"t": result.time} | numbered(q=result.q, tau=result.tau)
        columns |= {f"{q}_desired": x for q, x in numbered(q=result.q_desired).items()}
        columns |= dict(zip(task, result.z.T, strict=True))
        columns |= {f"{name}_desired": x for name, x in zip(task, result.z_desired.T, strict=True)}
        plant = self.conditions.loaded.model_at(0.0)
        if plant.robot.sensors:  # accelerations between the drives' samples
            motion = result.z, result.qd, np.gradient(result.qd, result.time, axis=0)
            rng = np.random.default_rng(0)
            columns |= simulated_sensors(compiled(plant.robot), plant.p, *motion, rng)
        return pl.DataFrame({name: values[result.valid] for name, values in columns.items()})


def simulate(
    model: ModelLike,
    motion: RecordingLike | Motion | Trajectory,
    *,
    controller: ControllerName = "computed-torque",
    plant: ModelLike | None = None,
    payload_known: bool = False,
    columns: MappingLike | None = None,
    duration: float | None = None,
    settings: ControlSettings | None = None,
    progress: Watch = None,
    **options: Any,
) -> Simulation:
    """Simulate a controller that knows `model` along a motion of a robot, which may differ from it.

    Friction at rest, torque limits, encoder steps and sampling are simulated. A robot without a
    model has its prior parameters.

    Args:
        motion: a file of `deltaid excite`, a recording, or a motion in memory.
        plant: the robot that the controller moves; that of `model` if None.
        payload_known: whether the controller knows the mass of the load.
        columns: of a recording, if not the default ones.
        duration: of a motion in memory [s]; one period, or to its end, if None.
        settings: of drives, feedback and load.
        progress: as in `identify`.
        options: single settings by name, such as `rate=500`.

    Raises:
        DeltaidError: a setting or controller does not exist, a number is out of bounds, or the
            plant's drives are not those of the model.
        RecordingError: the motion's file cannot be used.
        KinematicsError: the motion leaves the plant's reach, or the model's.
    """
    if controller not in CONTROLLERS:
        raise unknown(controller, CONTROLLERS, "controller", "simulate")
    asked = with_options(settings or ControlSettings(), options, "simulate")
    if asked.payload is None and payload_known:
        cure = "give --payload MASS too"
        raise DeltaidError("there is no load to know", where="--payload-known", cure=cure)
    with watched(progress, "simulate") as say:
        on = conditions(asked, model, motion, plant, columns, duration, say)
        say("simulating")
        known = ControlModel(on.model.robot, on.model.p)
        if on.payload is not None and payload_known:
            known = known.holding(on.payload.mass)
        law = gains(controller, known, on.motion, on.bandwidth)
        problems = motion_problems(on.loaded.model_at(0.0), on.motion)
        result, ends = on.tracked(law, known)
        problems += tracking_problems(on.plant.model, result)
    return Simulation(controller, on, result, problems, payload_known, ends)


def conditions(
    asked: ControlSettings,
    model: ModelLike,
    motion: RecordingLike | Motion | Trajectory,
    plant: ModelLike | None,
    columns: MappingLike | None,
    duration: float | None,
    progress: Progress,
) -> Conditions:
    """Conditions of `simulate` and `compare_controllers`, from their arguments."""
    step = ENCODER_STEP if asked.encoder is None else asked.encoder
    drives = Drives(asked.rate, step, asked.delay, current_loop=asked.current_loop or np.inf)
    held, known = as_payload(asked.payload), load(model)
    moved, name, warnings = known if plant is None else load(plant), "a motion", ()
    kinds = [x.linear_drives for x in (moved.robot, known.robot)]
    if kinds[0] != kinds[1]:
        words = [f"{k.count(False)} rotary and {k.count(True)} linear drives" for k in kinds]
        raise DeltaidError(
            f"has {words[0]}, but the model's robot has {words[1]}",
            where=f"--plant {plant}" if isinstance(plant, str | Path) else "plant",
            cure="the plant must be the robot that the model is of",
        )
    positive("duration", duration)
    if duration is not None and not isinstance(motion, Motion):
        raise DeltaidError(
            "is of a motion in memory, and a recording has its own",
            where="duration",
            cure="leave it out, or cut the recording",
        )
    robot, kinematics = Plant(moved, elastic=asked.elastic_gears), compiled(known.robot).kinematics
    if isinstance(motion, Motion):
        length = duration or getattr(motion, "duration", 0.0) or getattr(motion, "period", 0.0)
        motion = MotionTrajectory(kinematics, motion, length)
    elif not isinstance(motion, Trajectory):
        source = as_source(motion)
        progress(f"checking {source}")
        motion, log = open_trajectory(source, kinematics, as_mapping(columns))
        name, warnings = log.path.name, tuple(f"{source}: {text}" for text in log.warnings)
    return Conditions(known, robot, motion, name, drives, asked.bandwidth, held, warnings)
