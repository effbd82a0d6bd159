"""The whole identification: from a robot and its logs to a consistent model with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import compiled
from deltaid.identification.base_parameters import BaseParameters
from deltaid.identification.doubts import doubts
from deltaid.identification.fit import FittedProblem, Progress, fit
from deltaid.identification.friction_choice import choose_friction
from deltaid.identification.judgement import (
    eigenvalues,
    judged_base,
    judged_parameters,
    record,
)
from deltaid.identification.left_out import left_out
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.model.record import IdentifiedModel, Settings, Source
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import Recording, open_recordings
from deltaid.robot.load import RobotLike, described


@dataclass(frozen=True)
class Identification:
    """An identified model with the evidence behind it.

    Attributes:
        model: the result.
        problem: the fit that it comes from.
        recordings: the logs behind it, each with its filter.
    """

    model: IdentifiedModel
    problem: FittedProblem
    recordings: tuple[Recording, ...]

    @property
    def base(self) -> BaseParameters:
        """Which combinations of parameters the motion determines."""
        return self.problem.base


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def identify(
    robot: RobotLike,
    logs: RecordingLike | Sequence[RecordingLike],
    *,
    columns: ColumnMapping | None = None,
    settings: Settings | None = None,
    progress: Progress = lambda _: None,
) -> Identification:
    """Identify a robot's dynamic parameters from recordings of the same machine.

    Args:
        robot: the description with geometry, priors and reductions; or what has one, a catalogue
            name, a file of a robot or of a model.
        logs: one recording or a sequence of them: a file of any kind that is read, a table of
            polars or pandas, or `Recording.from_arrays`.
        columns: names and units of their columns, if not the default ones; arrays with units of
            their own keep these.
        settings: method, regulariser, γ, filter, friction laws.
        progress: called with a sentence before each stage.

    Raises:
        RecordingError: a log cannot be used.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, robot = settings or Settings(), described(robot)
    kinematics = compiled(robot).kinematics
    recordings = open_recordings(
        logs, kinematics, columns, settings.cutoff, progress, keep_all=settings.keep_all
    )
    choice = None
    if settings.friction == "choose":
        robot, choice = choose_friction(robot, recordings, progress)
    dynamics = compiled(robot)
    problem = fit(dynamics, recordings, settings, progress)
    progress("comparing torques")
    errors = [torque_error(dynamics, problem.p, one) for one in recordings]
    model = IdentifiedModel(
        deltaid=version("deltaid"),
        robot=robot,
        parameters=judged_parameters(problem),
        base_parameters=judged_base(problem),
        consistency=eigenvalues(problem.layout, problem.p),
        fit=record(problem, _mean(errors, problem.used)),
        settings=settings,
        friction_choice=choice,
        sources=tuple(
            _source(*one, robot.drives)
            for one in zip(recordings, problem.used, errors, strict=True)
        ),
        warnings=(
            *(f"{one.path}: {text}" for one in recordings for text in one.log.warnings),
            *doubts(problem),
        ),
    )
    return Identification(model, problem, tuple(recordings))


def _mean(errors: Sequence[TorqueError], weights: Sequence[int]) -> TorqueError:
    """Torque errors over several recordings, weighted by their samples."""
    share = np.array(weights)[:, None] / sum(weights)

    def together(squares: list[np.ndarray]) -> np.ndarray:
        return np.sqrt(np.sum(share * np.array(squares), axis=0))

    rms = together([e.rms**2 for e in errors])
    torque = together([(e.rms / np.where(e.nrmse > 0, e.nrmse, 1.0)) ** 2 for e in errors])
    covariance = np.einsum("i,ijk->jk", share[:, 0], np.array([e.covariance for e in errors]))
    raw = together([e.rms_unfiltered**2 for e in errors])
    turning = np.einsum("i,ij->j", share[:, 0], np.array([e.turning for e in errors]))
    return TorqueError(
        rms, rms / np.where(torque > 0, torque, 1.0), raw, covariance, turning, errors[0].cutoff
    )


def _source(recording: Recording, used: int, error: TorqueError, drives: tuple[str, ...]) -> Source:
    log = recording.log
    return Source(
        log=log.path.name,
        sha256=log.sha256,
        samples=log.samples,
        rate_hz=log.rate,
        cutoff_hz=recording.cutoff,
        used_samples=used,
        left_out=left_out(log, drives, error),
    )
