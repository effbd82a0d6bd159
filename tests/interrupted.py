"""Recordings that hold more than motion under power: rest, brakes, stops, clipping, stale rows.

A robot runs along a random motion whose phase halts where it is to rest. All that comes on top is
put in by hand, so the rows are known.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.scatter import inverse
from deltaid.identification.identify import identify
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import Mask
from deltaid.recording.masks.search import MaskSearch, timed
from deltaid.recording.opening import open_log
from deltaid.recording.time.clock import Clock
from deltaid.robot.load import load_robot
from logs import tabled, write
from support import largest_mass_error


@dataclass(frozen=True)
class Interrupted:
    """A recording before its sensors: evenly spaced rows.

    Attributes:
        rate: of the rows [Hz].
        truth: parameters.
        q, tau: positions and torques.
        spans: what was put in: reason, first and last row.
    """

    dynamics: Dynamics
    rate: float
    truth: np.ndarray
    z: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    spans: tuple[tuple[str, int, int], ...] = ()

    def rows(self, start: float, end: float) -> slice:
        """Rows of a time."""
        return slice(round(start * self.rate), round(end * self.rate))

    def without_torque(self, reason: str, start: float, end: float) -> "Interrupted":
        """The drives are off."""
        tau, rows = self.tau.copy(), self.rows(start, end)
        tau[rows] = 0.0
        return replace(self, tau=tau, spans=(*self.spans, (reason, rows.start, rows.stop - 1)))

    def measured(
        self, rng: np.random.Generator, bits: int, noise: float, gear: float = 1.0
    ) -> "Interrupted":
        """By encoders of so many bits behind a gear, and torque noise as a share of the largest."""
        step = 2 * np.pi / 2**bits / gear
        largest = np.abs(self.tau).max(axis=0)
        tau = self.tau + noise * largest * rng.standard_normal(self.tau.shape)
        return replace(self, q=step * np.round(self.q / step), tau=tau)

    def clipped(self, share: float) -> "Interrupted":
        """Every torque channel ends at a share of its largest torque."""
        limit = share * np.abs(self.tau).max(axis=0)
        return replace(self, tau=np.clip(self.tau, -limit, limit))

    def stale(self, first: int, last: int) -> "Interrupted":
        """The logger repeats the row before."""
        q, tau = self.q.copy(), self.tau.copy()
        q[first : last + 1], tau[first : last + 1] = q[first - 1], tau[first - 1]
        return replace(self, q=q, tau=tau, spans=(*self.spans, ("stale rows", first, last)))

    @property
    def frame(self) -> pl.DataFrame:
        """As a table."""
        return tabled(t=np.arange(len(self.q)) / self.rate, q=self.q, tau=self.tau)


def interrupted(
    name: str,
    rng: np.random.Generator,
    *,
    rate: float = 1000.0,
    seconds: float = 10.0,
    rests: tuple[tuple[float, float], ...] = (),
    ramp: float = 0.15,
    braking: float = 0.0,
    slowly: float = 1.0,
) -> Interrupted:
    """A random motion that rests at some times, by start and end [s].

    Args:
        ramp: time in which it comes to rest, before and after [s].
        braking: if positive, time in which brakes stop it before each rest [s], beginning with a
            jump of the acceleration, the drives off until the rest is nearly over.
        slowly: how many times slower than the machine can move.
    """
    dynamics = compiled(load_robot(name))
    robot, kinematics = dynamics.robot, dynamics.kinematics
    truth, motion = surrogate_parameters(robot, rng), random_motion(kinematics, rng)
    fine = 4
    t = np.arange(round(seconds * rate) * fine) / (rate * fine)
    pace = np.ones_like(t)
    for start, end in rests:
        # 0 from start to end, with four continuous derivatives.
        x = np.clip(np.maximum((start - t) / ramp, (t - end) / ramp), 0, 1)
        smooth = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
        if braking:
            smooth = np.where(t < start, np.clip((start - t) / braking, 0, 1), smooth)
        pace = np.minimum(pace, smooth)
    between = 0.5 * (pace[1:] + pace[:-1])
    phase = np.cumsum(np.append(0.0, between))[::fine] / (rate * fine) / slowly
    pace = pace[::fine] / slowly
    change = np.gradient(pace, 1 / rate)
    z, z_1, z_2 = motion.evaluate(phase)
    zd, zdd = z_1 * pace[:, None], z_2 * pace[:, None] ** 2 + z_1 * change[:, None]
    q, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, truth)
    spans = []
    for start, end in rests:
        rows = slice(max(0, round(start * rate)), round(end * rate))
        # Friction at rest: anything up to the Coulomb friction.
        tau[rows] += rng.uniform(-0.5, 0.5, dynamics.dof) * _coulomb(dynamics, truth)
        spans.append(("standing still", rows.start, min(rows.stop, len(q)) - 1))
    recording = Interrupted(dynamics, rate, truth, z, q, tau, tuple(spans))
    for start, end in rests if braking else ():
        recording = recording.without_torque("emergency stop", start - braking, end - 0.1)
    return recording


def _coulomb(dynamics: Dynamics, p: np.ndarray) -> np.ndarray:
    values = dict(zip(dynamics.layout.names, p, strict=True))
    return np.array([values[f"coulomb.{drive}"] for drive in dynamics.robot.drives])


def mass_error(recording: Interrupted, p: np.ndarray) -> float:
    """Largest |ΔM_ij| / √(M_ii M_jj) along the motion."""
    z = recording.z[:: max(1, len(recording.z) // 40)]
    q = recording.dynamics.kinematics.inverse(z)
    return largest_mass_error(*(recording.dynamics.mass_matrix(q, x) for x in (p, recording.truth)))


@dataclass(frozen=True)
class Cost:
    """What masks make of a clean recording.

    Attributes:
        lost: share of the rows that is left out.
        known_less: standard deviations of base parameters, masked over all rows, if the noise were
            the same.
        widths: of the intervals of parameters that data decides, masked over all rows.
        errors: of M, all rows and masked.
    """

    lost: float
    known_less: np.ndarray
    widths: np.ndarray
    errors: tuple[float, float]


# Bits of the encoders, one a seed.
BITS = (12, 14, 16, 17, 18, 20)


def cost_of_masks(name: str, rate: float, seed: int, settings: Settings | None = None) -> Cost:
    """A clean recording identified with all rows, and with what is left of them."""
    rng = np.random.default_rng([seed, round(rate), len(name)])
    recording = interrupted(name, rng, rate=rate, seconds=8.0)
    recording = recording.measured(rng, BITS[seed % len(BITS)], 0.02, 10.0 if seed % 2 else 1.0)
    settings = settings or Settings()
    both = [settings.changed(keep_all=keep) for keep in (True, False)]
    fits = [identify(name, recording.frame, settings=each) for each in both]
    all_rows, masked = (uncertainty(fit.problem) for fit in fits)
    determined = [known_to.std < 0.5 * known_to.prior_std for known_to in (all_rows, masked)]
    shown = determined[0] & determined[1] & (all_rows.interval > 0)
    roots = (fit.problem.estimate.noise.root for fit in fits)
    known = [np.linalg.norm(inverse(root), axis=1) for root in roots]
    return Cost(
        lost=sum(stretch.share for stretch in fits[1].model.sources[0].left_out),
        known_less=known[1] / known[0],
        widths=masked.interval[shown] / all_rows.interval[shown],
        errors=(mass_error(recording, fits[0].model.p), mass_error(recording, fits[1].model.p)),
    )


CLAVEL, IRB = "clavel-delta3", "irb360-6-1600"


def opened(recording: Interrupted, folder: Path, **options: bool) -> Log:
    path = write(folder / "log.parquet", recording.frame)
    return open_log(path, recording.dynamics.kinematics, **options)


def searched(recording: Interrupted, size: int = 1 << 16) -> tuple[Mask, ...]:
    """Masks by rule, without the rest of the survey."""
    search = MaskSearch(recording.dynamics.dof, [np.inf] * recording.dynamics.dof)
    rows = recording.frame.to_numpy()
    for start in range(0, len(rows), size):
        search.add(rows[start : start + size], 1 / recording.rate)
    clock = Clock(1 / recording.rate, len(rows), 0.0, (len(rows) - 1) / recording.rate)
    return timed(search.runs(), clock)


def by_hand(log: Log, *spans: tuple[tuple[int, ...], int, int]) -> Log:
    """A log without some drives' rows."""
    masks = (Mask("standing still", drives, a, b, 0.0, 0.0) for drives, a, b in spans)
    return replace(log, masks=tuple(masks), keep_all=True)
