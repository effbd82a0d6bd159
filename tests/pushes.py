"""Recordings of oracle robots that something pushes, with what is true of it, and the events
that are excluded from them."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.identification.events import events, on_time
from deltaid.identification.expectation_source import ExplainedRecording
from deltaid.recording.memory import Recording
from deltaid.recording.recording import open_recordings
from deltaid.recording.repairs import LeftSpan
from deltaid.robot.load import load_robot
from faults.case import Case, Setting
from oracle.tree import Array
from plants import GRID, random_plant


@dataclass(frozen=True)
class Force:
    """A force on the platform [N], a half sine over time [s]."""

    start: float
    end: float
    force: tuple[float, float, float]

    @property
    def middle(self) -> float:
        """When it is largest."""
        return 0.5 * (self.start + self.end)

    def share(self, time: Array) -> Array:
        """Of the largest, at some times."""
        inside = (time >= self.start) & (time <= self.end)
        return inside * np.sin(np.pi * (time - self.start) / (self.end - self.start))


@cache
def moving(name: str, seed: int = 0, rate: float = 500.0, noise: float = 0.01) -> Setting:
    """A catalogue robot with random true bodies that moves for ten seconds, never at rest."""
    rng, robot = np.random.default_rng([seed, 5]), load_robot(name)
    plant = random_plant(robot, rng, 4.1, 5, 0.9)
    turn = [0.03 if robot.is_linear(drive) else 2 * np.pi for drive in robot.drives]
    return Setting(plant, 4.1, 5, 10.0, rate, (), np.array(turn) / 2**20, noise, False, seed)


def places(setting: Setting, time: Array) -> Array:
    """Task coordinates at some times, by the path's Fourier series."""
    waves = np.fft.fft(setting.plant.path, axis=0) / GRID
    order = np.fft.fftfreq(GRID, 1 / GRID)
    phase = 2 * np.pi * time / setting.period
    return np.real(np.exp(1j * np.outer(phase, order)) @ waves)


def torques(setting: Setting, forces: tuple[Force, ...]) -> Array:
    """What drives need more to go on against forces on the platform: Jᵀ τ + F = 0."""
    time, oracle = setting.time, setting.plant.oracle
    out = np.zeros_like(setting.truth.tau)
    for force in forces:
        at = np.flatnonzero(force.share(time))
        z = places(setting, time[at])
        F = np.zeros((len(at), z.shape[1], 1))
        F[:, :3, 0] = np.outer(force.share(time[at]), force.force)
        out[at] -= np.linalg.solve(oracle.jacobian(z).transpose(0, 2, 1), F)[:, :, 0]
    return out


def recorded(setting: Setting, more: Array | float = 0.0, lag: float = 0.0) -> Recording:
    """What sensors make of a motion, with further torques of the drives, all of them late [s]."""
    columns, time = setting.sensed(), setting.time
    more = np.broadcast_to(more, columns["tau"].shape)
    more = np.transpose([np.interp(time - lag, time, x) for x in more.T])
    tau = columns["tau"] + setting.truth_at(time - lag).tau - setting.truth.tau + more
    table = Case(load_robot("clavel-delta3"), columns | {"tau": tau}, setting).table
    return Recording.from_table(table, name="pushed")


def spans_left_out(name: str, log: Recording) -> tuple[LeftSpan, ...]:
    """Events that are excluded from a recording of a catalogue robot."""
    dynamics = compiled(load_robot(name))
    (recording,) = open_recordings(log, dynamics.kinematics)
    expected = on_time(ExplainedRecording(dynamics, (), recording))
    assert expected is not None
    return events(expected)
