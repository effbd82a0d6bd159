"""A robot that goes to and fro between two places and takes a load at one of them.

Torques come from MuJoCo, with the parameters that the model was identified with. At rest friction
keeps the drives' torques as they are, so a load that is taken there shows once the robot moves.
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

import deltaid
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings
from oracle.tree import Array
from picking import picked
from plants import friction_of, oracle_of

RATE, ENCODER = 1000.0, 2 * np.pi / 2**20
# Rows of a stand before the grip, and rows of a move.
AHEAD, MOVE = 30, 220
# As a standard deviation, where speeds are differences of positions.
SPEED_NOISE = ENCODER * RATE / np.sqrt(6.0)
# Centre of the load below its carrier [m].
CENTRE = np.array([0.0, 0.0, -0.04])


@dataclass(frozen=True, eq=False)
class Shuttle:
    """One round, a row a cycle: stand, move, stand, move back.

    Attributes:
        q, empty, kilogram: drives, torques without friction, and what a kilogram adds.
        sign: direction of each drive, 0 at rest.
        coulomb: friction of the drives [N m].
        grips: rows in which the load is taken, and left.
    """

    model: Model
    q: Array
    empty: Array
    kilogram: Array
    sign: Array
    coulomb: Array
    grips: tuple[int, int]

    def online(
        self, payload: float = 1.0, speed_noise: float | None = SPEED_NOISE
    ) -> deltaid.Online:
        """A stream that finds speeds itself, for loads of up to so much [kg]."""
        noise = None if speed_noise is None else (speed_noise,) * 3
        settings = OnlineSettings(speed="differenced", largest_mass=payload, speed_noise=noise)
        return deltaid.Online(self.model, settings)

    def rounds(self, masses: Array) -> tuple[Array, Array, Array]:
        """q, torques and the gripper's signal of a round for each mass [kg], without noise."""
        rows, (taken, left) = len(self.q), self.grips
        held = (np.arange(rows) >= taken) & (np.arange(rows) < left)
        mass = np.concatenate([m * held for m in masses])
        need = np.tile(self.empty, (len(masses), 1)) + mass[:, None] * np.tile(
            self.kilogram, (len(masses), 1)
        )
        friction = np.tile(self.sign, (len(masses), 1)) * self.coulomb
        rests = np.all(friction == 0, axis=1)
        changes = np.flatnonzero(rests & (np.diff(mass, prepend=0.0) != 0))
        starts = np.flatnonzero(rests & ~np.concatenate([[False], rests[:-1]]))
        ends = np.flatnonzero(rests & ~np.concatenate([rests[1:], [False]])) + 1
        for start, end in zip(starts, ends, strict=True):
            keeps = friction[start - 1] if start else 0.0 * self.coulomb
            pieces = [start, *changes[(changes > start) & (changes < end)], end]
            for first, last in pairwise(pieces):
                if first > start:
                    keeps = keeps + need[first - 1] - need[first]
                    keeps = np.clip(keeps, -self.coulomb, self.coulomb)
                friction[first:last] = keeps
        q = np.round(np.tile(self.q, (len(masses), 1)) / ENCODER) * ENCODER
        return q, need + friction, (mass > 0).astype(float)


@cache
def shuttle(dwell: int = 80) -> Shuttle:
    """A Clavel Delta that stands for so many rows behind each grip."""
    model, x = picked().model, np.arange(MOVE) / MOVE
    robot, p = model.robot, model.p
    middle, half = (np.asarray(part) for part in robot.within(0.0))
    ends = [middle + half * np.array(share) for share in ((-0.3, 0.2, -0.6), (0.35, -0.1, -0.5))]
    stand = AHEAD + dwell
    parts = []
    for start, end in (ends, ends[::-1]):
        rise = x**3 * (10 + x * (6 * x - 15))
        up = np.outer(16 * (x * (1 - x)) ** 2, [0.0, 0.0, 0.3 * half[2]])
        parts += [np.repeat(start[None], stand, 0), start + rise[:, None] * (end - start) + up]
    z = np.concatenate(parts)
    viscous, coulomb = friction_of(robot, p)
    empty = replace(oracle_of(robot, p), viscous=viscous, coulomb=0 * coulomb)
    second = CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE) + 1e-4 * np.eye(3)
    heavy = p.copy()
    heavy[model.layout.body("P")] += [1, *CENTRE, *np.diag(second), *second[[0, 1, 0], [1, 2, 2]]]
    full = replace(oracle_of(robot, heavy), viscous=viscous, coulomb=0 * coulomb)
    q = empty.positions(z)
    before, after = np.roll(q, 1, axis=0), np.roll(q, -1, axis=0)
    qd, qdd = 0.5 * RATE * (after - before), RATE**2 * (after - 2 * q + before)
    moves = np.any(qd != 0, axis=1)
    moves[[stand - 2, 2 * stand + MOVE - 2]] = True  # a row at rest that stands for the others
    taus = []
    for oracle in (empty, full):
        tau = np.zeros_like(q)
        tau[moves] = oracle.inverse_dynamics(z[moves], qd[moves], qdd[moves])
        for first in (0, stand + MOVE):
            rest = slice(first, first + stand)
            tau[rest] = np.where(moves[rest, None], tau[rest], tau[first + stand - 2])
        taus.append(tau)
    grips = AHEAD, stand + MOVE + AHEAD
    return Shuttle(model, q, taus[0], taus[1] - taus[0], np.sign(qd), coulomb[: q.shape[1]], grips)
