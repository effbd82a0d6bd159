"""The identification of a robot from factor files: `identify` without its recordings."""

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from deltaid.check.identified import Judged
from deltaid.check.verdict import Grade, Verdict
from deltaid.check.verdicts import Verdicts
from deltaid.factors.alike import require_alike
from deltaid.factors.file import FactorFile
from deltaid.factors.laws import asked_for
from deltaid.factors.merged import Merging, merged
from deltaid.factors.problem import columns_of, fitted
from deltaid.factors.record import SeenVerdict
from deltaid.identification.contradicted import contradicted
from deltaid.identification.doubts import doubts
from deltaid.identification.fit import FittedProblem, widened_priors
from deltaid.identification.friction_curves import freed, friction_curves
from deltaid.identification.judgement import (
    eigenvalues,
    judged_base,
    judged_parameters,
    record,
)
from deltaid.identification.load_columns import LoadColumns
from deltaid.identification.marginal import posterior_record
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.torque_scale import torque_scale
from deltaid.model.corrections import Correction
from deltaid.model.model import ModelLike, load
from deltaid.model.parameter_record import HeldLoad
from deltaid.model.parameter_record import Parameter as Judgement
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.robot.load import RobotLike, described


def identify_gathered(
    robot: RobotLike, files: Sequence[FactorFile], settings: Settings | None = None
) -> Judged:
    """Identify a robot from the factors of its recordings.

    What was put right in each recording stays so. Friction laws are those of the description, or
    what most of the recordings asked for.

    Args:
        robot: with priors, reductions and measured values of its own; its mechanism is that of the
            files.
        files: of recordings of the same robot.
        settings: method, regulariser, γ, prior's spread, friction.

    Raises:
        RecordingError: files do not go together, or not with the robot.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, description = settings or Settings(), described(robot)
    require_alike(files, description)
    files = sorted(files, key=lambda one: one.record.sha256)
    chosen = asked_for(description, files) if settings.friction == "choose" else description
    problem = fitted(files, chosen, settings)
    judged, own = judged_parameters(freed(problem)), len(problem.p)
    error = torque_errors(problem, files)
    found = Verdicts(_verdict(one) for file in files for one in file.record.verdicts)
    model = IdentifiedModel(
        deltaid=version("deltaid"),
        robot=chosen,
        parameters=judged[:own],
        base_parameters=judged_base(problem),
        consistency=eigenvalues(problem.layout, problem.p),
        fit=record(problem, error),
        settings=settings.changed(intervals="linear"),
        posterior=posterior_record(problem),
        loads=_loads(problem, judged[own:], files),
        corrections=(*_corrections(files), *widened_priors(problem)),
        friction_curves=friction_curves(problem, error.fastest),
        sources=tuple(one.record.model.sources[0] for one in files),
        warnings=(
            *(text for one in files for text in one.record.model.warnings),
            *doubts(problem),
            *contradicted(problem),
            *torque_scale(problem),
        ),
    )
    return Judged(model, problem, (), (), found)


def _verdict(seen: SeenVerdict) -> Verdict:
    """A verdict of the checks as it was."""
    return Verdict(
        key=seen.key,
        grade=Grade(seen.grade),
        seen=seen.seen,
        subject=seen.subject,
        cause=seen.cause,
        cure=seen.cure,
        number=seen.number,
        unit=seen.unit,
    )


def torque_errors(problem: FittedProblem, files: Sequence[FactorFile]) -> TorqueError:
    """What a fit leaves of the torques of all recordings, by their factors.

    What only unfiltered rows show, their noise, is what the recordings' own fits left of these.
    """
    information = problem.information
    rms = information.rms(problem.values)[information.drives]
    torque = information.torque_rms()[information.drives]
    fits = [one.record.model.fit for one in files]
    weight = np.array([one.condensed.whole.samples.mean() for one in files])
    beyond = [np.square(one.rms_unfiltered) - np.square(one.rms) for one in fits]
    raw = np.sqrt(np.maximum(rms**2 + np.average(beyond, axis=0, weights=weight), 0.0))
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=raw,
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=files[0].record.model.sources[0].cutoff_hz,
        fastest=np.max([one.record.fastest for one in files], axis=0),
    )


def validate_gathered(model: ModelLike, file: FactorFile) -> TorqueError:
    """Torque errors of a model on a recording by its factors, as of `deltaid.validate`.

    The recording's lags are put right as they were found in it by itself.

    Raises:
        RecordingError: the file is of another mechanism than the model.
    """
    known = load(model)
    require_alike([file], known.robot)
    merging = Merging(columns_of([file], known.robot), known.dynamics)
    information = merged(merging, [file]).information
    rms, torque = information.rms(known.p), information.torque_rms()
    fit = file.record.model.fit
    beyond = np.square(fit.rms_unfiltered) - np.square(fit.rms)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(np.maximum(rms**2 + beyond, 0.0)),
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=file.record.model.sources[0].cutoff_hz,
        fastest=np.array(file.record.fastest),
    )


def _corrections(files: Sequence[FactorFile]) -> tuple[Correction, ...]:
    """What was put right in each recording; friction laws and priors are the fit's own."""
    return tuple(
        one if one.log else one.changed(log=file.record.log)
        for file in files
        for one in file.record.model.corrections
        if one.kind not in ("friction", "prior", "load")
    )


def _loads(
    problem: FittedProblem, judged: Sequence[Judgement], files: Sequence[FactorFile]
) -> tuple[HeldLoad, ...]:
    """Loads with what the fit found of them."""
    found, first = list[HeldLoad](), 0
    for one in problem.additions:
        own = judged[first : first + len(one.parameters)]
        first += len(one.parameters)
        if isinstance(one, LoadColumns):
            name = one.load.name
            logs = tuple(
                file.record.log
                for file in files
                if any(load.load.name == name for load in file.record.loads)
            )
            found.append(HeldLoad(name=name, body=one.body, logs=logs, parameters=one.whole(own)))
    return tuple(found)
