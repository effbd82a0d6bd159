"""How well a model predicts the torques of a recording, drive by drive, in constant memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.recording.filter import LowPass, apply
from deltaid.recording.log import Log
from deltaid.recording.windows import windows


@dataclass(frozen=True)
class TorqueError:
    """Torque errors of a model on a recording, one number a drive.

    Attributes:
        rms: root mean square of measured minus predicted, both through the recording's filter.
        nrmse: rms as a share of the measured torque's own root mean square.
        rms_unfiltered: the same against the torque as recorded.
        covariance: mean of e eᵀ over the samples, of the filtered errors.
        cutoff: the filter's cut-off [Hz]; None without a filter.
    """

    rms: Float[np.ndarray, " dof"]
    nrmse: Float[np.ndarray, " dof"]
    rms_unfiltered: Float[np.ndarray, " dof"]
    covariance: Float[np.ndarray, "dof dof"]
    cutoff: float | None


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted torques of consecutive samples, as recorded and through the filter,
    and the drives' speeds there."""

    time: Float[np.ndarray, " samples"]
    speed: Float[np.ndarray, "samples dof"]
    measured: Float[np.ndarray, "samples torques"]
    predicted: Float[np.ndarray, "samples dof"]
    filtered_measured: Float[np.ndarray, "samples torques"]
    filtered_predicted: Float[np.ndarray, "samples dof"]


def predict(
    dynamics: Dynamics, p: Parameters, log: Log, low_pass: LowPass | None
) -> Iterator[Prediction]:
    """Predicted torques along a recording, window by window.

    With a filter, its length is lost at either end of the recording.
    """
    for w in windows(log, dynamics.kinematics, low_pass):
        predicted = dynamics.torque(w.z, w.qd, w.qdd, p)
        if low_pass is None:
            yield Prediction(w.time, w.qd, w.tau, predicted, w.tau, predicted)
            continue
        half = len(low_pass.smooth) // 2
        inner = slice(half, len(w.time) - half)
        filtered = apply(low_pass.smooth, np.hstack([w.tau, predicted]).T).T
        n = w.tau.shape[1]
        yield Prediction(
            w.time[inner],
            w.qd[inner],
            w.tau[inner],
            predicted[inner],
            filtered[:, :n],
            filtered[:, n:],
        )


def torque_error(
    dynamics: Dynamics, p: Parameters, log: Log, low_pass: LowPass | None
) -> TorqueError:
    """The torque errors of parameters p on a recording."""
    dof = dynamics.dof
    covariance, power, raw, samples = np.zeros((dof, dof)), np.zeros(dof), np.zeros(dof), 0
    for part in predict(dynamics, p, log, low_pass):
        error = part.filtered_measured - part.filtered_predicted
        covariance += error.T @ error
        power += np.sum(part.filtered_measured**2, axis=0)
        raw += np.sum((part.measured - part.predicted) ** 2, axis=0)
        samples += len(error)
    rms = np.sqrt(np.diag(covariance) / samples)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.sqrt(power / samples),
        rms_unfiltered=np.sqrt(raw / samples),
        covariance=covariance / samples,
        cutoff=low_pass.cutoff if low_pass else None,
    )


def prediction_csv(part: Prediction, *, header: bool) -> str:
    """Predicted torques as lines of CSV: t, tau1, tau2, …"""
    columns = {"t": part.time}
    columns |= {f"tau{i + 1}": part.predicted[:, i] for i in range(part.predicted.shape[1])}
    return pl.DataFrame(columns).write_csv(include_header=header)
