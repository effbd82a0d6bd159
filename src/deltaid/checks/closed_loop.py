"""Encoder noise that the controller feeds back as torque, and whether it shakes the drives.

A controller responds to a position error n with the torque −(K + D s) n, which is recorded as well.
Above the motion's frequencies torque and position then correlate, but unlike torque and motion:
τ = M q̈ has the gain M ω², the controller's is far below because its bandwidth is. This torque is
real; it shakes the drive with the speed τ / (M ω). Where that is as fast as the motion, friction
reverses in samples whose filtered positions do not show it: friction near reversals comes out too
small, and inertia absorbs the difference.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import Evidence, RawRows
from deltaid.estimation.scatter import CHANCE
from deltaid.estimation.spectra import segments
from deltaid.identification.fit import FittedProblem
from deltaid.identification.study import Study
from deltaid.model.verdict import Fault, Verdict, graded, percent
from deltaid.recording.recording import PreparedRecording

# Rows of a segment of the spectra, and least number of segments.
_LENGTH, SEGMENTS = 512, 8
# Ends of the inspected band: multiple of the positions' cut-off, and share of the rate.
_ABOVE, _BELOW = 2.0, 0.4
# Share of samples with an undetected friction reversal that biases parameters: 0.8 % biased
# friction by 0.4 %, 2.4 % by 5 %.
_DOUBTFUL, _WRONG = 0.007, 0.02


@dataclass(frozen=True, eq=False)
class Shake:
    """Effect of fed-back noise on the drives: standard deviations of speeds [rad/s or m/s] and of
    torques that correlate with position noise [N m or N], 0 where there is none; and the share of
    samples in which it reverses a drive's speed."""

    speed: Float[np.ndarray, " dof"]
    torque: Float[np.ndarray, " dof"]
    reversed: Float[np.ndarray, " dof"]


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_feedback(evidence: Evidence) -> Iterator[Verdict]:
    """Verdict on encoder noise that a controller feeds back to the drives; none if undetectable."""
    recording, fitted, study = evidence.surveyed, evidence.fitted, evidence.study
    if recording is None or study is None or not isinstance(fitted, FittedProblem):
        return
    shake = encoder_feedback(evidence.rows, recording, fitted, study)
    if shake is None or not shake.speed.any():
        return
    worst = int(np.argmax(shake.reversed))
    drive, share = evidence.robot.drives[worst], float(shake.reversed[worst])
    unit, fault = evidence.robot.drive_units[drive], Fault("closed-loop", "%")
    yield fault.judged(
        f"noise of the encoder comes back as torque, {shake.torque[worst]:.2g} {unit.force} and "
        f"{shake.speed[worst]:.2g} {unit.speed} of {drive}; it turns round the joint in "
        f"{percent(share)} of the samples",
        drive,
        100 * share,
        grade=graded(share, _DOUBTFUL, _WRONG),
        cause="coarse or noisy positions, differentiated by the controller, shake the drives: "
        "friction near rest is averaged away, and inertia takes its part",
        cure="lower the controller's gains or the cut-off of its speed for this recording, or use "
        "the motor's encoder; intervals do not hold this",
    )


def encoder_feedback(
    rows: RawRows, recording: PreparedRecording, fitted: FittedProblem, study: Study
) -> Shake | None:
    """Speeds and torques by fed-back noise; None with too few rows or too low a rate."""
    rate, dynamics = 1.0 / rows.step, fitted.dynamics
    if len(rows.q) - 2 < SEGMENTS * _LENGTH:
        return None
    # Second differences keep the motion from leaking upwards; their gain is divided out below.
    differences = (np.diff(x, 2, axis=0) for x in (rows.q, rows.tau))
    (frequency, q), (_, tau) = (segments(x, rate, _LENGTH, _LENGTH) for x in differences)
    low = _ABOVE * (recording.motion_cutoff or recording.log.motion_cutoff or 0.0)
    band = (frequency > low) & (frequency < _BELOW * rate)
    if not band.any():
        return None
    q, tau, omega = q[:, :, band], tau[:, :, band], 2 * np.pi * frequency[band]
    gain = (2 * np.sin(0.5 * omega / rate)) ** 4
    squares = np.abs(q) ** 2, np.abs(tau) ** 2, np.conj(q) * tau
    qq, tt, qt = (np.mean(square, axis=0) / gain for square in squares)
    home = dynamics.kinematics.inverse(dynamics.kinematics.home[None])
    answer = np.abs(np.linalg.inv(dynamics.mass_matrix(home, fitted.p)[0]))
    tiny = np.finfo(float).tiny
    coherence = np.abs(qt) ** 2 / np.maximum(qq * tt, tiny)
    weak = np.abs(qt) / np.maximum(qq, tiny) < 0.5 * omega**2 / np.diag(answer)[:, None]
    # γ² of independent noise is exponential with the mean 1/K for K segments.
    torque = np.where(weak & (coherence > -np.log(CHANCE) / len(q)), coherence * tt, 0.0)
    speed = np.sqrt(frequency[1] * answer**2 @ np.sum(torque / omega**2, axis=1))
    stretches = study.fit.trace.stretches
    speeds = np.concatenate([stretch.qd for stretch in stretches])
    counted = np.concatenate([stretch.weights for stretch in stretches]) > 0
    turned = ndtr(-np.abs(speeds) / np.where(speed > 0, speed, np.inf)) * (speed > 0) * counted
    reversed_ = turned.sum(axis=0) / np.maximum(counted.sum(axis=0), 1)
    return Shake(speed, np.sqrt(frequency[1] * torque.sum(axis=1)), reversed_)
