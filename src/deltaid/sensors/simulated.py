"""What a robot's sensors would show along a motion: truth, unknowns of their own, noise."""

import zlib

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.sensors.of_robot import all_sensor_rows
from deltaid.sensors.rows import Motion, SensorRows

# What a sensor shows stands in its own columns where gain or pose is off: put in so often.
_ROUNDS = 30
# A part of a robot is so far from its prior, as a share of what its prior allows.
_AWAY = 0.3

Unknowns = Float[np.ndarray, " unknowns"]
Shown = Float[np.ndarray, "channels samples"]


def drawn_unknowns(rows: SensorRows, seed: int = 0) -> Unknowns:
    """Unknowns of one sensor, the same for one seed and name, so in all recordings of a robot.

    Biases, gains and poses are drawn as the description says; what belongs to the robot's parts,
    such as a rotor's spin, is as near to its prior as its bodies are to theirs.
    """
    rng = np.random.default_rng([seed, zlib.crc32(rows.name.encode())])
    found = []
    for one in rows.parameters:
        own = one.symbol.startswith(("spin", "outer"))
        size = _AWAY * rng.uniform(-1, 1) if own else rng.standard_normal()
        found.append(one.prior + one.std * size)
    return np.array(found)


def shown_by(
    rows: SensorRows, p: Parameters, u: Unknowns, z: Motion, qd: Motion, qdd: Motion
) -> Shown:
    """y = C p + D(y) u, what one sensor shows without noise, in the order of its channels."""
    channels, columns = rows.pattern
    shown = np.zeros((len(rows.channels), len(z)))
    values = np.append(p, u)[columns][:, None]
    for _ in range(_ROUNDS):
        before, shown = shown, np.zeros_like(shown)
        np.add.at(shown, channels, values * rows.entries(z, qd, qdd, before))
        if np.allclose(shown, before, rtol=1e-14, atol=0.0):
            break
    return shown


def simulated_sensors(
    dynamics: Dynamics,
    p: Parameters,
    z: Motion,
    qd: Motion,
    qdd: Motion,
    rng: np.random.Generator | None = None,
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Columns of all sensors of a robot by their default names.

    Args:
        dynamics: of the robot.
        p: its true parameters.
        z, qd, qdd: the motion.
        rng: of the sensors' noise; without one there is none, and nothing else that is unknown.
    """
    columns: dict[str, np.ndarray] = {}
    for rows in all_sensor_rows(dynamics):
        u = drawn_unknowns(rows)
        if rng is None:
            u = np.array([one.prior for one in rows.parameters])
        for channel, values in zip(rows.channels, shown_by(rows, p, u, z, qd, qdd), strict=True):
            noise = 0.0 if rng is None else channel.noise * rng.standard_normal(len(values))
            columns[channel.name] = values + noise
    return columns
