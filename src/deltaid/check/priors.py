"""Numbers of bodies that do not go with the robot: priors in grams or kg mm², measured values of
another magnitude than the prior, such as of a scale that shows grams."""

import re
from collections.abc import Iterator

import numpy as np

from deltaid.dynamics.parameters import parameter_layout, stated_spreads
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.robot.shapes import HollowCylinder, PointMass
from deltaid.sensors.weighings import Weighing, weighings

# kg/m³. Osmium has 22,600; foam some 30. What is called a density but is less is in g/cm³.
_DENSEST, _LIGHTEST, _IN_GRAMS = 23_000.0, 10.0, 25.0
# kg/m³ of arm and strut together, cubed: a solid block of steel with a side of a sixth of them is
# hardly part of a robot, and one of four times its mass is not.
_HEAVY, _FAR = 7850.0 / 6**3, 4.0
# Shares of a body's extent: no centre of mass or radius of gyration lies farther out, and that of
# an arm or a strut never so near to its first joint.
_OUTSIDE, _INSIDE = 1.5, 0.02
# A measured value so many times the prior's, or as small a share of it, and so many of the prior's
# standard deviations away, is one in another unit.
_FACTOR, _SPREADS = 100.0, 30.0
# A centre of mass so many times as far away as a limb is long is one in millimetres.
_FARTHEST = 3.0
_UNITS = {"kg": "grams", "kg m²": "kg mm², kg cm² or g m²"}


def checked_priors(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each body whose prior cannot be, or one that all can."""
    verdicts = tuple(verdict for name in robot.body_names for verdict in _body(robot, name))
    if verdicts:
        return verdicts
    mass = sum(float(body.prior_parameters()[0]) for body in robot.bodies.values())
    seen = f"{len(robot.bodies)} bodies, together {mass:.3g} kg, go with the lengths"
    return (Verdict("prior-scale", Grade.GOOD, seen, number=mass, unit="kg"),)


def _body(robot: RobotDescription, name: str) -> Iterator[Verdict]:
    """The first thing out of scale of each shape, or of numbers: the rest would repeat it."""
    prior, size = robot.bodies[name].prior, _size_of(robot)
    if isinstance(prior, ExplicitInertia):
        yield from _explicit(robot, name, prior, size)
        return
    for k, shape in enumerate(prior):
        path, mass = f"bodies.{name}.prior[{k}]", float(shape.parameters()[0])
        density = np.nan
        if isinstance(shape, HollowCylinder):
            section = np.pi * (shape.outer_radius**2 - shape.inner_radius**2)
            density = mass / (section * shape.length)
        if density > _DENSEST:
            yield _heavy(path, name, shape, density)
        elif density < _LIGHTEST:
            yield _light(path, name, shape, density)
        elif mass > _HEAVY * size**3:
            yield _massive(f"{path}.mass", name, mass, size, alone=shape.mass is not None)


def _explicit(
    robot: RobotDescription, name: str, prior: ExplicitInertia, size: float
) -> Iterator[Verdict]:
    p, limb = prior.parameters(), _limb_length(robot, name)
    extent = limb or size
    com = float(np.linalg.norm(p[1:4]) / p[0])
    gyration = float(np.sqrt(np.trace(pseudo_inertia(p)[:3, :3]) / p[0]))
    small = limb is not None and gyration < _INSIDE * extent
    if p[0] > _HEAVY * size**3:
        yield _massive(f"bodies.{name}.prior.mass", name, float(p[0]), size, alone=small)
        return
    length, seen = gyration, f"the radius of gyration √(tr Σ/m) is {gyration:.3g} m"
    if com > _OUTSIDE * extent:
        length, seen = com, f"the centre of mass lies {com:.3g} m from the link frame's origin"
        cause = "a first moment in kg mm, or a mass in tonnes"
    elif gyration > _OUTSIDE * extent:
        cause = "moments of inertia in kg mm² or kg cm², or a mass in tonnes"
    elif small:
        cause = "a mass in grams, or moments of inertia that are not in kg m²"
    else:
        return
    yield Verdict(
        "prior-scale",
        Grade.WRONG,
        f"{seen}, {length / extent:.2g} times the body's reach of {extent:.3g} m",
        name,
        cause,
        "give mass in kg, first moments in kg m, moments of inertia in kg m² about the link "
        "frame's origin",
        number=length,
        unit="m",
    )


def _heavy(path: str, name: str, shape: HollowCylinder | PointMass, density: float) -> Verdict:
    key, value, cause = "density", density, "a density in g/m³"
    if shape.mass is not None:
        key, value, cause = "mass", shape.mass, "a mass in grams"
    fits = density / 1000 > _LIGHTEST
    return Verdict(
        "prior-scale",
        Grade.WRONG,
        f"{path} has a density of {density:.3g} kg/m³; no material has more than {_DENSEST:.3g}",
        name,
        cause,
        "give kilograms and metres" + "; the same number in grams would fit" * fits,
        _proposed(f"{path}.{key}", value / 1000) if fits else (),
        number=density,
        unit="kg/m³",
    )


def _light(path: str, name: str, shape: HollowCylinder | PointMass, density: float) -> Verdict:
    cause, proposals = "a mass in tonnes, or radii that are too large", ()
    cure = "check mass and radii; they are in kg and m"
    if shape.mass is None and density < _IN_GRAMS:
        cause, cure = "a density in g/cm³", "give the density in kg/m³: 1000 times the number"
        proposals = _proposed(f"{path}.density", density * 1000)
    seen = f"{path} has a density of {density:.3g} kg/m³; even foam has more"
    key, grade, unit = "prior-scale", Grade.DOUBTFUL, "kg/m³"
    return Verdict(key, grade, seen, name, cause, cure, proposals, density, unit)


def _massive(path: str, name: str, mass: float, size: float, *, alone: bool) -> Verdict:
    """`alone`: whether the mass may be wrong and the moments right."""
    largest = _HEAVY * size**3
    return Verdict(
        "prior-scale",
        Grade.WRONG if mass > _FAR * largest else Grade.DOUBTFUL,
        f"{path} is {mass:.3g} kg; with limbs of {size:.3g} m few bodies have {largest:.3g} kg",
        name,
        "a mass in grams",
        "give kilograms" if alone else "give kilograms, and moments in kg m and kg m²",
        _proposed(path, mass / 1000) if alone and mass / 1000 < largest else (),
        number=mass,
        unit="kg",
    )


def _proposed(path: str, value: float) -> tuple[Proposal, ...]:
    return (Proposal("robot", ((path, float(f"{value:.12g}")),)),)


def _limb_length(robot: RobotDescription, name: str) -> float | None:
    """Of a body that is an arm or a strut [m]; a carriage may have its mass where its frame is."""
    for i, limb in enumerate(robot.limb_geometry):
        lengths = dict(zip(robot.limb_bodies(i), (limb.upper_arm, limb.strut), strict=True))
        if lengths.get(name):
            return lengths[name]
    return None


def _size_of(robot: RobotDescription) -> float:
    """Length of the longest arm and strut together [m]; a mechanism of the user's own may be of any
    size: a sled of a hundred kilograms moves by a few centimetres."""
    return max((limb.upper_arm + limb.strut for limb in robot.limb_geometry), default=np.inf)


def checked_measured(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each measured value that cannot be, or one that all go with the prior."""
    rows = weighings(robot)
    verdicts = tuple(_measured(robot, rows))
    if verdicts or not rows:
        return verdicts
    first, *_ = rows
    several, go = ("s", "go") if len(rows) > 1 else ("", "goes")
    seen = f"{len(rows)} measured value{several}, as {first.name}, {go} with the description"
    return (Verdict("measured-scale", Grade.GOOD, seen),)


def _measured(robot: RobotDescription, rows: tuple[Weighing, ...]) -> Iterator[Verdict]:
    parameters, stated = parameter_layout(robot).parameters, stated_spreads(robot)
    prior = np.array([entry.prior for entry in parameters])
    std = np.array([stated.get(entry.name, PRIOR_SPREAD) * entry.scale for entry in parameters])
    for row in rows:
        expected = float(row.coefficients @ prior)
        error, ratio = abs(row.value - expected), row.value / expected if expected else np.inf
        if row.unit == "kg m":
            bodies = np.unique(np.flatnonzero(row.coefficients) // 10)
            lever = error / float(prior[10 * bodies].sum())
            if lever > _FARTHEST * _size_of(robot):
                yield Verdict(
                    "measured-scale",
                    Grade.WRONG,
                    f"{row.name} would lie {lever:.3g} m from where the prior has it",
                    row.where,
                    "a centre of mass in mm, or a first moment in kg mm or g mm",
                    "give centres in m and first moments in kg m, in the body's link frame",
                    number=lever,
                    unit="m",
                )
        elif ratio < 1 / _FACTOR or (
            ratio > _FACTOR and error > _SPREADS * float(np.linalg.norm(row.coefficients * std))
        ):
            yield _scaled(row, expected, ratio)


def _scaled(row: Weighing, expected: float, ratio: float) -> Verdict:
    """A mass or a moment of inertia of another magnitude."""
    key, unit, number = "measured-scale", row.unit, ratio
    seen = f"{row.name} is {row.value:.3g} {unit}, where the prior has {expected:.3g} {unit}"
    if ratio < 1:
        cause, cure = "a value in another unit, or a prior", f"give it in {unit}"
        return Verdict(key, Grade.DOUBTFUL, seen, row.where, cause, cure, number=number)
    cause, cure, proposals = f"a value in {_UNITS[unit]}", f"give it in {unit}", ()
    if unit == "kg":  # the same in kilograms
        path = re.sub(r"\[(\d+)\]", lambda match: f"[{int(match[1]) - 1}]", row.where)
        values = {"mass": row.value / 1000, "std": row.std / 1000}
        changes = ((f"{path}.{key}", float(f"{value:.12g}")) for key, value in values.items())
        cure, proposals = f"{cure}, and its std as well", (Proposal("robot", tuple(changes)),)
    return Verdict(key, Grade.WRONG, seen, row.where, cause, cure, proposals, number=number)
