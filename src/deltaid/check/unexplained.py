"""What a study leaves of a recording's torques, at the full rate."""

import numpy as np
from jaxtyping import Float

from deltaid.check.spectra import white_noise
from deltaid.identification.study import Study
from deltaid.recording.windows import Samples


def unexplained(study: Study) -> Float[np.ndarray, "samples dof"]:
    """Torques less those of the model, of the longest stretch, nothing put back or filtered."""
    w, dynamics = longest(study), study.fit.trace.dynamics
    left = w.tau - dynamics.torque(w.z, w.qd, w.qdd, study.fit.p)
    return np.where(w.weights > 0, left, 0.0)


def longest(study: Study) -> Samples:
    """The longest stretch without a gap."""
    return max(study.fit.trace.stretches, key=lambda one: len(one.time))


def largest_torques(study: Study) -> Float[np.ndarray, " dof"]:
    """Of the model, each drive's."""
    return np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)


def white_share(study: Study) -> Float[np.ndarray, " dof"]:
    """What white noise of the torques would leave after the filter."""
    low_pass = study.fit.trace.low_pass
    return white_noise(unexplained(study), low_pass.rate) * low_pass.noise_gain
