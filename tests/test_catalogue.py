"""The shipped robots: a source for every number, shapes against integration, Table I."""

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.stats import qmc

from deltaid.robot.inertia import INERTIA_NAMES, consistency
from deltaid.robot.load import catalogue, catalogue_text, load_robot
from deltaid.robot.shapes import HollowCylinder, PointMass


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
