"""Pick and place: cycles of 0.9 s between random places, at rest where the gripper acts."""

from functools import lru_cache
from zlib import crc32

import numpy as np

from drives.happening import Span
from drives.robots import KINDS, Machine, machine, on_path
from oracle.tree import Array
from plants import GRID, Pace

# Number of cycles of a path; duration of a cycle and of a rest in it (s).
_CYCLES, _CYCLE, _REST = 8, 0.9, 0.05
_HOPS = 2 * _CYCLES


@lru_cache(maxsize=4)
def production_machine(kind: str, seed: int) -> Machine:
    """The robot of a kind and seed, on a path through pick and place positions."""
    m = machine(kind, seed)
    rng = np.random.default_rng([seed, crc32(kind.encode()), 7])
    centre, half = m.robot.within(0.0)
    if m.robot.task.turn is not None:
        turn = m.robot.turn
        half[m.robot.task.turn] = 0.4 * min(turn.high - turn.low, 2 * np.pi)
    phase = np.arange(GRID) * (2 * np.pi / GRID)
    for size in 0.55 * 0.85 ** np.arange(30):
        stops = rng.uniform(-1, 1, (_HOPS, m.dof)) * size
        stops[::2, 0] = -size + 0.3 * size * rng.uniform(-1, 1, _CYCLES)
        stops[1::2, 0] = size + 0.3 * size * rng.uniform(-1, 1, _CYCLES)
        path = centre + _through(stops, phase) * half
        path[:, 2] = centre[2] - size * half[2] * np.cos(_HOPS * phase)
        within = np.all(np.abs(path - centre) <= 1.05 * half + 1e-9)
        if within and np.all(np.isfinite(m.plant.oracle.positions(path))):
            period = _HOPS * 0.5 * _CYCLE
            return on_path(m.robot, m.plant.p, path, period, m.rate, rng)
    raise AssertionError(f"no pick and place for {KINDS[kind]}")


def _through(stops: Array, phase: Array) -> Array:
    """Fourier series through stops at even phases; its highest harmonic has no sine."""
    spectrum = np.fft.rfft(stops, axis=0) / len(stops)
    weight = np.full(len(spectrum), 2.0)
    weight[[0, -1]] = 1.0
    waves = np.exp(1j * np.outer(phase, np.arange(len(spectrum)))) * weight
    return np.real(waves @ spectrum)


def rhythm(time: Array) -> Pace:
    """Pace from stop to stop, with 50 ms of rest at each."""
    hop = 0.5 * _CYCLE
    moving = hop - _REST
    k = np.floor(time / hop)
    x = np.clip((time - k * hop) / moving, 0.0, 1.0)
    scale = 2 * np.pi / _HOPS
    return Pace(
        time,
        scale * (k + x**3 * (10 - 15 * x + 6 * x**2)),
        scale * 30 * x**2 * (1 - x) ** 2 / moving,
        scale * 60 * x * (1 - x) * (1 - 2 * x) / moving**2,
    )


def held_spans(duration: float) -> tuple[Span, ...]:
    """Spans in which a load is held, from the middle of the rest at a pick to that at the next
    place."""
    first = _CYCLE - 0.5 * _REST
    starts = np.arange(first, duration, _CYCLE)
    return tuple((float(s), float(s + 0.5 * _CYCLE)) for s in starts)
