"""Priors and measured values of bodies in the wrong unit, such as masses in grams."""

import re
from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np

from deltaid.checks.evidence import WRONG_SCALE
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import parameter_layout, prior_deviations, prior_parameters
from deltaid.effects.account import DETECTED
from deltaid.estimation.problem import independent, lengths
from deltaid.estimation.scatter import surprise
from deltaid.levels import NEGLIGIBLE, ROUNDING
from deltaid.model.verdict import Fault, Grade, Proposal, Verdict, graded, listed
from deltaid.recording.survey_checks import FACTOR
from deltaid.robot.body import ExplicitInertia, HollowCylinder, PointMass
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.yaml_edit import place_in_words
from deltaid.sensors.weighings import Weighing, weighings

# Largest and least density [kg/m³]: osmium has 22,600, foam some 30.
_DENSEST, _LIGHTEST = 23_000.0, 10.0
# Largest mass over the cube of the length of arm and strut [kg/m³]: a solid steel block with a side
# of a sixth of this length is doubtful.
_HEAVY = 7850.0 / 6**3
# Largest distance of a centre of mass and radius of gyration, and least radius of gyration of an
# arm or a strut about its first joint, as shares of the body's extent.
_OUTSIDE, _INSIDE = 1.5, 0.02
# Distance from the prior in standard deviations beyond which a measured value that is also `FACTOR`
# times larger is in another unit.
_SPREADS = 30.0
# Least and largest ratio of a rotor's inertia to that of the bodies that its drive moves, or to the
# largest of all drives. A gear that accelerates fastest makes both equal, and the ratio goes with
# the square of the gear. Spindles of fine lead have up to four times this gear, so beyond it is
# doubtful, and fifteen times is wrong. Direct drives that are strong enough to hold a robot have
# some per cent of its inertia, so a thousandth is doubtful.
_IDLE_ROTOR, _LARGE_ROTOR, _WRONG_ROTOR = 1e-3, 4.0**2, 15.0**2
_UNITS = {"kg": "grams", "kg m²": "kg mm², kg cm² or g m²"}
_AT_JOINT = {
    False: "give it in kg m² at the joint: the motor's inertia times the square of the gear ratio; "
    "1 kg cm² is 1e-4 kg m², 1 g cm² is 1e-7 kg m²",
    True: "give it in kg at the rail: inertia of motor and spindle or pulley times (2π / lead)²",
}
_MASS = Fault("prior-scale", "kg", "a mass in grams")
_EXTENT = Fault(
    "prior-scale",
    "m",
    cure="give mass in kg, first moments in kg m, moments of inertia in kg m² about the link "
    "frame's origin",
)
_MEASURED = Fault("measured-scale")
_CONTRADICTION = Fault(
    "measured-scale",
    "standard deviations",
    "one of these values, its unit, or what was measured with it (screws, cables, half a joint)",
    "correct it, state a larger std, or delete it",
)
_ROTOR = Fault("prior-scale", "of the robot's inertia")


def checked_inertia(robot: RobotDescription) -> tuple[Verdict, ...]:
    """Verdicts on bodies, and on rotors if all bodies are possible."""
    bodies = checked_priors(robot)
    possible = all(verdict.grade is Grade.GOOD for verdict in bodies)
    return (possible and tuple(checked_rotors(robot))) or bodies


def checked_priors(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each body with an impossible prior, or one that all are possible."""
    poor = list[Verdict | None]()
    for name in robot.body_names:
        prior = robot.bodies[name].prior
        if isinstance(prior, ExplicitInertia):
            poor.append(_explicit(robot, name, prior))
        else:
            poor += [_shape(robot, name, k, shape) for k, shape in enumerate(prior)]
    mass = sum(float(body.prior_parameters()[0]) for body in robot.bodies.values())
    seen = f"{len(robot.bodies)} bodies, together {mass:.3g} kg, go with the lengths"
    return tuple(filter(None, poor)) or (_MASS.good(seen, mass),)


def _shape(
    robot: RobotDescription, name: str, k: int, shape: HollowCylinder | PointMass
) -> Verdict | None:
    """The first implausible number of a shape; others would repeat it."""
    mass, by_density, density = float(shape.parameters()[0]), shape.mass is None, np.nan
    path = f"bodies.{name}.prior[{k}]"
    if isinstance(shape, HollowCylinder):
        density = mass / (np.pi * (shape.outer_radius**2 - shape.inner_radius**2) * shape.length)
    if _LIGHTEST <= density <= _DENSEST or np.isnan(density):
        return _massive(f"{path}.mass", name, mass, size_of(robot), alone=not by_density)
    if density > _DENSEST:
        seen, cause = f"no material has more than {_DENSEST:.3g}", "a mass in grams"
        change, cure = (f"{path}.mass", mass / 1000), "give kilograms and metres"
        if by_density:
            cause, change = "a density in g/m³", (f"{path}.density", density / 1000)
        fits = _LIGHTEST < density / 1000 <= _DENSEST
        cure += "; the same number in grams would fit" * fits
    else:
        seen, cause = "even foam has more", "a mass in tonnes, or radii that are too large"
        change, fits = (f"{path}.density", density * 1000), by_density
        cure = "check mass and radii; they are in kg and m"
        if by_density:
            cause, cure = "a density in g/cm³", "give the density in kg/m³: 1000 times the number"
    return Fault("prior-scale", "kg/m³").judged(
        f"{place_in_words(path)} has a density of {density:.3g} kg/m³; {seen}",
        name,
        density,
        grade=Grade.WRONG if density > _DENSEST else Grade.DOUBTFUL,
        cause=cause,
        cure=cure,
        proposals=_proposed(change) if fits else (),
    )


def _explicit(robot: RobotDescription, name: str, prior: ExplicitInertia) -> Verdict | None:
    """The first implausible number of a body."""
    p, size, lengths = prior.parameters(), size_of(robot), dict[str, float]()
    for i, limb in enumerate(robot.limb_geometry):  # a carriage may have its mass at its frame
        driven, strut = robot.limb_bodies(i)
        lengths = {driven: limb.upper_arm, strut: limb.strut} | lengths
    reach, mass, gyration = lengths.get(name) or size, float(p[0]), RigidBody(p).gyration
    com = float(np.linalg.norm(p[1:4]) / mass)
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
    return _EXTENT.judged(seen, name, length, grade=Grade.WRONG, cause=cause)


def _massive(path: str, name: str, mass: float, size: float, *, alone: bool) -> Verdict | None:
    """A body that is too heavy for limbs of a size [m]; `alone` if its moments may be right."""
    largest = _HEAVY * size**3
    if mass <= largest:
        return None
    fits = alone and mass / 1000 < largest
    return _MASS.judged(
        f"{place_in_words(path)} is {mass:.3g} kg; with limbs of {size:.3g} m few bodies have "
        f"{largest:.3g} kg",
        name,
        mass,
        grade=graded(mass, largest, WRONG_SCALE * largest),
        cure="give kilograms" if alone else "give kilograms, and moments in kg m and kg m²",
        proposals=_proposed((path, mass / 1000)) if fits else (),
    )


def checked_rotors(robot: RobotDescription) -> Iterator[Verdict]:
    """Verdicts on rotors that do not go with the robot's bodies, whose priors must be good."""
    if not robot.rotor_inertia:
        return
    moved, drives = _moved(robot), robot.rotor_drives
    kinds = {drive: robot.is_linear(drive) for drive in robot.drives}
    most = {drive: max(moved[d] for d in moved if kinds[d] == kinds[drive]) for drive in drives}
    large = {drive: robot.rotor_inertia[drive] / most[drive] for drive in drives}
    small = {drive: robot.rotor_inertia[drive] / moved[drive] for drive in drives}
    if heavy := [drive for drive in drives if large[drive] > _LARGE_ROTOR]:
        first = max(heavy, key=lambda drive: large[drive])
        yield _ROTOR.judged(
            f"{_rotor(robot, first)}, {large[first]:.3g} times what the robot has at a drive, "
            f"{most[first]:.3g} {robot.units(first).inertia}",
            listed(heavy),
            large[first],
            grade=graded(large[first], _LARGE_ROTOR, _WRONG_ROTOR),
            cause="a mass in grams" if kinds[first] else "an inertia in kg cm², g cm² or g m²",
            cure=_AT_JOINT[kinds[first]],
        )
    if light := [drive for drive in drives if small[drive] < _IDLE_ROTOR]:
        first = min(light, key=lambda drive: small[drive])
        yield _ROTOR.judged(
            f"{_rotor(robot, first)}, {small[first]:.2g} times what the drive moves, "
            f"{moved[first]:.3g} {robot.units(first).inertia}",
            listed(light),
            small[first],
            cause="the motor's inertia as on its data sheet, without its gear",
            cure=_AT_JOINT[kinds[first]],
        )


def _rotor(robot: RobotDescription, drive: str) -> str:
    return f"rotor_inertia.{drive} is {robot.rotor_inertia[drive]:.3g} {robot.units(drive).inertia}"


def _moved(robot: RobotDescription) -> dict[str, float]:
    """Inertia of all bodies at each drive in the middle of the workspace [kg m² or kg]."""
    e, p = compiled(robot).equations, prior_parameters(robot)
    p[parameter_layout(robot).rotor] = 0.0
    M = np.array(ca.Function("M", [e.z, e.p], [e.M])(robot.home, p))  # once: needs no kernel
    return dict(zip(robot.drives, np.diag(M).tolist(), strict=True))


def _proposed(*changes: tuple[str, float]) -> tuple[Proposal, ...]:
    return (Proposal("robot", tuple((path, float(f"{value:.12g}")) for path, value in changes)),)


def size_of(robot: RobotDescription) -> float:
    """Length of the longest arm and strut together [m]; infinite for a user's own mechanism: a sled
    of a hundred kilograms may move by a few centimetres."""
    return max((limb.upper_arm + limb.strut for limb in robot.limb_geometry), default=np.inf)


def checked_measured(robot: RobotDescription) -> tuple[Verdict, ...]:
    """A verdict on each impossible measured value, or one that all agree with the prior."""
    rows, poor = weighings(robot), list[Verdict]()
    prior, std = prior_parameters(robot), prior_deviations(robot)
    for row in rows:
        expected = float(row.coefficients @ prior)
        error, ratio = abs(row.value - expected), row.value / expected if expected else np.inf
        likely = error <= _SPREADS * float(np.linalg.norm(row.coefficients * std))
        if row.unit == "kg m":
            bodies = np.unique(np.flatnonzero(row.coefficients) // 10)
            lever = error / float(prior[10 * bodies].sum())
            if lever > _OUTSIDE * size_of(robot):
                poor.append(_misplaced(row, lever))
        elif ratio < 1 / FACTOR or (ratio > FACTOR and not likely):
            poor.append(_scaled(row, expected, ratio))
    poor += _contradiction(rows)
    if poor or not rows:
        return tuple(poor)
    first, (several, go) = next(iter(rows)).name, ("s", "go") if len(rows) > 1 else ("", "goes")
    seen = f"{len(rows)} measured value{several}, as {first}, {go} with the description"
    return (_MEASURED.good(seen),)


def _contradiction(rows: Sequence[Weighing]) -> Iterator[Verdict]:
    """The measured value that agrees least with all others, if these determine it."""
    if not rows:
        return
    A = np.array([row.coefficients / row.std for row in rows])
    b = np.array([row.value / row.std for row in rows])
    A /= lengths(A)
    U = A @ independent(A)
    left, free = b - U @ (U.T @ b), 1.0 - np.sum(U**2, axis=1)
    redundant = len(rows) - U.shape[1]
    if redundant < 1 or surprise(float(left @ left), redundant) < DETECTED:
        return
    apart = np.abs(left) / np.sqrt(np.maximum(free, ROUNDING))
    k = int(np.argmax(apart > (1.0 - NEGLIGIBLE) * apart.max()))  # the first of equal ones
    row, others = rows[k], rows[k].std * (b[k] - left[k] / free[k])
    yield _CONTRADICTION.judged(
        f"{row.name} is {row.shown(row.value)} ± {row.std:.2g} {row.unit}, but the other measured "
        f"values say {row.shown(float(others))} {row.unit}",
        row.where,
        float(apart[k]),
    )


def _misplaced(row: Weighing, lever: float) -> Verdict:
    return Fault("measured-scale", "m").judged(
        f"{row.name} would lie {lever:.3g} m from where the prior has it",
        row.where,
        lever,
        grade=Grade.WRONG,
        cause="a centre of mass in mm, or a first moment in kg mm or g mm",
        cure="give centres in m and first moments in kg m, in the body's link frame",
    )


def _scaled(row: Weighing, expected: float, ratio: float) -> Verdict:
    unit, cure, proposals = row.unit, f"give it in {row.unit}", ()
    if ratio > 1 and unit == "kg":  # the same in kilograms
        path = re.sub(r"\[(\d+)\]", lambda match: f"[{int(match[1]) - 1}]", row.where)
        changes = (f"{path}.mass", row.value / 1000), (f"{path}.std", row.std / 1000)
        cure, proposals = f"{cure}, and its std as well", _proposed(*changes)
    return _MEASURED.judged(
        f"{row.name} is {row.value:.3g} {unit}, where the prior has {expected:.3g} {unit}",
        row.where,
        ratio,
        grade=Grade.WRONG if ratio > 1 else Grade.DOUBTFUL,
        cause=f"a value in {_UNITS[unit]}" if ratio > 1 else "a value in another unit, or a prior",
        cure=cure,
        proposals=proposals,
    )
