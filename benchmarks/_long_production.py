"""Picks for hours by a plant that shares no dynamics with the package.

Torques come from the oracle of the tests, MuJoCo's trees, once for each row of a chain of moves;
production is any number of walks along it, to its end and back, with stands of any length. Drives
follow their motion whatever happens. At rest friction takes up what it can: a load that is taken
there, or a push, leaves the drives' torques as they are until it exceeds dry friction.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from _pick_cycles import RATE, Push, draw_cycles, draw_load
from _pick_robots import ENCODER, NOISE, Production, Strange, lacking
from jaxtyping import Bool, Float

from deltaid.control.plant import loaded
from plants import friction_of, oracle_of

# Stands before and after a grip, shortest and longest [s].
AHEAD, DWELL = (0.03, 0.1), (0.02, 0.3)
# Seconds of moves of a chain.
_CHAIN = 6.0


@dataclass(frozen=True, eq=False)
class Walk:
    """Production from the chain's start to its end and back, a row a cycle.

    Attributes:
        q, tau: as measured.
        gripper: whether something is held.
        grips: of each pick the row in which the robot moves off with it, that of its release, and
            its mass [kg].
        moves: whether each drive moves.
    """

    q: Float[np.ndarray, "rows dof"]
    tau: Float[np.ndarray, "rows dof"]
    gripper: Bool[np.ndarray, " rows"]
    grips: Float[np.ndarray, "picks 3"]
    moves: Bool[np.ndarray, "rows dof"]


# Pushes of a walk of so many rows.
Pushes = Callable[[int], Sequence[Push]]


@dataclass(eq=False)
class Chain:
    """A robot and moves between places, one behind the other.

    Attributes:
        legs: first row of each move, and the row behind it.
        q, qd: of the drives.
        rigid, passive: torques of the bodies, and friction of passive joints, which turns round
            with the direction.
        load: further torques of a kilogram that is held.
        levers: ∂(platform point)/∂q.
        coulomb, viscous: of the drives.
        arms: lever of each drive's elbow or carriage [m or 1].
        noise: of torques, drive by drive.
        drives, payload: names, and the largest mass that is picked [kg].
        lacks: friction that the model has not, for q, q̇, torque and time; None for none.
        breakaway: friction at rest at most, of Coulomb friction.
        time, friction: how long it has been running [s], and what friction was at the end of that.
    """

    legs: list[tuple[int, int]]
    q: np.ndarray
    qd: np.ndarray
    rigid: np.ndarray
    passive: np.ndarray
    load: np.ndarray
    levers: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    arms: np.ndarray
    noise: np.ndarray
    drives: Sequence[str]
    payload: float
    lacks: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None
    breakaway: float
    time: float = 0.0
    friction: np.ndarray | None = None

    @classmethod
    def of_kind(
        cls, kind: Production, p: np.ndarray, strange: Strange | None, seed: int
    ) -> "Chain":
        """Of the first robot of a kind.

        Args:
            p: of the plant.
            strange: friction that the model lacks; None for none.
        """
        robot, model, rng = kind.robot, kind.models[0], np.random.default_rng([seed, 2])
        z = draw_cycles(model, kind.payload, rng, _CHAIN).z
        rests = np.concatenate([[False], np.all(np.diff(z, axis=0) == 0, axis=1)])
        edges = np.flatnonzero(np.diff(rests.astype(int)))
        # A move goes from the last row of a stand to the first of the next one.
        starts, ends = edges[rests[edges]], edges[~rests[edges]]
        legs = [(a, int(ends[ends > a][0]) + 1) for a in starts.tolist() if np.any(ends > a)]
        z = z[legs[0][0] : legs[-1][1]]
        legs = [(a - legs[0][0], b - legs[0][0]) for a, b in legs]
        plain = oracle_of(robot, p)
        q = plain.positions(z)
        padded = np.concatenate([q[:1], q, q[-1:]])
        qd = 0.5 * RATE * (padded[2:] - padded[:-2])
        qdd = RATE**2 * (padded[2:] - 2 * q + padded[:-2])
        viscous, coulomb = friction = friction_of(robot, p)
        dof = len(robot.drives)
        outer = (np.arange(len(viscous)) >= dof) * 1.0
        rubs = replace(plain, viscous=viscous * outer, coulomb=coulomb * outer)
        moving = np.concatenate([np.arange(a, b) for a, b in legs])

        def torque(oracle) -> np.ndarray:
            found = np.zeros_like(q)
            found[moving] = oracle.inverse_dynamics(z[moving], qd[moving], qdd[moving])
            return found

        rigid, load = torque(plain), draw_load(kind.payload, rng)
        heavy = loaded(robot, p, load / load[0])
        arms = [1.0 if limb.drive == "linear" else limb.upper_arm for limb in robot.limb_geometry]
        arms += [1.0] * (dof - len(arms))
        known = friction[:, :dof]
        lacks = strange and (
            lambda q, qd, tau, t: lacking(strange, known, kind.fastest, q, qd, tau, t)
        )
        return cls(
            legs, q, qd, rigid, torque(rubs) - rigid, torque(oracle_of(robot, heavy)) - rigid,
            model.dynamics.kinematics.platform_jacobian(z), coulomb[:dof], viscous[:dof],
            np.array(arms), NOISE * kind.largest[0], robot.drives, kind.payload, lacks,
            1.0 + (strange.stribeck if strange else 0.0),
        )  # fmt: skip

    def walk(self, rng: np.random.Generator, noise: np.random.Generator, pushes: Pushes) -> Walk:
        """To the end of the chain and back.

        Args:
            rng: of stands and loads.
            noise: of what is measured.
            pushes: how it is pushed.
        """
        rows, turned, rests, grips = [], [], [], []
        count, mass_of, mass, off = 0, [], 0.0, 0
        order = [(a, b, False) for a, b in self.legs]
        order += [(a, b, True) for a, b in reversed(self.legs)]
        for a, b, back in order:
            first, (ahead, dwell) = (b - 1 if back else a), (
                round(RATE * rng.uniform(*span)) for span in (AHEAD, DWELL)
            )  # fmt: skip
            before = mass
            if mass:
                grips.append((off, count + ahead, mass))
                mass = 0.0
            else:
                mass = self.payload * np.exp(rng.uniform(np.log(0.05), 0.0))
                off = count + ahead + dwell
            n = ahead + dwell + b - a
            rows += [np.full(ahead + dwell, first), np.arange(a, b)[:: -1 if back else 1]]
            turned.append(np.full(n, -1.0 if back else 1.0))
            rests.append(np.arange(n) < ahead + dwell)
            mass_of.append(np.where(np.arange(n) < ahead, before, mass))
            count += n
        row, turn, rest = (np.concatenate(part) for part in (rows, turned, rests))
        held = np.concatenate(mass_of)
        q, qd = self.q[row], self.qd[row] * (turn * ~rest)[:, None]
        need = self.rigid[row] + held[:, None] * self.load[row]
        need += turn[:, None] * self.passive[row]
        for push in pushes(count):
            span = slice(round(push.start * RATE), round(push.end * RATE))
            if push.place == "platform":
                need[span] -= np.einsum("kid,i->kd", self.levers[row[span]], push.force)
            else:
                j = list(self.drives).index(push.place)
                need[span, j] -= self.arms[j] * push.force[0]
        time = self.time + np.arange(count)[:, None] / RATE
        self.time += count / RATE
        friction = np.sign(qd) * self.coulomb + self.viscous * qd
        if self.lacks is not None:
            friction += self.lacks(q, qd, need + friction, time)
        self._stick(friction, need, rest)
        tau = need + friction + self.noise * noise.standard_normal(need.shape)
        q = np.round(q / ENCODER) * ENCODER
        return Walk(q, tau, held > 0, np.array(grips), np.abs(qd) > 0)

    def _stick(self, friction: np.ndarray, need: np.ndarray, rest: np.ndarray) -> None:
        """Friction at rest: torques of the drives stay, as far as dry friction allows."""
        before = np.concatenate([rest[:1] & False, rest[:-1]])
        jump = np.concatenate([[True], np.any(np.diff(need, axis=0) != 0, axis=1)])
        at = np.flatnonzero(rest & (jump | ~before))
        ends = np.flatnonzero(rest & ~np.concatenate([rest[1:], [False]])) + 1
        last = self.friction if self.friction is not None else 0.0 * self.coulomb
        bound = self.breakaway * self.coulomb
        for k, following in zip(at, [*at[1:], len(rest)], strict=True):
            if k:
                last = friction[k - 1] + need[k - 1] - need[k]
            end = min(following, int(ends[np.searchsorted(ends, k, side="right")]))
            friction[k:end] = np.clip(last, -bound, bound)
        self.friction = friction[-1] if rest[-1] else np.clip(friction[-1], -bound, bound)
