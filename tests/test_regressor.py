"""Columns of the regressor: linear in the parameters, those of friction, and how many there are."""

from __future__ import annotations

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from generic_robots import case, every_case, generic_states
from support import assert_close, random_twin, slope


@every_case
def test_torque_is_linear_in_the_parameters(name: str) -> None:
    c = case(name)
    a, b = np.random.default_rng(11).standard_normal((2, c.p.size))
    of = [c.dynamics.inverse_dynamics(c.q, c.qd, c.qdd, p) for p in (a, b, 2.5 * a - b)]
    assert_close(of[2], 2.5 * of[0] - of[1], 1e-12)
    Y = c.dynamics.regressor(c.q, c.qd, c.qdd)
    column = np.random.default_rng(12).integers(c.p.size)
    unit = c.dynamics.inverse_dynamics(c.q, c.qd, c.qdd, np.eye(c.p.size)[column])
    assert_close(Y[:, :, column], unit, 1e-12)


@every_case
def test_friction_columns_of_a_drive(name: str) -> None:
    c = case(name)
    names, Y = c.dynamics.layout.names, c.dynamics.regressor(c.q, c.qd, c.qdd)
    for i in range(c.dynamics.dof):
        only = np.eye(c.dynamics.dof)[i]
        viscous = Y[:, :, names.index(f"viscous.drive{i + 1}")]
        coulomb = Y[:, :, names.index(f"coulomb.drive{i + 1}")]
        np.testing.assert_allclose(viscous, c.qd * only, rtol=1e-14, atol=0)
        np.testing.assert_array_equal(coulomb, np.sign(c.qd) * only)
        rotor = Y[:, :, names.index(f"rotor.drive{i + 1}")]
        np.testing.assert_allclose(rotor, c.qdd * only, rtol=1e-14, atol=0)


@pytest.mark.parametrize("name", ["four drives", "offset bar"])
def test_friction_columns_of_the_slide(name: str) -> None:
    """Force times the partial derivatives of the bar's length."""
    c = case(name)
    bar = c.dynamics.robot.telescope

    def length(q: np.ndarray) -> np.ndarray:
        point = c.dynamics.kinematics.forward(q)[:, :3]
        return np.linalg.norm(point + bar.platform_joint - bar.base_joint, axis=1)

    partial = np.transpose([slope(length, c.q, axis) for axis in np.eye(4)])
    speed = np.einsum("si,si->s", partial, c.qd)[:, None]
    names, Y = c.dynamics.layout.names, c.dynamics.regressor(c.q, c.qd, c.qdd)
    assert_close(Y[:, :, names.index("viscous.slide")], partial * speed, 1e-9)
    assert_close(Y[:, :, names.index("coulomb.slide")], partial * np.sign(speed), 1e-9)


def test_friction_is_of_the_described_joints_only() -> None:
    """In the joints' order, whatever the order in the description."""
    robot = random_twin(13, telescope=True).robot
    some = {joint: robot.friction[joint] for joint in ("slide", "drive2")}
    robot = robot.model_copy(
        update={"friction": some, "rotor_inertia": {"drive4": 1e-3, "drive1": 2e-2}}
    )
    dynamics, p = Dynamics(robot), prior_parameters(robot)
    names = ["viscous.drive2", "viscous.slide", "coulomb.drive2", "coulomb.slide"]
    names += ["rotor.drive1", "rotor.drive4"]
    assert list(dynamics.layout.names[60:]) == names
    slide, drive = some["slide"], some["drive2"]
    values = [drive.viscous, slide.viscous, drive.coulomb, slide.coulomb, 2e-2, 1e-3]
    np.testing.assert_array_equal(p[60:], values)
    c = case("four drives")
    Y = dynamics.regressor(c.q[:1], c.qd[:1], c.qdd[:1])[0]
    np.testing.assert_array_equal(Y[:, 64], c.qdd[0] * [1, 0, 0, 0])
    np.testing.assert_array_equal(Y[:, 65], c.qdd[0] * [0, 0, 0, 1])


@every_case
def test_sparse_regressor_holds_the_nonzero_entries(name: str) -> None:
    c = case(name)
    Y = c.dynamics.regressor(c.q, c.qd, c.qdd)
    sparse = c.dynamics.sparse_regressor(c.z, c.qd, c.qdd)
    rest = Y.copy()
    rest[:, sparse.rows, sparse.columns] = 0.0
    assert not rest.any()
    assert_close(sparse.values.T, Y[:, sparse.rows, sparse.columns], 1e-12)
    assert (np.diff(sparse.rows) >= 0).all()


@pytest.mark.parametrize(
    ("robot", "rotor", "columns", "nonzero", "rank"),
    [("irb360", True, 71, 48, 37), ("irb360", False, 70, 47, 37), ("clavel", False, 36, 20, 18)],
)
def test_regressor_counts(
    robot: str, rotor: bool, columns: int, nonzero: int, rank: int, request: pytest.FixtureRequest
) -> None:
    """Columns, columns not identically zero, and rank at generic motions, as in the paper."""
    dynamics: Dynamics = request.getfixturevalue(robot)
    if dynamics.robot.rotor_inertia and not rotor:
        dynamics = Dynamics(dynamics.robot.model_copy(update={"rotor_inertia": {}}))
    _, q, qd, qdd = generic_states(dynamics, 300)
    Y = dynamics.regressor(q, qd, qdd).reshape(-1, len(dynamics.layout.names))
    lengths = np.linalg.norm(Y, axis=0)
    seen = lengths > 1e-12 * lengths.max()
    assert lengths[seen].min() > 1e-6 * lengths.max()  # nothing is doubtful
    values = np.linalg.svd(Y[:, seen] / lengths[seen], compute_uv=False)
    assert (Y.shape[1], seen.sum()) == (columns, nonzero)
    assert values[rank - 1] > 1e-5 * values[0]
    assert values[rank] < 1e-12 * values[0]
