"""Priors of bodies that do not go with the robot's geometry: masses in grams, moments in kg mm²."""

from collections.abc import Iterator

import numpy as np

from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.shapes import HollowCylinder, PointMass

# kg/m³. Osmium has 22,600; foam some 30. What is called a density but is less is in g/cm³.
_DENSEST, _LIGHTEST, _IN_GRAMS = 23_000.0, 10.0, 25.0
# kg/m³ of arm and strut together, cubed: a solid block of steel with a side of a sixth of them is
# hardly part of a robot, and one of four times its mass is not.
_HEAVY, _FAR = 7850.0 / 6**3, 4.0
# Shares of a body's extent: no centre of mass or radius of gyration lies farther out, and that of
# an arm or a strut never so near to its first joint.
_OUTSIDE, _INSIDE = 1.5, 0.02


def checked_priors(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each body whose prior cannot be, or one that all can."""
    found = tuple(verdict for name in robot.body_names for verdict in _body(robot, name))
    if found:
        return found
    mass = sum(float(body.prior_parameters()[0]) for body in robot.bodies.values())
    return (
        Verdict(
            "prior-scale",
            Grade.GOOD,
            f"{len(robot.bodies)} bodies, together {mass:.3g} kg, go with the lengths",
            number=mass,
            unit="kg",
        ),
    )


def _body(robot: RobotDescription, name: str) -> Iterator[Verdict]:
    """The first thing out of scale of each shape, or of numbers: the rest would repeat it."""
    prior = robot.bodies[name].prior
    if isinstance(prior, ExplicitInertia):
        yield from _explicit(robot, name, prior)
        return
    for k, shape in enumerate(prior):
        yield from _shape(f"bodies.{name}.prior[{k}]", name, shape, size_of(robot))


def _shape(
    path: str, name: str, shape: HollowCylinder | PointMass, size: float
) -> Iterator[Verdict]:
    mass = float(shape.parameters()[0])
    if isinstance(shape, HollowCylinder):
        density = mass / (np.pi * (shape.outer_radius**2 - shape.inner_radius**2) * shape.length)
        if density > _DENSEST:
            yield _heavy(path, name, shape, density)
            return
        if density < _LIGHTEST:
            yield _light(path, name, shape, density)
            return
    if mass > _HEAVY * size**3:
        yield _massive(f"{path}.mass", name, mass, size, alone=shape.mass is not None)


def _explicit(robot: RobotDescription, name: str, prior: ExplicitInertia) -> Iterator[Verdict]:
    p, limb = prior.parameters(), _is_limb(robot, name)
    size, extent = size_of(robot), _extent(robot, name)
    com = float(np.linalg.norm(p[1:4]) / p[0])
    gyration = float(np.sqrt(np.trace(pseudo_inertia(p)[:3, :3]) / p[0]))
    if p[0] > _HEAVY * size**3:
        alone = limb and gyration < _INSIDE * extent
        yield _massive(f"bodies.{name}.prior.mass", name, float(p[0]), size, alone=alone)
    elif com > _OUTSIDE * extent:
        seen = f"the centre of mass lies {com:.3g} m from the link frame's origin"
        yield _apart(name, seen, com, extent, "a first moment in kg mm, or a mass in tonnes")
    elif gyration > _OUTSIDE * extent:
        seen = f"the radius of gyration √(tr Σ/m) is {gyration:.3g} m"
        cause = "moments of inertia in kg mm² or kg cm², or a mass in tonnes"
        yield _apart(name, seen, gyration, extent, cause)
    elif limb and gyration < _INSIDE * extent:
        seen = f"the radius of gyration √(tr Σ/m) is {gyration:.3g} m"
        cause = "a mass in grams, or moments of inertia that are not in kg m²"
        yield _apart(name, seen, gyration, extent, cause)


def _heavy(path: str, name: str, shape: HollowCylinder, density: float) -> Verdict:
    key = "mass" if shape.mass is not None else "density"
    value = shape.mass if shape.mass is not None else density
    fits = density / 1000 > _LIGHTEST
    return Verdict(
        "prior-scale",
        Grade.WRONG,
        f"{path} has a density of {density:.3g} kg/m³; no material has more than {_DENSEST:.3g}",
        subject=name,
        cause="a mass in grams" if key == "mass" else "a density in g/m³",
        cure="give kilograms and metres" + "; the same number in grams would fit" * fits,
        proposals=_proposed(f"{path}.{key}", value / 1000) if fits else (),
        number=density,
        unit="kg/m³",
    )


def _light(path: str, name: str, shape: HollowCylinder, density: float) -> Verdict:
    in_grams = shape.density is not None and density < _IN_GRAMS
    return Verdict(
        "prior-scale",
        Grade.DOUBTFUL,
        f"{path} has a density of {density:.3g} kg/m³; even foam has more",
        subject=name,
        cause="a density in g/cm³" if in_grams else "a mass in tonnes, or radii that are too large",
        cure="give the density in kg/m³: 1000 times the number"
        if in_grams
        else "check mass and radii; they are in kg and m",
        proposals=_proposed(f"{path}.density", density * 1000) if in_grams else (),
        number=density,
        unit="kg/m³",
    )


def _massive(path: str, name: str, mass: float, size: float, *, alone: bool) -> Verdict:
    """`alone`: whether the mass may be wrong and the moments right."""
    most = _HEAVY * size**3
    return Verdict(
        "prior-scale",
        Grade.WRONG if mass > _FAR * most else Grade.DOUBTFUL,
        f"{path} is {mass:.3g} kg; with limbs of {size:.3g} m few bodies have {most:.3g} kg",
        subject=name,
        cause="a mass in grams",
        cure="give kilograms" if alone else "give kilograms, and moments in kg m and kg m²",
        proposals=_proposed(path, mass / 1000) if alone and mass / 1000 < most else (),
        number=mass,
        unit="kg",
    )


def _apart(name: str, seen: str, length: float, extent: float, cause: str) -> Verdict:
    return Verdict(
        "prior-scale",
        Grade.WRONG,
        f"{seen}, {length / extent:.2g} times the body's reach of {extent:.3g} m",
        subject=name,
        cause=cause,
        cure="give mass in kg, first moments in kg m, moments of inertia in kg m² about the link "
        "frame's origin",
        number=length,
        unit="m",
    )


def _proposed(path: str, value: float) -> tuple[Proposal, ...]:
    return (Proposal("robot", ((path, float(f"{value:.12g}")),)),)


def _is_limb(robot: RobotDescription, name: str) -> bool:
    """Whether a body is an arm or a strut; a carriage may have its mass where its frame is."""
    limbs = enumerate(robot.limb_geometry)
    return any(name in robot.limb_bodies(i)[0 if limb.upper_arm else 1 :] for i, limb in limbs)


def _extent(robot: RobotDescription, name: str) -> float:
    """How far a body may extend from its link frame's origin [m]."""
    for i, limb in enumerate(robot.limb_geometry):
        driven, strut = robot.limb_bodies(i)
        if name == strut:
            return limb.strut
        if name == driven and limb.upper_arm:
            return limb.upper_arm
    return size_of(robot)


def size_of(robot: RobotDescription) -> float:
    """Length of the longest arm and strut together [m].

    A mechanism of the user's own has no limbs that are known, so it may be of any size: a sled of a
    hundred kilograms moves by a few centimetres.
    """
    if not robot.limb_geometry:
        return np.inf
    return max(limb.upper_arm + limb.strut for limb in robot.limb_geometry)
