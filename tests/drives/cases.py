"""Recordings of a row of any table: `rows.py`, `timing.py` or `causes.py`."""

from dataclasses import replace
from zlib import crc32

import numpy as np

from drives.causes import CAUSES
from drives.closed_loop import followed
from drives.happening import Happening
from drives.made import Made
from drives.production import production_machine
from drives.robots import machine
from drives.rows import ROWS, Case, load_of
from drives.sensors import Sensors
from drives.timing import TIMING


def case(row: str, kind: str = "delta4", seed: int = 0) -> Case:
    """The recordings of a row of any table, for a kind of robot."""
    rng = np.random.default_rng([seed, crc32(kind.encode()), crc32(row.encode())])
    m = (production_machine(kind, seed) if row.startswith("production")
         else machine(kind, seed, row == "poor-priors"))  # fmt: skip
    h = Happening(m, float(rng.uniform(14, 20)), int(rng.integers(1 << 31)))
    if row in ("closed-loop", "unlogged"):
        h, log = followed(h, rng, 0.01 if row == "unlogged" else 0.0)
        # A torque is held from its row to the next one, so on average it leads by half a row.
        sensors = Sensors(delay=-0.5 / m.rate)
        return Case(row, kind, seed, m, m.robot, (h,), (sensors,), (log,))
    if row in CAUSES:
        made = CAUSES[row].make(Made(h, Sensors()), rng)
        h, sensor_set = made.happening, made.sensors
        log = sensor_set.recorded(h)
        return Case(
            row, kind, seed, h.machine, m.robot, (h,), (sensor_set,), (log,), (), made.words
        )
    if row == "gains":
        gain = 1 + rng.uniform(-0.1, 0.1, m.dof)
        loaded = replace(h, seed=h.seed + 1, duration=h.duration, load=load_of(m, rng),
                         held=((-1.0, h.duration + 1),))  # fmt: skip
        sensors = (Sensors(gain=gain),) * 2
        both = (h, loaded)
    else:
        h, sensor_set = (ROWS | TIMING)[row].make(h, rng)
        both, sensors = (h,), (sensor_set,)
    logs = tuple(s.recorded(x) for s, x in zip(sensors, both, strict=True))
    return Case(row, kind, seed, both[0].machine, m.robot, both, sensors, logs,
                (ROWS | TIMING)[row].tells)  # fmt: skip
