"""Torque errors of a model on a recording, drive by drive, in constant memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock, Window
from deltaid.shown import Shown


@dataclass(frozen=True, repr=False)
class TorqueError(Shown):
    """Torque errors of a model on a recording, one number a drive.

    Attributes:
        rms: root mean square of measured minus predicted torque, both weighted and filtered; a
            sample counts for the part of its noise that the weights leave.
        nrmse: rms as a share of the measured torque's root mean square.
        rms_unfiltered: rms without the filter.
        covariance: mean of e eᵀ, of the filtered errors.
        turning: share of the samples that do not count because a joint turns round there.
        cutoff: the filter's cut-off [Hz]; None without a filter.
        fastest: largest speed [rad/s or m/s].
    """

    rms: Float[np.ndarray, " dof"]
    nrmse: Float[np.ndarray, " dof"]
    rms_unfiltered: Float[np.ndarray, " dof"]
    covariance: Float[np.ndarray, "dof dof"]
    turning: Float[np.ndarray, " dof"]
    cutoff: float | None
    fastest: Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class PredictedTorques:
    """Measured and predicted torques of consecutive samples, and the drives' speeds there.

    Filtered ones are multiplied by the weights first, and given for every `LowPass.stride`-th
    sample from the first on.

    Attributes:
        weights: of the samples.
        gain: the filtered weights, by which a constant torque is multiplied.
        counted: number of samples that each filtered one counts for (`Window.counted`).
    """

    time: Float[np.ndarray, " samples"]
    speed: Float[np.ndarray, "samples dof"]
    measured: Float[np.ndarray, "samples dof"]
    predicted: Float[np.ndarray, "samples dof"]
    weights: Float[np.ndarray, "samples dof"]
    filtered_measured: Float[np.ndarray, "apart dof"]
    filtered_predicted: Float[np.ndarray, "apart dof"]
    gain: Float[np.ndarray, "apart dof"]
    counted: Float[np.ndarray, "apart dof"]


def predict(
    dynamics: Dynamics, p: Parameters, recording: PreparedRecording
) -> Iterator[PredictedTorques]:
    """Measured and predicted torques along a recording, window by window.

    A filter loses its length at either end of the recording.
    """

    def predicted(window: Window) -> PredictedTorques:
        inner, wide = window.inner, window.wide
        tau = predicted_torques(dynamics, p, wide)
        torques = wide.weighted(np.hstack([wide.tau, tau]).T, np.tile(np.arange(dynamics.dof), 2))
        filtered_measured, filtered_predicted = np.split(window.smoothed(torques).T, 2, axis=1)
        counted = window.counted(window.low_pass.stride).T
        unweighted = bool(np.all(counted == 1.0))
        return PredictedTorques(
            time=inner.time,
            speed=inner.qd,
            measured=inner.tau,
            predicted=window.trimmed(tau),
            weights=inner.weights,
            filtered_measured=filtered_measured,
            filtered_predicted=filtered_predicted,
            gain=np.ones_like(counted) if unweighted else window.smoothed(wide.weights.T).T,
            counted=counted,
        )

    return recording.evaluate(dynamics.kinematics, predicted)


def predicted_torques(
    dynamics: Dynamics, p: Parameters, w: SampleBlock
) -> Float[np.ndarray, "samples dof"]:
    """Y p, and the change of load friction by held loads, Σ μ sign(q̇)(|x + x_L| − |x|).

    Other torques of loads have been subtracted from the recording.
    """
    tau, robot = dynamics.torque(w.z, w.qd, w.qdd, p), dynamics.robot
    if not w.carried.any() or not robot.load_drives:
        return tau
    x, friction = dynamics.carried(w.z, w.qd, w.qdd, p), p[dynamics.layout.friction]
    for term, mu in zip(robot.friction_terms, friction, strict=True):
        if term.of_load:
            i = robot.drives.index(term.joint)
            more = np.abs(x[:, i] + w.carried[:, i]) - np.abs(x[:, i])
            tau[:, i] += mu * np.sign(w.qd[:, i]) * more
    return tau


def torque_error(dynamics: Dynamics, p: Parameters, recording: PreparedRecording) -> TorqueError:
    """The torque errors of parameters p on a recording, by filtered samples as far apart as the
    cut-off allows."""
    dof = dynamics.dof

    def sums(window: Window) -> tuple[np.ndarray, ...]:
        inner, wide = window.inner, window.wide
        error = wide.tau - predicted_torques(dynamics, p, wide)
        torques = wide.weighted(np.hstack([error, wide.tau]).T, np.tile(np.arange(dof), 2))
        filtered, tau = np.split(window.smoothed(torques, thinned=True), 2)
        raw = np.sum((inner.weights * window.trimmed(error)) ** 2, axis=0)
        samples = (
            window.counted(recording.filter.thinned).sum(axis=1),
            np.sum(inner.weights**2, axis=0),
        )
        counts = np.stack([*samples, window.turning, np.full(dof, len(inner.time))])
        power = np.sum(tau**2, axis=1)
        return filtered @ filtered.T, power, raw, counts, np.abs(inner.qd).max(axis=0, initial=0.0)

    totals = np.zeros((dof, dof)), np.zeros(dof), np.zeros(dof), np.zeros((4, dof))
    fastest = np.zeros(dof)
    for *parts, speeds in recording.evaluate(dynamics.kinematics, sums):
        fastest = np.maximum(fastest, speeds)
        for total, part in zip(totals, parts, strict=True):
            total += part
    covariance, power, raw, (samples, raw_samples, turning, all_samples) = totals
    # A drive that rests all the time has no samples, and no error.
    samples, raw_samples = np.maximum(samples, 1.0), np.maximum(raw_samples, 1.0)
    rms = np.sqrt(np.diag(covariance) / samples)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.sqrt(np.where(power > 0, power, 1.0) / samples),
        rms_unfiltered=np.sqrt(raw / raw_samples),
        covariance=covariance / np.sqrt(np.outer(samples, samples)),
        turning=turning / all_samples,
        cutoff=recording.cutoff,
        fastest=fastest,
    )
