"""The whole identification: from a robot and its logs to a consistent model with intervals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import compiled
from deltaid.effects.along_motion import fitted_effects
from deltaid.errors import UnsettledFrictionError
from deltaid.estimation.additions import split_by_addition
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.identification.assembly import assembled
from deltaid.identification.common_constant import of_laws
from deltaid.identification.fit import FittedProblem, Progress, fit, with_geometry
from deltaid.identification.friction_choice import chosen_friction
from deltaid.identification.friction_constants import LawConstants, freed
from deltaid.identification.gains import moves_of_scale
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.loads import held_loads, identified_loads, unloaded
from deltaid.identification.setup import Setup
from deltaid.identification.sources import source
from deltaid.identification.stages import idle, run_stages
from deltaid.identification.study import Study
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.identification.widening import with_widened_prior
from deltaid.model.record import IdentifiedModel, Settings, above
from deltaid.recording.log import MOST_WINDOWS
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.load import RobotLike, load_robot
from deltaid.shown import Plotted, Reported, Shown, Tabled

if TYPE_CHECKING:
    from deltaid.identification.prediction import Validation


@dataclass(frozen=True, repr=False)
class Identification(Shown, Plotted, Tabled, Reported):
    """An identified model with its evidence.

    Attributes:
        problem: the fit that the model comes from.
        recordings: with their filters and corrections.
        studies: of each recording's residual; empty where corrections followed.
        detected: studies that detected undeclared loads, by the loads' names.
    """

    model: IdentifiedModel
    problem: FittedProblem
    recordings: tuple[PreparedRecording, ...]
    studies: tuple[Study | None, ...] = ()
    detected: Mapping[str, Study | None] = field(default_factory=dict[str, Study | None])

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
        return above("view.show", "report")(self, path, verification)

    def save(self, path: str | Path, verification: "Validation | None" = None) -> None:
        """Write the model as YAML, as `IdentifiedModel.save`.

        Args:
            path: of the file.
            verification: as of `report`; the file keeps what it says of the model.
        """
        model = self.model if verification is None else verification.noted(self.model)
        model.save(path)

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
            polars or pandas, or `PreparedRecording.from_arrays`.
        columns: names and units of their columns, if not the default ones, and loads that are
            held: one mapping for all recordings, or a sequence with one each (None for the default
            names). Arrays with units of their own keep these.
        settings: method, regulariser, γ, filter, friction laws.
        progress: called with a sentence before each stage.

    Raises:
        RecordingError: a log cannot be used.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, robot = settings or Settings(), load_robot(robot)
    kinematics = compiled(robot).kinematics
    recordings = open_recordings(
        logs, kinematics, columns, settings.cutoff, progress, keep_all=settings.keep_all
    )
    first = Setup(robot, tuple(recording.excerpted() for recording in recordings), settings)
    setup, problem = _fitted(first, progress)
    moves = () if setup.outcome is None else setup.outcome.moves
    moves = (*moves, *_moves_of_laws(setup, robot.friction, problem), *moves_of_scale(problem))
    *moves, undetected = (of_laws(move, setup.robot) for move in (*moves, setup.undetected))
    problem = replace(problem, moves=tuple(moves), undetected=undetected)
    problem = with_geometry(problem, setup.recordings)
    return _identification(setup, with_widened_prior(problem, setup.recordings), progress)


def _identification(setup: Setup, problem: FittedProblem, progress: Progress) -> Identification:
    """The model of a fit, with its torque errors on the recordings."""
    additions, judged = setup.additions, judged_parameters(freed(problem))
    added = judged[len(problem.p) :]
    loads = identified_loads(additions, added, held_loads(setup.recordings))
    effects = fitted_effects(additions, added)
    carried = {load.name: load.p for load in loads}
    recordings = tuple(unloaded(r, carried).repaired(pulls=effects) for r in setup.recordings)
    progress("comparing torques")
    compared = [recording.sparser(MOST_WINDOWS) for recording in recordings]
    errors = [torque_error(setup.dynamics, problem.p, recording) for recording in compared]
    corrections = (
        correction
        for addition, parameters in split_by_addition(additions, added)
        for correction in addition.to_corrections(parameters)
    )
    rows = zip(recordings, problem.used, errors, strict=True)
    model = assembled(
        problem,
        _mean(errors, problem.used),
        judged,
        loads=loads,
        corrections=(*setup.corrections, *corrections),
        sources=tuple(source(*row, setup.robot.drives) for row in rows),
        remarks=[f"{r.path}: {text}" for r in recordings for text in r.log.warnings],
        outcome=setup.outcome,
    ).changed(
        readings=recordings[0].repairs.readings,
        effects=tuple(effect.addition.record(effect.values) for effect in effects),
        friction_choice=setup.friction_choice,
    )
    return Identification(model, problem, recordings, _unchanged(setup), setup.detected)


def _fitted(first: Setup, progress: Progress) -> tuple[Setup, FittedProblem]:
    """The confirmed fit of a setup; without load friction if that was only chosen and does not
    settle."""
    try:
        return _confirmed(first, progress)
    except UnsettledFrictionError:
        if first.robot.load_drives:
            raise
        barred = first.barred | {(joint, "load") for joint in first.robot.friction}
        return _confirmed(first.changed(barred=barred), progress)


def _confirmed(
    first: Setup, progress: Progress, corrected: Setup | None = None
) -> tuple[Setup, FittedProblem]:
    """The fit of a setup after all stages, repeated until it puts no friction term and no effect at
    zero.

    Args:
        corrected: the setup before friction laws are chosen, if known already.
    """
    # Barred terms change nothing before laws are chosen.
    corrected = corrected or run_stages(first, progress, before=chosen_friction)
    corrected = corrected.changed(barred=first.barred)
    setup = run_stages(corrected, progress, first=chosen_friction)
    problem = fit(setup.dynamics, setup.recordings, setup.settings, progress, setup.additions)
    needless = idle(setup, problem)
    barred, effects = first.barred | needless.terms, first.barred_effects | needless.effects
    if effects != first.barred_effects:
        return _confirmed(first.changed(barred=barred, barred_effects=effects), progress)
    if barred != first.barred:
        return _confirmed(first.changed(barred=barred), progress, corrected)
    return setup, problem


def _moves_of_laws(
    setup: Setup, described_friction: Mapping[str, Friction], problem: FittedProblem
) -> tuple[dict[str, float], ...]:
    """Changes of parameters, by name, with the described friction laws, where the contest is
    refuted: chosen laws may absorb a part of an unknown effect."""
    robot = setup.robot.changed(friction=described_friction)
    if not (setup.outcome and setup.outcome.is_refuted) or setup.robot == robot:
        return ()
    plain = setup.without(LawConstants).with_robot(robot)
    p = fit(plain.dynamics, plain.recordings, plain.settings, additions=plain.additions).p
    values = plain.dynamics.layout.named(p)
    own = setup.dynamics.layout.named(problem.p)
    return ({name: values.get(name, 0.0) - value for name, value in own.items()},)


def _unchanged(setup: Setup) -> tuple[Study | None, ...]:
    """Studies of recordings that were not corrected since; initial lags may have been dropped."""
    if setup.corrections or setup.additions or setup.robot.load_drives or not setup.studies:
        return ()
    return tuple(
        study if study and study.fit.trace.recording.repairs == recording.repairs else None
        for study, recording in zip(setup.studies, setup.recordings, strict=True)
    )


def _mean(errors: Sequence[TorqueError], weights: Sequence[int]) -> TorqueError:
    def mean(quantities: Iterable[np.ndarray]) -> np.ndarray:
        return np.average(list(quantities), axis=0, weights=weights)

    rms = np.sqrt(mean(e.rms**2 for e in errors))
    torques = (e.rms / np.where(e.nrmse > 0, e.nrmse, 1.0) for e in errors)
    torque = np.sqrt(mean(torque**2 for torque in torques))
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(mean(e.rms_unfiltered**2 for e in errors)),
        covariance=mean(e.covariance for e in errors),
        turning=mean(e.turning for e in errors),
        cutoff=errors[0].cutoff,
        fastest=np.max([e.fastest for e in errors], axis=0),
    )
