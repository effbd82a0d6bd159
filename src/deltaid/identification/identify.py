"""The whole identification: from a robot and its logs to a consistent model with intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import compiled
from deltaid.effects.along_motion import Fitted, fitted_effects
from deltaid.estimation.additions import Addition
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.identification.events import unwatched, watched
from deltaid.identification.fit import FittedProblem, Progress, fit, with_geometry
from deltaid.identification.friction_curves import freed
from deltaid.identification.judgement import assembled, judged_parameters
from deltaid.identification.lag_stage import without_doubtful_lags
from deltaid.identification.left_out import events, left_out
from deltaid.identification.loads import found_loads, held, unloaded
from deltaid.identification.setup import Setup
from deltaid.identification.stages import idle, prepared
from deltaid.identification.study import Study
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.identification.widening import with_widened_prior
from deltaid.model.above import above
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel, Settings, Source
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import Recording, open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, described
from deltaid.shown import Plotted, Reported, Shown, Tabled

if TYPE_CHECKING:
    from deltaid.identification.validation import Validation

# Windows of a recording, spread over all of it, that a model's torques are compared with.
_COMPARED = 32


@dataclass(frozen=True, repr=False)
class Identification(Shown, Plotted, Tabled, Reported):
    """An identified model with the evidence behind it: the fit that it comes from, the recordings
    with their filters, studies of what each leaves, where it was studied as it was fitted, and of
    those that hold a load that no mapping declares, by its name."""

    model: IdentifiedModel
    problem: FittedProblem
    recordings: tuple[Recording, ...]
    studies: tuple[Study | None, ...] = ()
    detected: Mapping[str, Study] = field(default_factory=dict[str, Study])

    def __getitem__(self, name: str) -> float:
        """One parameter of the model by name, such as result["P.m"].

        Raises:
            UnknownNameError: the robot has none of that name; the message has the nearest.
        """
        return self.model[name]

    @property
    def robot(self) -> RobotDescription:
        return self.model.robot

    def report(self, path: str | Path, verification: "Validation | None" = None) -> Path:
        """Write the page of `deltaid identify`: one HTML file that works offline.

        Args:
            verification: what `deltaid.validate` found of the model on another recording.

        Raises:
            DeltaidError: the file cannot be written.
        """
        return above("notebook.show", "report")(self, path, verification)

    def save(self, path: str | Path) -> None:
        """Write the model as YAML, as `IdentifiedModel.save`."""
        self.model.save(path)

    @property
    def base(self) -> BaseParameters:
        return self.problem.base


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def identify(
    robot: RobotLike,
    logs: RecordingLike | Sequence[RecordingLike],
    *,
    columns: ColumnMappings = None,
    settings: Settings | None = None,
    progress: Progress = lambda _: None,
) -> Identification:
    """Identify a robot's dynamic parameters from recordings of the same machine.

    Args:
        robot: the description with geometry, priors and reductions; or what has one, a catalogue
            name, a file of a robot or of a model.
        logs: one recording or a sequence of them: a file of any kind that is read, a table of
            polars or pandas, or `Recording.from_arrays`.
        columns: names and units of their columns, if not the default ones, and loads that are
            held: one mapping for all recordings, or a sequence with one each (None for the default
            names). Arrays with units of their own keep these.
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
    setup = Setup(robot, tuple(recording.excerpted() for recording in recordings), settings)
    setup, problem = _fitted(setup, progress)
    robot, recordings = setup.robot, setup.recordings
    if setup.outcome is not None:
        problem = replace(problem, moves=setup.outcome.moves)
    problem = with_widened_prior(with_geometry(problem, recordings), recordings)
    judged, count = judged_parameters(freed(problem)), len(problem.p)
    loads = found_loads(setup.additions, judged[count:], held(recordings))
    carried = {load.name: load.p for load in loads}
    effects = fitted_effects(setup.additions, judged[count:])
    recordings = tuple(pulled(unloaded(recording, carried), effects) for recording in recordings)
    progress("comparing torques")
    some = [recording.sparser(_COMPARED) for recording in recordings]
    errors = [torque_error(compiled(robot), problem.p, recording) for recording in some]
    model = assembled(
        problem,
        settings,
        _mean(errors, problem.used),
        judged,
        loads=loads,
        readings=recordings[0].repairs.readings,
        effects=tuple(effect.addition.record(effect.values) for effect in effects),
        outcome=setup.outcome,
        corrections=(*setup.corrections, *_corrections(setup.additions, judged[count:])),
        sources=tuple(
            _source(recording, used, error, robot.drives)
            for recording, used, error in zip(recordings, problem.used, errors, strict=True)
        ),
        remarks=[f"{r.path}: {text}" for r in recordings for text in r.log.warnings],
        choice=setup.friction_choice,
    )
    return Identification(model, problem, recordings, _unchanged(setup), setup.detected)


def pulled(recording: Recording, effects: tuple[Fitted, ...]) -> Recording:
    """A recording without what effects beside the robot take of its torques."""
    return replace(recording, repairs=replace(recording.repairs, pulls=effects))


def _fitted(first: Setup, progress: Progress) -> tuple[Setup, FittedProblem]:
    """The fit of a setup with all that is to be corrected in it; inspecting all rows where
    excerpts missed anything, and without terms of friction and effects that it puts at zero."""
    setup, problem = _confirmed(watched(prepared(first, progress)), progress)
    setup, detected = unwatched(setup)
    if detected:
        return _fitted(first.changed(closely=True), progress)
    needless = idle(setup, problem)
    barred, effects = first.barred | needless.terms, first.barred_effects | needless.effects
    if (barred, effects) != (first.barred, first.barred_effects):
        return _fitted(first.changed(barred=barred, barred_effects=effects), progress)
    return setup, problem


def _confirmed(setup: Setup, progress: Progress) -> tuple[Setup, FittedProblem]:
    """The fit of a setup, without corrections that it does not confirm."""

    def fitted(setup: Setup) -> FittedProblem:
        return fit(setup.dynamics, setup.recordings, setup.settings, progress, setup.additions)

    problem = fitted(setup)
    if not setup.additions:
        return setup, problem
    confirmed = without_doubtful_lags(setup, judged_parameters(problem, len(problem.p)))
    if len(confirmed.additions) == len(setup.additions):
        return setup, problem
    return confirmed, fitted(confirmed)


def _unchanged(setup: Setup) -> tuple[Study | None, ...]:
    """Studies of recordings in which nothing has been corrected since, nor what gears carry.

    They were studied with initial lags, which may have been dropped since.
    """
    if setup.corrections or setup.additions or setup.robot.load_drives or not setup.studies:
        return ()
    return tuple(
        study if study and study.fit.trace.recording.repairs == recording.repairs else None
        for study, recording in zip(setup.studies, setup.recordings, strict=True)
    )


def _corrections(additions: Sequence[Addition], judged: Sequence[Parameter]) -> list[Correction]:
    corrections, rest = list[Correction](), iter(judged)
    for addition in additions:
        corrections += addition.told(tuple(islice(rest, len(addition.parameters))))
    return corrections


def _mean(errors: Sequence[TorqueError], weights: Sequence[int]) -> TorqueError:
    """Torque errors over several recordings, weighted by their samples."""

    def mean(quantity: Callable[[TorqueError], np.ndarray]) -> np.ndarray:
        return np.average([quantity(error) for error in errors], axis=0, weights=weights)

    rms = np.sqrt(mean(lambda e: e.rms**2))
    torque = np.sqrt(mean(lambda e: (e.rms / np.where(e.nrmse > 0, e.nrmse, 1.0)) ** 2))
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(mean(lambda e: e.rms_unfiltered**2)),
        covariance=mean(lambda e: e.covariance),
        turning=mean(lambda e: e.turning),
        cutoff=errors[0].cutoff,
        fastest=np.max([error.fastest for error in errors], axis=0),
    )


def _source(recording: Recording, used: int, error: TorqueError, drives: tuple[str, ...]) -> Source:
    log = recording.log
    return Source(
        log=log.path.name,
        sha256=log.sha256,
        samples=log.samples,
        rate_hz=log.rate,
        cutoff_hz=recording.cutoff,
        motion_cutoff_hz=recording.motion_cutoff,
        used_samples=used,
        left_out=left_out(log, drives, error, recording.repairs),
        events=events(recording.repairs, drives),
        delay=recording.repairs.lag,
        filters=recording.repairs.constants,
        growth=None if (growth := recording.repairs.growth) is None else astuple(growth),
    )
