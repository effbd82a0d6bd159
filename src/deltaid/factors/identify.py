"""`identify` and `validate` from factor files, without their recordings."""

from collections.abc import Sequence

import numpy as np

from deltaid.check.identified import Judged
from deltaid.check.verdicts import Verdicts
from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.information import Information
from deltaid.factors.corrections import (
    corrections,
    prepared,
    remarks,
    torque_constants,
    verdicts,
)
from deltaid.factors.file import FactorFile
from deltaid.factors.keys import require_alike
from deltaid.factors.merged import fitted, holding, merged, merging_of
from deltaid.identification.assembled import assembled
from deltaid.identification.friction_curves import freed
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.load_columns import LoadColumns
from deltaid.identification.loads import found_loads, known_load
from deltaid.identification.torque_error import TorqueError
from deltaid.model.model import ModelLike, load
from deltaid.model.record import Settings
from deltaid.robot.load import RobotLike, described


def identify_gathered(
    robot: RobotLike, files: Sequence[FactorFile], settings: Settings | None = None
) -> Judged:
    """Identify a robot from the factors of its recordings.

    What was corrected in each recording stays so. Friction laws are those of the description, or
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
    files, chosen = prepared(files, description, settings)
    gains = torque_constants(files)
    problem = fitted(files, chosen, settings)
    judged = judged_parameters(freed(problem))
    model = assembled(
        problem,
        settings,
        _torque_errors(problem.information, problem.values, files),
        judged,
        loads=found_loads(problem.additions, judged[len(problem.p) :], holding(files)),
        corrections=corrections(description, chosen, files),
        sources=tuple(file.record.model.sources[0] for file in files),
        remarks=remarks(files, gains),
    )
    return Judged(model, problem, (), (), Verdicts(verdicts(files)))


def validate_gathered(model: ModelLike, file: FactorFile) -> TorqueError:
    """Torque errors of a model on a recording by its factors, as of `deltaid.validate`.

    The recording's lags are corrected as they were found in it by itself.

    Raises:
        RecordingError: the file is of another mechanism than the model, or holds a load that the
            model does not know.
    """
    known = load(model)
    require_alike([file], known.robot)
    merging = merging_of([file], known.robot, Settings())
    more = [
        known_load(own, known, file.where) - own.taken
        if isinstance(own, LoadColumns) and own.parameters
        else np.zeros(len(own.parameters))
        for own in merging.additions
    ]
    information = merged(merging, [file]).information
    return _torque_errors(information, np.concatenate([known.p, *more]), [file])


def _torque_errors(
    information: Information, values: Parameters, files: Sequence[FactorFile]
) -> TorqueError:
    """What parameters leave of the torques of all recordings.

    What only unfiltered rows show, their noise, is what the recordings' own fits left of these.
    """
    drives = information.drives
    rms, torque = information.rms(values)[drives], information.torque_rms()[drives]
    fits = [file.record.model.fit for file in files]
    samples = [file.condensed.whole.samples.mean() for file in files]
    beyond = [np.square(fit.rms_unfiltered) - np.square(fit.rms) for fit in fits]
    noise = np.average(beyond, axis=0, weights=samples)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(np.maximum(rms**2 + noise, 0.0)),
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=files[0].record.model.sources[0].cutoff_hz,
        fastest=np.max([file.record.fastest for file in files], axis=0),
    )
