"""Picks while the robot moves: what a belt, and a gripper's signal at the wrong time, do to masses.

    python benchmarks/belt_picks.py

Drives follow random motions whatever happens (torques by inverse dynamics), so every pick is taken
in full motion. A part on a belt that the robot runs with moves as the platform does; one that
stands, or moves otherwise, is brought to the platform's speed within `GRIP`. Signals may come
before the load is held, as the command to a valve does, or after. Writes `tables/belt_picks.md`.
"""

from dataclasses import dataclass

import numpy as np
from _pick_cycles import RATE, draw_load, is_near
from _table import leave
from jaxtyping import Float

from deltaid import Recording
from deltaid.checks.identify import identify
from deltaid.dynamics.dynamics import compiled
from deltaid.model.model import Model, load
from deltaid.model.settings import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.online.online import Online
from deltaid.online.replay import Replay, open_replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.watch import Watched, watch
from deltaid.robot.load import load_robot
from support import along

ROBOT, PAYLOAD, NOISE = "clavel-delta3", 1.0, 0.02
PICKS, EVERY, HELD = 40, 1.0, 0.5
# Seconds in which a part is brought to the platform's speed.
GRIP = 0.01
HEAD = ("gripped", "signal", "picks", "10 % or 60 g after 0.2 s", "interval holds",
        "grip_offset known, median [ms]", "contacts reported", "signal warned of")  # fmt: skip
NOTE = (
    f"{PICKS} picks of 5 % to 100 % of {PAYLOAD:g} kg in full motion, no pushes. Contacts "
    "reported: all are the grip itself, or a signal at the wrong time. `grip_offset` known: share "
    "of picks of which it is known 0.2 s after load and signal, and its median. Signal warned of: "
    "whether a warning names the signal."
)


@dataclass(frozen=True)
class Case:
    """How parts are gripped.

    Attributes:
        apart: speed of the part against the platform [m/s].
        early: how long before the load is held the gripper's signal comes [s].
        grip_time: as the settings know it [s]; None without the signal.
    """

    name: str
    apart: float = 0.0
    early: float = 0.0
    grip_time: float | None = 0.0

    @property
    def signal(self) -> str:
        if self.grip_time is None:
            return "none"
        if not self.early:
            return "in time"
        known = f", grip_time {1e3 * self.grip_time:g} ms" if self.grip_time else ""
        return f"{1e3 * abs(self.early):g} ms {'early' if self.early > 0 else 'late'}{known}"


CASES = (
    Case("with the belt"),
    Case("with the belt", grip_time=None),
    Case("0.1 m/s apart", apart=0.1),
    Case("0.3 m/s apart", apart=0.3),
    Case("with the belt", early=0.03),
    Case("with the belt", early=0.03, grip_time=0.03),
    Case("with the belt", early=0.1),
    Case("with the belt", early=0.1, grip_time=0.1),
    Case("with the belt", early=-0.03),
    *(Case("with the belt", early=early) for early in (0.15, 0.045, -0.045, -0.1, -0.15)),
)


@dataclass(frozen=True, eq=False)
class Line:
    """A robot's recording with picks, and its model.

    Attributes:
        loads: ten parameters of each.
        blows: torque that brings each part to the platform's speed, for 1 m/s apart.
    """

    model: Model
    time: Float[np.ndarray, " time"]
    q: Float[np.ndarray, "time dof"]
    tau: Float[np.ndarray, "time dof"]
    blows: Float[np.ndarray, "time dof"]
    held: np.ndarray
    loads: list[np.ndarray]


def line(seed: int) -> Line:
    robot, rng = load_robot(ROBOT), np.random.default_rng(seed)
    dynamics, p = compiled(robot), surrogate_parameters(robot, rng)
    known = simulate_recording(
        dynamics, p, random_motion(dynamics.kinematics, rng, period=5.0), rng,
        duration=12.0, rate=RATE, noise=SensorNoise(),
    )  # fmt: skip
    model = load(identify(robot, known, settings=Settings(friction="described"), force=True))
    time = np.arange(round(PICKS * EVERY * RATE)) / RATE
    z, q, qd, qdd = along(dynamics.kinematics, rng, time, period=7.3)
    tau, plant = dynamics.torque(z, qd, qdd, p), Model(robot, p, ROBOT)
    noise = NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    held, blows, loads = np.zeros(len(time), dtype=bool), np.zeros_like(tau), list[np.ndarray]()
    J = dynamics.kinematics.jacobian(z)
    for k in range(PICKS):
        loads.append(draw_load(PAYLOAD, rng))
        rows = (time >= (k + 0.3) * EVERY) & (time < (k + 0.3) * EVERY + HELD)
        held |= rows
        tau[rows] = dynamics.torque(z[rows], qd[rows], qdd[rows], plant.with_load(loads[-1]).p)
        n = np.array([np.cos(k), np.sin(k), 0.0])
        for i in np.flatnonzero(rows)[: round(GRIP * RATE)]:
            blows[i] = np.linalg.solve(J[i].T, loads[-1][0] / GRIP * n)
    return Line(model, time, q, tau + noise, blows, held, loads)


def row(made: Line, case: Case) -> tuple[object, ...]:
    signal = np.roll(made.held, -round(case.early * RATE)).astype(float)
    tau = made.tau + case.apart * made.blows
    log = Recording.from_arrays(t=made.time, q=made.q, tau=tau, extra={"gripper": signal})
    has_gripper = case.grip_time is not None
    replay = open_replay(made.model, log, gripper="gripper" if has_gripper else None)
    settings = OnlineSettings(largest_mass=PAYLOAD, grip_time=case.grip_time or 0.0)
    found = watch(made.model, replay, settings)
    near, holds = judged(made, found)
    said = any("the gripper signals" in doubt for doubt in found.doubts)
    return (
        case.name, case.signal, PICKS, f"{np.mean(near):.0%}", f"{np.mean(holds):.0%}",
        _offset(made, replay, settings, case), len(found.touches), "yes" if said else "no",
    )  # fmt: skip


def _offset(made: Line, replay: Replay, settings: OnlineSettings, case: Case) -> str:
    """Share of picks with a known `grip_offset`, and its median, 0.2 s after load and signal."""
    online = Online(made.model, replay.settings(settings))
    blocks = [online.run(rows.q, rows.qd, rows.tau, rows.gripper) for rows in replay.rows()]
    offset = np.concatenate([block.grip_offset for block in blocks])
    after = 0.3 + 0.2 + max(-case.early, 0.0)
    known = offset[np.round((EVERY * np.arange(PICKS) + after) * RATE).astype(int)]
    share, found = np.mean(np.isfinite(known)), known[np.isfinite(known)]
    return f"{share:.0%}, {1e3 * np.median(found):.0f}" if found.size else "0%"


def judged(made: Line, found: Watched) -> tuple[list[bool], list[bool]]:
    """Of each pick whether its mass is near, and whether its interval holds, 0.2 s after it."""
    columns = found.series.select("t", "mass", "mass_low", "mass_high")
    (time, masses, lows, highs), near, holds = columns.to_numpy().T, list[bool](), list[bool]()
    for k, held in enumerate(made.loads):
        i = int(np.searchsorted(time, (k + 0.3) * EVERY + 0.2))
        near.append(is_near(masses[i], held[0]))
        holds.append(bool(lows[i] <= held[0] <= highs[i]))
    return near, holds


def main() -> None:
    made = line(seed=3)
    leave(HEAD, [row(made, case) for case in CASES], NOTE, picks=PICKS)


if __name__ == "__main__":
    main()
