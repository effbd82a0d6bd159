"""A motion to run on the machine: from rest, through whole periods, back to rest; and its file.

A run follows the periodic motion z(φ) with a phase φ(t) whose rate σ = φ̇ rises smoothly from 0 to 1
and falls back to 0 at the end, so ż = z′σ and z̈ = z″σ² + z′σ̇. Position, velocity and acceleration
join without a step, at both ends everything is at rest, and the path is the one whose limits were
checked. σ = 10 s³ − 15 s⁴ + 6 s⁵ with s = t / ramp.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.files import write_csv
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.one_or_many import numbered, one_or_many_times
from deltaid.motion.excitation.problem import ExcitationProblem
from deltaid.motion.fourier import FourierMotion
from deltaid.recording.source import BATCH_ROWS
from deltaid.shown import Shown

# Ramps are tried as shares of the period, the shortest first, from so many phases of the motion.
_RAMPS, _PHASES = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0), 40
# Use that counts as full on these points: the rest is for what lies between them.
_FULL = 0.9998


@dataclass(frozen=True, repr=False)
class Run(Shown):
    """A motion from rest to rest.

    Attributes:
        motion: the periodic motion.
        phase: time on the periodic motion at which its first whole period starts [s].
        ramp: duration of either ramp [s].
        repeats: number of whole periods between the ramps.
    """

    motion: FourierMotion
    phase: float
    ramp: float
    repeats: int

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return 2 * self.ramp + self.repeats * self.motion.period

    @one_or_many_times
    def evaluate(
        self, time: Float[np.ndarray, " samples"]
    ) -> tuple[Float[np.ndarray, "samples coordinates"], ...]:
        """z, ż, z̈ at times between 0 and `duration`."""
        falling = self.duration - time
        s, up = np.minimum(np.minimum(time, falling), self.ramp) / self.ramp, time <= falling
        # ∫σ ds, σ and dσ/ds of the ramp at s in [0, 1]
        covered, rate = 2.5 * s**4 - 3 * s**5 + s**6, 10 * s**3 - 15 * s**4 + 6 * s**5
        slope = 30 * s**2 * (1 - s) ** 2
        # Distance on the phase from the start of the first whole period.
        ramped, whole = self.ramp * (covered - 0.5), self.repeats * self.motion.period
        inner = np.clip(time - self.ramp, 0.0, whole)
        phase = self.phase + inner + np.where(up, np.minimum(ramped, 0), np.maximum(-ramped, 0))
        z, z_1, z_2 = self.motion.evaluate(phase)
        rate, change = rate[:, None], (np.where(up, 1, -1) * slope / self.ramp)[:, None]
        return z, z_1 * rate, z_2 * rate**2 + z_1 * change


def plan_run(problem: ExcitationProblem, motion: FourierMotion, repeats: int) -> Run:
    """The run with the shortest ramps that keep all limits.

    Raises:
        DeltaidError: no ramp of up to two periods keeps them.
    """
    phases, best = np.arange(_PHASES) * motion.period / _PHASES, np.inf
    for share, phase in product(_RAMPS, phases.tolist()):
        run = Run(motion, phase, share * motion.period, repeats)
        ramp = np.linspace(0.0, run.ramp, num=400)
        use = float(run_use(problem, run, np.append(ramp, run.duration - ramp)).max())
        if use <= _FULL:
            return run
        best = min(best, use)
    raise DeltaidError(
        f"the motion cannot be reached from rest within its limits: at best a limit is exceeded by "
        f"{100 * (best - 1):.2g} %",
        where="drive_limits",
        cure="leave some room in the torque limits of the description",
    )


def run_use(
    problem: ExcitationProblem, run: Run, time: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, " limits"]:
    """Largest use of every limit at some times of a run [s]."""
    return problem.use_of(np.hstack(run.evaluate(time)).T).max(axis=1)


# The longest run [s], ten hours, and the most rows of a file, some ten gigabytes.
LONGEST, MOST_ROWS = 36_000.0, 3e7


def run_rows(run: Run, rate: float) -> int:
    """Number of rows of a run at a fixed rate."""
    return int(np.ceil(run.duration * rate - 1e-9)) + 1


def sample_run(
    kinematics: Kinematics, run: Run, rate: float, rows: range | None = None
) -> pl.DataFrame:
    """A run at a fixed rate: columns t, q1…, qd1…, qdd1…, x, y, z (and psi), SI units.

    The first and the last row are at rest.
    """
    time = np.array(range(run_rows(run, rate)) if rows is None else rows) / rate
    z, zd, zdd = run.evaluate(np.minimum(time, run.duration))
    q, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    task = dict(zip(kinematics.robot.task.names, z.T, strict=True))
    return pl.DataFrame({"t": time} | numbered(q=q, qd=qd, qdd=qdd) | task)


def write_run(kinematics: Kinematics, run: Run, rate: float, path: Path) -> None:
    """Write a run as CSV, whole or not at all, in constant memory.

    Raises:
        DeltaidError: the file cannot be written.
    """
    rows = run_rows(run, rate)
    parts = (
        sample_run(kinematics, run, rate, range(start, min(start + BATCH_ROWS, rows)))
        for start in range(0, rows, BATCH_ROWS)
    )
    write_csv(path, parts)
