"""Faults of wiring: units, gears, signs, orders, zeros and times that differ from the mapping."""

from dataclasses import replace

import numpy as np

from faults.case import Case
from faults.tools import (
    ImpossibleError,
    drives,
    kind,
    only,
    permutation,
    random_drive,
    replanted,
    rotary,
    scaled,
    some,
    with_velocity,
)
from plants import log_uniform


@kind("angle-unit", related=("velocity", "velocity-unit"))
def angle_unit(case: Case, rng: np.random.Generator) -> Case:
    """Degrees for radians, or millimetres for metres."""
    which, subject = some(case, rng)
    factor = np.where(rotary(case), np.rad2deg(1.0), 1e3)
    columns = scaled(case, "q", np.where(which, factor, 1.0))
    return replace(case, columns=columns, size=subject or "all drives", subject=subject)


@kind("velocity-unit", related=("velocity",))
def velocity_unit(case: Case, rng: np.random.Generator) -> Case:
    """rpm or degrees a second for rad/s, or mm/s for m/s."""
    case = with_velocity(case)
    turning = 60 / (2 * np.pi) if rng.uniform() < 0.6 else np.rad2deg(1.0)
    factor = np.where(rotary(case), turning, 1e3)
    return replace(case, columns=scaled(case, "qd", factor), size=f"{factor.max():.3g}")


@kind("torque-unit")
def torque_unit(case: Case, rng: np.random.Generator) -> Case:
    """mN m for N m, or per mille of a rated torque."""
    if rng.uniform() < 0.5:
        return replace(case, columns=scaled(case, "tau", 1e3), size="mN m")
    rated = case.setting.scale * rng.uniform(0.3, 1.0)
    rated = np.full_like(rated, rated.max()) if rng.uniform() < 0.7 else rated
    words = f"per mille of {rated.max():.3g}"
    return replace(case, columns=scaled(case, "tau", 1e3 / rated), size=words)


@kind("gear", related=("angle-unit", "torque-unit"))
def gear(case: Case, rng: np.random.Generator) -> Case:
    """Angles are the motor's, with a gear that the mapping lacks; torques are of either side."""
    ratio = log_uniform(rng, 5, 100)
    ratio = 30.0 if 40 < ratio < 80 else ratio  # not near 57.3, the factor of degrees
    factor = np.where(rotary(case), ratio, 2 * np.pi / rng.uniform(0.01, 0.06))
    columns = scaled(case, "q", factor)
    if "qd" in columns:
        columns["qd"] = columns["qd"] * factor
    words = f"{factor.max():.4g}"
    if rng.uniform() < 0.5:
        columns["tau"] = columns["tau"] / factor
        words += " and torques of the motor"
    return replace(case, columns=columns, size=words)


@kind("gear", "torque-unit")
def motor_torque(case: Case, rng: np.random.Generator) -> Case:
    """Torques are the motor's, angles the joint's."""
    factor = np.where(rotary(case), log_uniform(rng, 8, 100), 2 * np.pi / rng.uniform(0.01, 0.06))
    return replace(case, columns=scaled(case, "tau", 1 / factor), size=f"1 / {factor.max():.3g}")


@kind("time-unit", related=("rate", "velocity", "velocity-unit"))
def time_unit(case: Case, rng: np.random.Generator) -> Case:
    """Time is 2 to 20 times too long or too short, as in another unit or cycle."""
    factor = log_uniform(rng, 2, 20) ** rng.choice([-1, 1])
    columns = dict(case.columns) | {"t": factor * case.columns["t"]}
    return replace(case, columns=columns, size=f"{factor:.3g}")


@kind("angle-sign")
def angle_sign(case: Case, rng: np.random.Generator) -> Case:
    """One drive's angle has the wrong sign."""
    drive = random_drive(case, rng)
    columns = scaled(case, "q", only(case, drive, -1.0))
    if "qd" in columns:
        columns["qd"] = columns["qd"] * only(case, drive, -1.0)
    name = drives(case)[drive]
    return replace(case, columns=columns, size=name, subject=name)


@kind("torque-sign")
def torque_sign(case: Case, rng: np.random.Generator) -> Case:
    """The torque of one or all drives has the wrong sign."""
    which, subject = some(case, rng)
    columns = scaled(case, "tau", np.where(which, -1.0, 1.0))
    return replace(case, columns=columns, size=subject or "all drives", subject=subject)


@kind("angle-sign", "torque-sign", related=("angle-sign", "torque-sign"), hides=True)
def both_signs(case: Case, rng: np.random.Generator) -> Case:
    """One drive has the wrong sign in angle and torque."""
    turned = angle_sign.change(case, rng)
    drive = drives(case).index(turned.subject)
    return replace(turned, columns=scaled(turned, "tau", only(case, drive, -1.0)))


@kind("drive-order")
def torque_order(case: Case, rng: np.random.Generator) -> Case:
    """Torque columns in another order."""
    order = permutation(case, rng)
    columns = dict(case.columns) | {"tau": case.columns["tau"][:, order]}
    return replace(case, columns=columns, size=str(order + 1))


@kind("drive-order", hides=True)
def drive_order(case: Case, rng: np.random.Generator) -> Case:
    """All columns in another order; no fault on a robot that is symmetric under it."""
    order = permutation(case, rng)
    columns = {name: x[:, order] if x.ndim > 1 else x for name, x in case.columns.items()}
    return replace(case, columns=columns, size=str(order + 1))


@kind("homing-or-tilt", hides=True)
def homing(case: Case, rng: np.random.Generator) -> Case:
    """One drive's zero is wrong, by 3 to 50 mrad or 1 to 20 mm."""
    drive = random_drive(case, rng)
    size = log_uniform(rng, 3e-3, 50e-3) if rotary(case)[drive] else log_uniform(rng, 1e-3, 20e-3)
    offset = only(case, drive, 1.0 + size * rng.choice([-1, 1])) - 1.0
    columns = dict(case.columns) | {"q": case.columns["q"] + offset}
    name = drives(case)[drive]
    return replace(case, columns=columns, size=f"{offset[drive]:.3g} of {name}", subject=name)


@kind("homing-or-tilt", hides=True)
def tilt(case: Case, rng: np.random.Generator) -> Case:
    """The base is tilted by 2 to 30 mrad."""
    angle, way = log_uniform(rng, 2e-3, 30e-3), rng.uniform(0, 2 * np.pi)
    direction = np.array([np.sin(angle) * np.cos(way), np.sin(angle) * np.sin(way), -np.cos(angle)])
    size = float(np.linalg.norm(case.setting.plant.oracle.gravity))
    spoilt = replanted(case, gravity=size * direction)
    return replace(spoilt, size=f"{1e3 * angle:.3g} mrad")


@kind("velocity", related=("velocity-unit",))
def velocity_scale(case: Case, rng: np.random.Generator) -> Case:
    """Recorded velocities of one or all drives are too large or too small."""
    case = with_velocity(case)
    factor = rng.uniform(1.05, 2.0)
    factor = factor if rng.uniform() < 0.5 else 1 / factor
    which, subject = some(case, rng)
    columns = scaled(case, "qd", np.where(which, factor, 1.0))
    return replace(case, columns=columns, size=f"{factor:.3g}", subject=subject)


@kind("velocity", related=("drive-order",))
def velocity_order(case: Case, rng: np.random.Generator) -> Case:
    """Velocity columns in another order."""
    case = with_velocity(case)
    order = permutation(case, rng)
    columns = dict(case.columns) | {"qd": case.columns["qd"][:, order]}
    return replace(case, columns=columns, size=str(order + 1))


@kind("velocity")
def velocity_lag(case: Case, rng: np.random.Generator) -> Case:
    """Recorded velocities lag by 1 to 5 ms."""
    case = with_velocity(case)
    late = log_uniform(rng, 1e-3, 5e-3)
    setting = case.setting
    behind = setting.truth_at(setting.time - late).qd - setting.truth.qd
    columns = dict(case.columns) | {"qd": case.columns["qd"] + behind}
    if np.sqrt(len(behind)) * np.std(behind, axis=0).max() < 6e-3 * np.abs(setting.truth.qd).max():
        raise ImpossibleError("too slow a motion to see it")
    return replace(case, columns=columns, size=f"{1e3 * late:.3g} ms")
