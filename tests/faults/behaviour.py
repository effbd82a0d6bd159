"""Robots that behave differently from their description."""

from dataclasses import replace

import numpy as np

from faults.case import Case
from faults.tools import (
    ImpossibleError,
    drives,
    kind,
    only,
    random_drive,
    recorded,
    replanted,
    scaled,
)
from oracle.tree import Array
from plants import Truth, log_uniform

# The body to which a load at the tool is fixed, by kind of platform.
_HELD = {"rigid": "P", "h4": "EE", "par4": "EE", "i4": "EE"}


@kind("friction-law", hides=True)
def stribeck(case: Case, rng: np.random.Generator) -> Case:
    """Friction at low speed exceeds Coulomb's by 30 to 150 %."""
    setting, share = case.setting, log_uniform(rng, 0.3, 1.5)
    dof = len(drives(case))
    coulomb = setting.plant.friction[1]
    knee = rng.uniform(0.03, 0.2) * np.abs(setting.truth.rates).max(axis=0)

    def extra(truth: Truth) -> Array:
        v = truth.rates
        more = share * coulomb * np.sign(v) * np.exp(-((v / knee) ** 2))
        more[:, dof:] = 0.0
        return truth.of_joints(more)

    return replace(recorded(case, extra=extra), size=f"{share:.0%}")


@kind("friction-law", hides=True)
def direction(case: Case, rng: np.random.Generator) -> Case:
    """Friction of each drive differs between directions by 15 to 50 %, with a random sign."""
    share, dof = rng.uniform(0.15, 0.5), len(drives(case))
    way = np.append(rng.choice([-1.0, 1.0], dof), np.zeros(2))

    def extra(truth: Truth) -> Array:
        viscous, coulomb = case.setting.plant.friction
        v = truth.rates
        law = viscous * np.abs(v) + coulomb * (v != 0)
        return truth.of_joints(share * way[: v.shape[1]] * law)

    return replace(recorded(case, extra=extra), size=f"{share:.0%}")


@kind("geometry-or-cogging", hides=True)
def cogging(case: Case, rng: np.random.Generator) -> Case:
    """Ripple over the position: 3 to 15 % of the largest torque, 3 to 30 waves per stroke."""
    setting, share = case.setting, log_uniform(rng, 0.03, 0.15)
    waves = log_uniform(rng, 3, 30)
    order = 2 * np.pi * waves / np.ptp(setting.truth.q, axis=0)
    phase = rng.uniform(0, 2 * np.pi, len(order))
    scale = setting.scale

    def extra(truth: Truth) -> Array:
        return share * scale * np.sin(order * truth.q + phase)

    return replace(recorded(case, extra=extra), size=f"{share:.0%}, {waves:.0f} waves")


@kind("geometry-or-cogging", "homing-or-tilt", related=("homing-or-tilt",), hides=True)
def length(case: Case, rng: np.random.Generator) -> Case:
    """One limb's arm, strut or base point is 3 to 15 % off.

    To first order a longer strut equals a higher carriage, so a wrong zero of its drive is a right
    verdict too.
    """
    limbs = list(case.setting.plant.oracle.limbs)
    k, share = int(rng.integers(len(limbs))), log_uniform(rng, 0.03, 0.15) * rng.choice([-1, 1])
    what = str(rng.choice(["arm", "strut", "base"]))
    what = "strut" if limbs[k].arm is None and what == "arm" else what
    limbs[k] = replace(limbs[k], **{what: getattr(limbs[k], what) * (1 + share)})
    spoilt = replanted(case, limbs=tuple(limbs))
    return replace(spoilt, size=f"{what} of limb {k + 1} by {share:.1%}")


@kind("drift", hides=True)
def warm_up(case: Case, rng: np.random.Generator) -> Case:
    """Friction is 20 to 100 % higher at first, and falls with a time constant."""
    setting, share = case.setting, log_uniform(rng, 0.2, 1.0)
    constant = rng.uniform(0.15, 0.5) * setting.duration

    def extra(truth: Truth) -> Array:
        viscous, coulomb = setting.plant.friction
        more = viscous * truth.rates + coulomb * np.sign(truth.rates)
        return truth.of_joints(share * np.exp(-truth.time / constant)[:, None] * more)

    return replace(recorded(case, extra=extra), size=f"{share:.0%}, {constant:.1f} s")


@kind("load-change", hides=True)
def load_change(case: Case, rng: np.random.Generator) -> Case:
    """A load is taken up, and perhaps put down again, during the recording."""
    setting, oracle = case.setting, case.setting.plant.oracle
    name = "EE" if oracle.telescope else _HELD[oracle.kind]
    whole = sum(body.m for key, body in oracle.bodies.items() if key[0] not in "UCS")
    mass = rng.uniform(0.3, 1.5) * whole
    loaded = dict(oracle.bodies)
    loaded[name] = replace(loaded[name], m=loaded[name].m + mass)
    plant = replace(setting.plant, oracle=replace(oracle, bodies=loaded))
    with_load = replace(setting, plant=plant)
    switches = np.sort(rng.uniform(0.15, 0.85, int(rng.integers(1, 4)))) * setting.duration
    if len(switches) > 1 and np.diff(switches).min() < 0.4:
        raise ImpossibleError("nobody holds a load that shortly")

    def extra(truth: Truth) -> Array:
        held = np.searchsorted(switches, truth.time) % 2 == 1
        return held[:, None] * (
            with_load.truth_at(truth.time).tau - setting.truth_at(truth.time).tau
        )

    times = ", ".join(f"{s:.1f}" for s in switches)
    return replace(recorded(case, extra=extra), size=f"{mass:.2g} kg at {times} s")


@kind("drive-gain", hides=True)
def drive_gain(case: Case, rng: np.random.Generator) -> Case:
    """One drive's torque is scaled wrongly by 5 to 30 %."""
    drive, share = random_drive(case, rng), log_uniform(rng, 0.05, 0.3) * rng.choice([-1, 1])
    columns = scaled(case, "tau", only(case, drive, 1 + share))
    name = drives(case)[drive]
    return replace(case, columns=columns, size=f"{share:+.1%} of {name}", subject=name)
