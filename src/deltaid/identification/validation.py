"""Comparing a saved model with a recording that it has not seen."""

from pathlib import Path

from deltaid.dynamics.dynamics import compiled
from deltaid.identification.model import IdentifiedModel
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.recording.columns import ColumnMapping
from deltaid.recording.filter import LowPass
from deltaid.recording.log import Log, open_log
from deltaid.recording.windows import choose_filter


def validate(
    model: IdentifiedModel, log: str | Path, *, columns: ColumnMapping | None = None
) -> tuple[TorqueError, Log]:
    """Torque errors of a model on a recording it has not seen, and the surveyed recording.

    A recording without derivatives is filtered with the cut-off that the model was identified with.

    Raises:
        RecordingError: the log cannot be used.
    """
    dynamics = compiled(model.robot)
    surveyed = open_log(Path(log), dynamics.kinematics, columns)
    low_pass = model_filter(model, surveyed)
    return torque_error(dynamics, model.p, surveyed, low_pass), surveyed


def model_filter(model: IdentifiedModel, log: Log) -> LowPass | None:
    """The filter for a log that a model is compared with: the one of the model's own recordings.

    Raises:
        RecordingError: the cut-off does not go with the log's rate, or the log is too short.
    """
    own = next((s.cutoff_hz for s in model.sources if s.cutoff_hz is not None), None)
    forced = model.settings.cutoff is not None
    return choose_filter(log, own if forced or not log.has_derivatives else None)
