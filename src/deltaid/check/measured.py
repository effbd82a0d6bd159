"""Measured values of bodies that are far from what is described: a scale that shows grams."""

import re
from collections.abc import Iterator

import numpy as np

from deltaid.check.priors import size_of
from deltaid.dynamics.parameters import parameter_layout, stated_spreads
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.weighings import Weighing, weighings

# A value so many times the prior's, or as small a share of it, and so many of the prior's standard
# deviations away, is one in another unit.
_FACTOR, _SPREADS = 100.0, 30.0
# A centre of mass so many times as far away as a limb is long is one in millimetres.
_FARTHEST = 3.0
_UNITS = {"kg": "grams", "kg m²": "kg mm², kg cm² or g m²"}


def checked_measured(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each measured value that cannot be, or one that all go with the prior."""
    rows = weighings(robot)
    if not rows:
        return ()
    first, *_ = rows
    found = tuple(_judged(robot, rows))
    if found:
        return found
    return (
        Verdict(
            "measured-scale",
            Grade.GOOD,
            f"{len(rows)} measured value{'s' if len(rows) > 1 else ''}, as "
            f"{first.name}, {'go' if len(rows) > 1 else 'goes'} with the description",
        ),
    )


def _judged(robot: RobotDescription, rows: tuple[Weighing, ...]) -> Iterator[Verdict]:
    layout, stated = parameter_layout(robot), stated_spreads(robot)
    prior = np.array([one.prior for one in layout.parameters])
    spread = np.array([stated.get(one.name, PRIOR_SPREAD) for one in layout.parameters])
    std = spread * [one.scale for one in layout.parameters]
    for one in rows:
        expected = float(one.coefficients @ prior)
        if one.unit == "kg m":
            bodies = np.unique(np.flatnonzero(one.coefficients) // 10)
            lever = abs(one.value - expected) / float(prior[10 * bodies].sum())
            if lever > _FARTHEST * size_of(robot):
                yield _far(one, lever)
            continue
        off = abs(one.value - expected) / float(np.linalg.norm(one.coefficients * std))
        ratio = one.value / expected
        if (ratio > _FACTOR and off > _SPREADS) or ratio < 1 / _FACTOR:
            yield _scaled(one, expected, ratio)


def _scaled(one: Weighing, expected: float, ratio: float) -> Verdict:
    """A mass or a moment of inertia of another magnitude."""
    large = ratio > 1
    thousand = one.unit == "kg" and large
    return Verdict(
        "measured-scale",
        Grade.WRONG if large else Grade.DOUBTFUL,
        f"{one.name} is {one.value:.3g} {one.unit}, where the prior has {expected:.3g} {one.unit}",
        subject=one.where,
        cause=f"a value in {_UNITS[one.unit]}" if large else "a value in another unit, or a prior",
        cure=f"give it in {one.unit}" + (", and its std as well" if thousand else ""),
        proposals=_proposed(one) if thousand else (),
        number=ratio,
    )


def _far(one: Weighing, lever: float) -> Verdict:
    """A first moment or a centre of mass that lies out of all reach."""
    return Verdict(
        "measured-scale",
        Grade.WRONG,
        f"{one.name} would lie {lever:.3g} m from where the prior has it",
        subject=one.where,
        cause="a centre of mass in mm, or a first moment in kg mm or g mm",
        cure="give centres in m and first moments in kg m, in the body's link frame",
        number=lever,
        unit="m",
    )


def _proposed(one: Weighing) -> tuple[Proposal, ...]:
    """The same in kilograms."""
    path = re.sub(r"\[(\d+)\]", lambda match: f"[{int(match[1]) - 1}]", one.where)
    values = {"mass": one.value / 1000, "std": one.std / 1000}
    changes = ((f"{path}.{key}", float(f"{value:.12g}")) for key, value in values.items())
    return (Proposal("robot", tuple(changes)),)
