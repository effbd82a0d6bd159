"""Torque errors on recordings by their factors."""

from collections.abc import Sequence

import numpy as np

from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.information import Information
from deltaid.factors.alike import require_alike
from deltaid.factors.file import FactorFile
from deltaid.factors.merged import merged
from deltaid.factors.problem import merging_of
from deltaid.identification.load_columns import LoadColumns
from deltaid.identification.loads import known_load
from deltaid.identification.torque_error import TorqueError
from deltaid.model.model import ModelLike, load
from deltaid.model.record import Settings


def torque_errors(
    information: Information, values: Parameters, files: Sequence[FactorFile]
) -> TorqueError:
    """What parameters leave of the torques of all recordings, by their factors.

    What only unfiltered rows show, their noise, is what the recordings' own fits left of these.

    Args:
        information: of the recordings together.
        values: parameters of its columns.
        files: the same recordings.
    """
    own = information.drives
    rms, torque = information.rms(values)[own], information.torque_rms()[own]
    fits = [one.record.model.fit for one in files]
    weight = np.array([one.condensed.whole.samples.mean() for one in files])
    beyond = [np.square(one.rms_unfiltered) - np.square(one.rms) for one in fits]
    noise = np.average(beyond, axis=0, weights=weight)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(np.maximum(rms**2 + noise, 0.0)),
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=files[0].record.model.sources[0].cutoff_hz,
        fastest=np.max([one.record.fastest for one in files], axis=0),
    )


def validate_gathered(model: ModelLike, file: FactorFile) -> TorqueError:
    """Torque errors of a model on a recording by its factors, as of `deltaid.validate`.

    The recording's lags are put right as they were found in it by itself.

    Raises:
        RecordingError: the file is of another mechanism than the model, or holds a load that the
            model does not know.
    """
    known = load(model)
    require_alike([file], known.robot)
    merging = merging_of([file], known.robot, Settings())
    information = merged(merging, [file]).information
    more = [
        known_load(one, known, file.path or file.record.log) - one.taken
        if isinstance(one, LoadColumns) and one.parameters
        else np.zeros(len(one.parameters))
        for one in merging.additions
    ]
    return torque_errors(information, np.concatenate([known.p, *more]), [file])
