"""The shipped robots: sources of numbers, shapes against integration, what their makers publish."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML
from scipy.stats import qmc

from deltaid.control.controllers import ControlModel
from deltaid.control.infeasible import motion_problems, tracking_problems
from deltaid.control.tracking import Drives, gains, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.limits import AtRest
from deltaid.model.model import Model, load
from deltaid.motion.random_motion import random_motion, tamed
from deltaid.robot.body import HollowCylinder, PointMass
from deltaid.robot.inertia import (
    INERTIA_NAMES,
    RigidBody,
    consistency,
    inertia_parameters,
    pseudo_inertia,
)
from deltaid.robot.limits import Cylinder
from deltaid.robot.load import catalogue, catalogue_text, load_robot
from support import KINDS
from sweeps import swept


def number_paths(node: object, path: str = "") -> list[str]:
    """Dotted paths of all numbers of a tree."""
    if isinstance(node, dict):
        return [p for k, v in node.items() for p in number_paths(v, f"{path}.{k}" if path else k)]
    if isinstance(node, list):
        return [p for i, v in enumerate(node) for p in number_paths(v, f"{path}.{i}")]
    return [path] if isinstance(node, int | float) else []


@pytest.mark.parametrize("name", catalogue())
def test_every_number_has_a_source(name: str) -> None:
    tree = YAML(typ="safe", pure=True).load(catalogue_text(name))
    sources = tree.pop("sources")
    numbers = number_paths(tree)
    assert len(numbers) >= 50
    without = [n for n in numbers if not any(f"{n}.".startswith(f"{s}.") for s in sources)]
    assert without == []
    unused = [s for s in sources if not any(f"{n}.".startswith(f"{s}.") for n in numbers)]
    assert unused == []
    assert all(len(text.strip()) >= len("assumed") for text in sources.values())


@pytest.mark.parametrize("name", catalogue())
def test_catalogue_robots(name: str) -> None:
    robot = load_robot(name)
    assert robot.name == name
    assert robot.title
    for body in robot.bodies.values():
        assert consistency(body.reduced_prior()) > 0


def sampled_tube(
    length: float, outer: float, inner: float, axis: int, centre: np.ndarray
) -> np.ndarray:
    """Points that fill a tube evenly, by a Sobol sequence."""
    u = qmc.Sobol(3, seed=1).random_base2(16)
    radius = np.sqrt(inner**2 + u[:, 0] * (outer**2 - inner**2))
    points = np.empty((len(u), 3))
    points[:, axis] = (u[:, 1] - 0.5) * length
    points[:, (axis + 1) % 3] = radius * np.cos(2 * np.pi * u[:, 2])
    points[:, (axis + 2) % 3] = radius * np.sin(2 * np.pi * u[:, 2])
    return points + centre


def integrated(mass: float, points: np.ndarray) -> np.ndarray:
    """The ten parameters of evenly spread mass: Θ = ∫ (|r|² I − r rᵀ) dm."""
    Sigma = mass * points.T @ points / len(points)
    Theta = np.trace(Sigma) * np.eye(3) - Sigma
    entries = [Theta[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    return np.array([mass, *(mass * points.mean(axis=0)), *entries])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("inner", [0.0, 0.05, 0.119])
@pytest.mark.parametrize("by_density", [False, True])
def test_tubes_against_integration(axis: int, inner: float, by_density: bool) -> None:
    length, outer, centre, density = 0.4, 0.12, np.array([0.1, -0.25, 0.3]), 1700.0
    mass = density * length * np.pi * (outer**2 - inner**2)
    tube = HollowCylinder(
        shape="hollow_cylinder",
        axis="xyz"[axis],
        length=length,
        outer_radius=outer,
        inner_radius=inner,
        centre=tuple(centre),
        **({"density": density} if by_density else {"mass": mass}),
    )
    points = sampled_tube(length, outer, inner, axis, centre)
    np.testing.assert_allclose(tube.parameters(), integrated(mass, points), rtol=2e-4)


def test_point_masses() -> None:
    centre = np.array([0.1, -0.2, 0.3])
    point = PointMass(shape="point_mass", mass=2.0, centre=tuple(centre))
    np.testing.assert_allclose(point.parameters(), integrated(2.0, centre[None]), rtol=1e-14)


# Table I, column "RG simple", as printed, with its powers of ten. Its row names mc_y (upper arm)
# and mc_x (telescope) are misprints for mc_x and mc_z.
TABLE_I = {
    "U": {"mcx": "0.250", "mcz": "0.000", "Iyy": "0.084"},
    "S": {"m": "0.200", "mcx": "0.111", "Ixx": "0.003e-3", "Iyy": "0.082", "Izz": "0.082"},
    "P": {"m": "0.800"},
    "TU": {"m": "0.900", "mcz": "-0.315", "Ixx": "0.147", "Iyy": "0.147", "Izz": "28.800e-6"},
    "TL": {"m": "0.600", "mcz": "0.234", "Ixx": "0.122", "Iyy": "0.122", "Izz": "78.000e-6"},
}


@pytest.mark.parametrize("body", TABLE_I)
def test_priors_of_the_irb360_are_those_of_table_i(body: str) -> None:
    p = load_robot("irb360-6-1600").bodies[body].reduced_prior()
    for name, printed in TABLE_I[body].items():
        digits, _, power = printed.partition("e")
        value = p[INERTIA_NAMES.index(name)] / float(f"1e{power or 0}")
        assert f"{value + 0.0:.3f}" == digits, name


@given(seed=st.integers(0, 2**32 - 1))
def test_pseudo_inertia_is_the_matrix_of_moments_of_a_cloud_of_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, r = rng.uniform(0.1, 1, 6), rng.standard_normal((6, 3))
    homogeneous = np.column_stack([r, np.ones(6)])
    M = np.einsum("i,ij,ik->jk", m, homogeneous, homogeneous)
    Theta = np.einsum("i,ijk->jk", m, [(a @ a) * np.eye(3) - np.outer(a, a) for a in r])
    p = inertia_parameters(M)
    assert np.allclose(pseudo_inertia(p), M)
    upper = [Theta[0, 0], Theta[1, 1], Theta[2, 2], Theta[0, 1], Theta[1, 2], Theta[0, 2]]
    assert np.allclose(p, [m.sum(), *(m @ r), *upper])
    assert consistency(p) > 0
    assert RigidBody(p).why_inconsistent == ""


def test_inconsistent_bodies_get_the_reason() -> None:
    good = np.array([1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0])
    assert "mass" in RigidBody(good * np.array([-1] + [1] * 9)).why_inconsistent
    thin, far = [1.0, 0, 0, 0, 1, 1, 2.5, 0, 0, 0], [1.0, 2, 0, 0, 1, 1, 1, 0, 0, 0]
    assert "triangle" in RigidBody(np.array(thin)).why_inconsistent
    assert "centre of mass" in RigidBody(np.array(far)).why_inconsistent


def test_plates_lines_and_points_become_barely_solid() -> None:
    plate = np.array([1.0, 0, 0, 0, 0.002, 0.002, 0.004, 0, 0, 0])
    assert consistency(plate) <= 1e-12
    solid = RigidBody(plate).with_thickness().p
    assert consistency(solid) > 0
    assert np.allclose(solid, plate, rtol=2e-6)


MACHINES = tuple(name for name in catalogue() if name not in KINDS)
# Diameter and height of the workspace as the maker has it [m], and how much more than this height
# may be within reach at the full diameter, as a factor: little where the ends of the drives are
# known. None where the workspace tapers and its height is that of the middle.
PUBLISHED = {
    "abb-irb360-1-1130": (1.130, 0.250, 1.03),
    "anycubic-kossel": (0.240, 0.300, None),
    "delta-x-2": (0.320, 0.200, None),
    "fanuc-dr-3ib-8l": (1.600, 0.500, 1.35),
    "flsun-qq-s": (0.260, 0.372, None),
}


# A Delta of 3 axes and a linear one; the others' numbers differ, not what is done with them.
FEW = ("delta-x-2", "anycubic-kossel")


@pytest.fixture(scope="module", params=swept(MACHINES, *FEW))
def machine(request: pytest.FixtureRequest) -> Model:
    return load(request.param)


def reached(at_rest: AtRest, radius: float) -> float:
    """Height over which a circle about z lies within reach and the machine's own ends [m]."""
    robot, angles = at_rest.robot, np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    heights = np.linspace(-3.0 * robot.limb_geometry[0].strut, 0.0, 1200)
    points = np.array([[*xy, z] for z in heights for xy in circle])
    poses = at_rest(np.pad(points, ((0, 0), (0, len(robot.drives) - 3))))
    own = [i for i, name in enumerate(at_rest.limits) if "workspace" not in name]
    own = [i for i in own if "telescope" not in at_rest.limits[i]]  # assumed from the workspace
    good = poses.stands & np.all(poses.shares[:, own] <= 1.0, axis=1)
    level = heights[good.reshape(len(heights), -1).all(axis=1)]
    return float(np.ptp(level)) if len(level) else 0.0


def test_there_are_at_least_four_makers() -> None:
    assert set(MACHINES) == set(PUBLISHED)
    makers = {load(name).robot.title.split()[0] for name in MACHINES}
    assert len(makers) == len(MACHINES) >= 5


def test_the_published_workspace_is_reached(machine: Model) -> None:
    robot = machine.robot
    diameter, height, full = PUBLISHED[robot.name]
    assert isinstance(robot.workspace, Cylinder)
    assert robot.workspace.radius == diameter / 2
    low, high = robot.workspace.z
    assert (0.97 * height if full else 0.75 * height) <= high - low <= height
    at_rest = AtRest(machine.dynamics, machine.p)
    rim, axis = reached(at_rest, diameter / 2), reached(at_rest, 0.0)
    if full:
        assert 0.98 * height <= rim <= full * height
    else:
        assert high - low <= rim <= height <= axis
    # Nothing of a machine of another size.
    assert reached(at_rest, 0.65 * diameter) < rim


def test_lengths_have_public_sources(machine: Model) -> None:
    sources = machine.robot.sources
    keys = ("upper_arm", "strut", "base_radius")
    given = [sources[f"limbs.{key}"] for key in keys if f"limbs.{key}" in sources]
    assert len(given) >= 2
    assert all("GitHub" in text for text in given)


def test_it_runs_a_motion_within_its_limits(machine: Model) -> None:
    rng = np.random.default_rng(0)
    motion = tamed(machine.dynamics, machine.p, random_motion(machine.dynamics.kinematics, rng))
    trajectory = MotionTrajectory(machine.dynamics.kinematics, motion, 1.0)
    assert motion_problems(machine, trajectory) == ()
    known = ControlModel(machine.robot, machine.p)
    law = gains("computed-torque", known, trajectory, 20.0)
    followed = track(machine, law, known, trajectory, Drives())
    assert tracking_problems(machine, followed) == ()
    assert followed.error.platform_max < 1e-3


def test_condition_is_as_stated(machine: Model) -> None:
    text = catalogue_text(machine.robot.name)
    stated = re.search(
        r"(\d+) base parameters; condition over the workspace (\d\.\d) to (\d\.\d)", text
    )
    assert stated
    space = machine.robot.workspace
    assert isinstance(space, Cylinder)
    angles, radii = np.linspace(0, 2 * np.pi, 40), np.linspace(0, space.radius, 5)
    flat = np.array([[r * np.cos(t), r * np.sin(t)] for r in radii for t in angles])
    z = np.array([[*xy, h] for xy in flat for h in np.linspace(*space.z, 5)])
    z = np.pad(z, ((0, 0), (0, machine.dynamics.dof - 3)))
    condition = AtRest(machine.dynamics, machine.p)(z).condition
    assert float(stated[2]) == pytest.approx(condition.min(), abs=0.06)
    assert float(stated[3]) == pytest.approx(condition.max(), abs=0.06)
