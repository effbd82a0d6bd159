"""Numbers of bodies that do not go with the robot: priors in grams or kg mm², measured values of
another magnitude than the prior, such as of a scale that shows grams."""

import re

import numpy as np

from deltaid.dynamics.parameters import parameter_layout, stated_spreads
from deltaid.model.verdict import Fault, Grade, Proposal, Verdict
from deltaid.robot.body import ExplicitInertia, HollowCylinder, PointMass
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.weighings import Weighing, weighings

# kg/m³. Osmium has 22,600; foam some 30.
_DENSEST, _LIGHTEST = 23_000.0, 10.0
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
_MASS = Fault("prior-scale", "kg", "a mass in grams")
_DENSITY = Fault("prior-scale", "kg/m³")
_EXTENT = Fault(
    "prior-scale",
    "m",
    cure="give mass in kg, first moments in kg m, moments of inertia in kg m² about the link "
    "frame's origin",
)
_MEASURED = Fault("measured-scale")
_CENTRE = Fault(
    "measured-scale",
    "m",
    "a centre of mass in mm, or a first moment in kg mm or g mm",
    "give centres in m and first moments in kg m, in the body's link frame",
)


def checked_priors(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each body whose prior cannot be, or one that all can."""
    verdicts = list[Verdict | None]()
    for name in robot.body_names:
        prior = robot.bodies[name].prior
        if isinstance(prior, ExplicitInertia):
            verdicts.append(_explicit(robot, name, prior))
        else:
            verdicts += [_shape(robot, name, k, shape) for k, shape in enumerate(prior)]
    if wrong := tuple(filter(None, verdicts)):
        return wrong
    mass = sum(float(body.prior_parameters()[0]) for body in robot.bodies.values())
    seen = f"{len(robot.bodies)} bodies, together {mass:.3g} kg, go with the lengths"
    return (_MASS.good(seen, mass),)


def _shape(
    robot: RobotDescription, name: str, k: int, shape: HollowCylinder | PointMass
) -> Verdict | None:
    """The first thing out of scale of a shape: the rest would repeat it."""
    mass, by_density, density = float(shape.parameters()[0]), shape.mass is None, np.nan
    path = f"bodies.{name}.prior[{k}]"
    if isinstance(shape, HollowCylinder):
        density = mass / (np.pi * (shape.outer_radius**2 - shape.inner_radius**2) * shape.length)
    seen = f"{path} has a density of {density:.3g} kg/m³; "
    if density > _DENSEST:
        in_grams = f"{path}.mass", mass / 1000
        if by_density:
            in_grams = f"{path}.density", density / 1000
        fits = density / 1000 > _LIGHTEST
        return _DENSITY.poor(
            f"{seen}no material has more than {_DENSEST:.3g}",
            name,
            density,
            grade=Grade.WRONG,
            cause="a density in g/m³" if by_density else "a mass in grams",
            cure="give kilograms and metres" + "; the same number in grams would fit" * fits,
            proposals=_proposed(in_grams) if fits else (),
        )
    if density < _LIGHTEST and by_density:
        return _DENSITY.poor(
            f"{seen}even foam has more",
            name,
            density,
            cause="a density in g/cm³",
            cure="give the density in kg/m³: 1000 times the number",
            proposals=_proposed((f"{path}.density", density * 1000)),
        )
    if density < _LIGHTEST:
        return _DENSITY.poor(
            f"{seen}even foam has more",
            name,
            density,
            cause="a mass in tonnes, or radii that are too large",
            cure="check mass and radii; they are in kg and m",
        )
    return _massive(f"{path}.mass", name, mass, _size_of(robot), alone=not by_density)


def _explicit(robot: RobotDescription, name: str, prior: ExplicitInertia) -> Verdict | None:
    """The first thing out of scale of a body's numbers."""
    p, size = prior.parameters(), _size_of(robot)
    lengths = dict[str, float]()  # of arms and struts; a carriage may have its mass at its frame
    for i, limb in enumerate(robot.limb_geometry):
        driven, strut = robot.limb_bodies(i)
        lengths = {driven: limb.upper_arm, strut: limb.strut} | lengths
    reach, mass = lengths.get(name) or size, float(p[0])
    com = float(np.linalg.norm(p[1:4]) / mass)
    gyration = RigidBody(p).gyration
    small = bool(lengths.get(name)) and gyration < _INSIDE * reach
    if massive := _massive(f"bodies.{name}.prior.mass", name, mass, size, alone=small):
        return massive
    length, seen = gyration, f"the radius of gyration √(tr Σ/m) is {gyration:.3g} m"
    if com > _OUTSIDE * reach:
        length, seen = com, f"the centre of mass lies {com:.3g} m from the link frame's origin"
        cause = "a first moment in kg mm, or a mass in tonnes"
    elif gyration > _OUTSIDE * reach:
        cause = "moments of inertia in kg mm² or kg cm², or a mass in tonnes"
    elif small:
        cause = "a mass in grams, or moments of inertia that are not in kg m²"
    else:
        return None
    seen += f", {length / reach:.2g} times the body's reach of {reach:.3g} m"
    return _EXTENT.poor(seen, name, length, grade=Grade.WRONG, cause=cause)


def _massive(path: str, name: str, mass: float, size: float, *, alone: bool) -> Verdict | None:
    """A body that is too heavy for limbs of a size [m]; `alone` if its moments may be right."""
    largest = _HEAVY * size**3
    if mass <= largest:
        return None
    grade = Grade.WRONG if mass > _FAR * largest else Grade.DOUBTFUL
    seen = f"{path} is {mass:.3g} kg; with limbs of {size:.3g} m few bodies have {largest:.3g} kg"
    cure = "give kilograms" if alone else "give kilograms, and moments in kg m and kg m²"
    proposals = _proposed((path, mass / 1000)) if alone and mass / 1000 < largest else ()
    return _MASS.poor(seen, name, mass, grade=grade, cure=cure, proposals=proposals)


def _proposed(*changes: tuple[str, float]) -> tuple[Proposal, ...]:
    return (Proposal("robot", tuple((path, float(f"{value:.12g}")) for path, value in changes)),)


def _size_of(robot: RobotDescription) -> float:
    """Length of the longest arm and strut together [m]; a mechanism of the user's own may be of any
    size: a sled of a hundred kilograms moves by a few centimetres."""
    return max((limb.upper_arm + limb.strut for limb in robot.limb_geometry), default=np.inf)


def checked_measured(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each measured value that cannot be, or one that all go with the prior."""
    rows, stated = weighings(robot), stated_spreads(robot)
    parameters = parameter_layout(robot).parameters
    prior = np.array([entry.prior for entry in parameters])
    std = np.array([stated.get(entry.name, PRIOR_SPREAD) * entry.scale for entry in parameters])
    verdicts = list[Verdict]()
    for row in rows:
        expected = float(row.coefficients @ prior)
        error, ratio = abs(row.value - expected), row.value / expected if expected else np.inf
        unlikely = error > _SPREADS * float(np.linalg.norm(row.coefficients * std))
        if row.unit == "kg m":
            bodies = np.unique(np.flatnonzero(row.coefficients) // 10)
            lever = error / float(prior[10 * bodies].sum())
            if lever > _FARTHEST * _size_of(robot):
                seen = f"{row.name} would lie {lever:.3g} m from where the prior has it"
                verdicts.append(_CENTRE.poor(seen, row.where, lever, grade=Grade.WRONG))
        elif ratio < 1 / _FACTOR or (ratio > _FACTOR and unlikely):
            verdicts.append(_scaled(row, expected, ratio))
    if verdicts or not rows:
        return tuple(verdicts)
    first, *_ = rows
    several, go = ("s", "go") if len(rows) > 1 else ("", "goes")
    seen = f"{len(rows)} measured value{several}, as {first.name}, {go} with the description"
    return (_MEASURED.good(seen),)


def _scaled(row: Weighing, expected: float, ratio: float) -> Verdict:
    unit, cure, proposals = row.unit, f"give it in {row.unit}", ()
    seen = f"{row.name} is {row.value:.3g} {unit}, where the prior has {expected:.3g} {unit}"
    grade, cause = Grade.DOUBTFUL, "a value in another unit, or a prior"
    if ratio > 1:
        grade, cause = Grade.WRONG, f"a value in {_UNITS[unit]}"
    if ratio > 1 and unit == "kg":  # the same in kilograms
        path = re.sub(r"\[(\d+)\]", lambda match: f"[{int(match[1]) - 1}]", row.where)
        changes = (f"{path}.mass", row.value / 1000), (f"{path}.std", row.std / 1000)
        cure, proposals = f"{cure}, and its std as well", _proposed(*changes)
    return _MEASURED.poor(
        seen, row.where, ratio, grade=grade, cause=cause, cure=cure, proposals=proposals
    )
