"""How well a model predicts the torques of a recording, drive by drive, in constant memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Window


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
    """Measured and predicted torques of consecutive samples, and the drives' speeds there.

    Those through the filter are of every `Recording.stride`-th sample, from the first one on.
    """

    time: Float[np.ndarray, " samples"]
    speed: Float[np.ndarray, "samples dof"]
    measured: Float[np.ndarray, "samples torques"]
    predicted: Float[np.ndarray, "samples dof"]
    filtered_measured: Float[np.ndarray, "apart torques"]
    filtered_predicted: Float[np.ndarray, "apart dof"]


def predict(dynamics: Dynamics, p: Parameters, recording: Recording) -> Iterator[Prediction]:
    """Predicted torques along a recording, window by window.

    With a filter, its length is lost at either end of the recording.
    """
    return recording.evaluate(dynamics.kinematics, lambda window: _prediction(dynamics, p, window))


def _prediction(dynamics: Dynamics, p: Parameters, window: Window) -> Prediction:
    own, wide = window.own, window.wide
    predicted = dynamics.torque(wide.z, wide.qd, wide.qdd, p)
    smooth = window.smoothed(np.hstack([wide.tau, predicted]).T).T
    n = wide.tau.shape[1]
    return Prediction(
        own.time, own.qd, own.tau, window.trimmed(predicted), smooth[:, :n], smooth[:, n:]
    )


def torque_error(dynamics: Dynamics, p: Parameters, recording: Recording) -> TorqueError:
    """The torque errors of parameters p on a recording."""

    def sums(window: Window) -> tuple[np.ndarray, ...]:
        part = _prediction(dynamics, p, window)
        error = part.filtered_measured - part.filtered_predicted
        raw = np.sum((part.measured - part.predicted) ** 2, axis=0)
        counts = np.array([len(error), len(part.time)])
        return error.T @ error, np.sum(part.filtered_measured**2, axis=0), raw, counts

    dof = dynamics.dof
    totals = np.zeros((dof, dof)), np.zeros(dof), np.zeros(dof), np.zeros(2, dtype=int)
    for one in recording.evaluate(dynamics.kinematics, sums):
        for total, part in zip(totals, one, strict=True):
            total += part
    covariance, power, raw, (samples, all_samples) = totals
    rms = np.sqrt(np.diag(covariance) / samples)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.sqrt(power / samples),
        rms_unfiltered=np.sqrt(raw / all_samples),
        covariance=covariance / samples,
        cutoff=recording.cutoff,
    )


def prediction_csv(part: Prediction, *, header: bool) -> str:
    """Predicted torques as lines of CSV: t, tau1, tau2, …"""
    columns = {"t": part.time}
    columns |= {f"tau{i + 1}": part.predicted[:, i] for i in range(part.predicted.shape[1])}
    return pl.DataFrame(columns).write_csv(include_header=header)
