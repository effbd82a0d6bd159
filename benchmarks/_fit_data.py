"""What the fits of `fit.py` are given: factors of recordings of a robot whose truth is known."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.information import Information, gather_samples, merge
from deltaid.identification.demo import mass_matrix_error
from deltaid.identification.gathering import gather
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.inertia import pseudo_inertia

DURATION, RATE = 20.0, 1000.0


@dataclass(frozen=True)
class Truth:
    """The surrogate robot, and the motion along which mass matrices are compared."""

    dynamics: Dynamics
    p: np.ndarray
    motion: FourierMotion

    def errors(self, p: np.ndarray) -> tuple[float, float, float]:
        """Errors [%] of M on and off the diagonal, and of friction, as the largest of each."""
        z, _, _ = self.motion.evaluate(np.linspace(0, self.motion.period, 500))
        diagonal, off_diagonal = mass_matrix_error(self.dynamics, z, self.p, p)
        layout = self.dynamics.layout
        friction = slice(layout.viscous.start, layout.coulomb.stop)
        worst = float(np.max(np.abs(p[friction] / self.p[friction] - 1)))
        return 100 * diagonal, 100 * off_diagonal, 100 * worst


def recorded(
    dynamics: Dynamics,
    p: np.ndarray,
    motion: FourierMotion,
    rng: np.random.Generator,
    noise: SensorNoise | None,
) -> Information:
    """The factors of a recording, which goes through a file as any other."""
    recording = simulate_recording(
        dynamics, p, motion, rng, duration=DURATION, rate=RATE, noise=noise
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        write_recording(recording, path)
        log = open_log(path, dynamics.kinematics)
        return merge(gather(dynamics, with_filter(log)))


def impossible(dynamics: Dynamics, p: np.ndarray, motion: FourierMotion) -> Information:
    """The factors of torques that no robot produces: all friction and rotor inertias negative,
    centres of mass further out than their bodies' radii of gyration."""
    p, layout = p.copy(), dynamics.layout
    for body in layout.bodies:
        part = layout.body(body)
        length = np.sqrt(np.trace(pseudo_inertia(p[part])[:3, :3]) / p[part][0])
        free = [entry in dynamics.robot.bodies[body].free for entry in ("mcx", "mcy", "mcz")]
        p[part][1:4] += np.where(free, 2 * p[part][0] * length, 0.0)
    p[layout.viscous.start :] *= -1
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 1000, endpoint=False))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    return gather_samples(dynamics, z, qd, qdd, dynamics.torque(z, qd, qdd, p))
