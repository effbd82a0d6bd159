"""The pseudo-inertia of a body: moments of points, and when a body cannot exist."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from deltaid.robot.inertia import (
    consistency,
    inertia_parameters,
    pseudo_inertia,
    why_inconsistent,
    with_thickness,
)


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
    assert why_inconsistent(p) == ""


def test_inconsistent_bodies_are_told_why() -> None:
    good = np.array([1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0])
    assert "mass" in why_inconsistent(good * np.array([-1] + [1] * 9))
    assert "triangle" in why_inconsistent(np.array([1.0, 0, 0, 0, 1, 1, 2.5, 0, 0, 0]))
    assert "centre of mass" in why_inconsistent(np.array([1.0, 2, 0, 0, 1, 1, 1, 0, 0, 0]))


def test_plates_lines_and_points_become_barely_solid() -> None:
    plate = np.array([1.0, 0, 0, 0, 0.002, 0.002, 0.004, 0, 0, 0])
    assert consistency(plate) <= 1e-12
    assert consistency(with_thickness(plate)) > 0
    assert np.allclose(with_thickness(plate), plate, rtol=2e-6)
