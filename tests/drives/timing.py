"""Rows of the table for the sampling of torques and positions.

Torques pass a filter, are averaged or held between two updates of the drive, have a separate clock,
or lag in addition to gears that wind up.
"""

from dataclasses import replace

import numpy as np

from drives.happening import Happening
from drives.rows import Row, gear
from drives.sensors import Sensors

# Time constant of the filter (s), cut-off of one of second order (Hz), averaged time (s), time
# between two updates (s), relative difference of the clocks, lag of all torques (s), stiffness of
# the gears (N m/rad).
_FILTER, _CUT_OFF, _AVERAGED, _HOLD = 5e-3, 50.0, 8e-3, 2e-3
_CLOCKS, _LATE, _STIFFNESS = 5e-4, 3e-3, 8e3


def _filter(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(current_loop=1 / (2 * np.pi * _FILTER))


def _second_order(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(second_order=_CUT_OFF)


def _average(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(average=_AVERAGED)


def _hold(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(hold=_updated(h))


def _noisy_hold(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(hold=_updated(h), held_noise=False)


def _clocks(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(clocks=_CLOCKS * float(rng.choice([-1.0, 1.0])))


def _late_gear(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return replace(h, stiffness=gear(h.machine, _STIFFNESS)), Sensors(
        delay=np.full(h.machine.dof, _LATE)
    )


def _held_delays(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(delay=rng.uniform(-4e-3, 4e-3, h.machine.dof), hold=_updated(h))


def _updated(h: Happening) -> float:
    """Time between two updates, at least two rows (s)."""
    return max(_HOLD, 2 / h.machine.rate)


TIMING = {
    "filter-5ms": Row(_filter, "torques behind a filter of 5 ms"),
    "second-order": Row(_second_order, "torques behind a second-order filter of 50 Hz"),
    "average-8ms": Row(_average, "torques averaged over 8 ms"),
    "hold-2ms": Row(_hold, "torques updated every 2 ms"),
    "noisy-hold": Row(_noisy_hold, "the same, and the log adds noise to each row"),
    "clocks": Row(_clocks, "the clock of the torques 500 ppm fast or slow"),
    "late-gear": Row(_late_gear, "all torques 3 ms late, gears of 8 000 N m/rad"),
    "held-delays": Row(_held_delays, "torques −4 to 4 ms late by drive, updated every 2 ms"),
}  # fmt: skip
