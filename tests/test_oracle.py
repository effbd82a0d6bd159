"""The MuJoCo oracle against recordings of known truth and against mechanics itself."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from oracle.delta import DeltaOracle, random_oracle
from recordings import stored_oracle, stored_rows


def _oracle(seed: int, telescope: bool, friction: bool = True) -> DeltaOracle:
    return random_oracle(np.random.default_rng(seed), telescope=telescope, friction=friction)


@pytest.mark.parametrize("name", ["delta3", "delta4"])
def test_recording(name: str) -> None:
    """Torques by another library, as far as that file's own rounding lets them be compared.

    Its joint rates come from a half-angle formula that cancels where the elbow-inward solution of
    some limb passes pi; two rows a period apart then differ by up to 5e-5 rad/s^2 in qdd.
    """
    oracle, (q, qd, qdd, tau) = stored_oracle(name), stored_rows(name)
    error = np.abs(oracle.inverse_dynamics(q, qd, qdd) - tau).max(axis=1) / np.abs(tau).max()
    gap = _inward_solution_from_pi(oracle, q)
    sound = error[gap > 3e-3]
    print(f"{name}: median {np.median(error):.1e}, sound {sound.max():.1e}, all {error.max():.1e}")
    assert np.median(error) < 1e-11
    assert len(sound) > 0.95 * len(error)
    assert sound.max() < 1e-8
    assert error.max() < 2e-6


def _inward_solution_from_pi(oracle: DeltaOracle, q: np.ndarray) -> np.ndarray:
    """Smallest distance (rad) over the limbs between the other arm angle and pi, for each row."""
    points, gaps = np.array([oracle.task(row)[:3] for row in q]), []
    for angle, phi in zip(q.T, oracle.azimuths, strict=False):
        outward = points @ [np.cos(phi), np.sin(phi), 0]
        line = np.arctan2(-points[:, 2], outward + oracle.platform_radius - oracle.base_radius)
        gaps.append(np.abs(2 * line - angle - np.pi))
    return np.min(gaps, axis=0)


@pytest.mark.parametrize("telescope", [False, True])
def test_kinematics(telescope: bool) -> None:
    oracle, rng = _oracle(0, telescope), np.random.default_rng(1)
    for _ in range(20):
        z, q, qd, qdd = oracle.random_state(rng)
        np.testing.assert_allclose(oracle.positions(z), q, atol=1e-12)
        projection, bias = oracle._set(q, qd)  # MuJoCo's own kinematics must close the loops
        data, closure = oracle._data, oracle._closure()
        site = {oracle._model.site(k).name: data.site_xpos[k] for k in range(oracle._model.nsite)}
        for k in range(3 + telescope):
            np.testing.assert_allclose(site[f"cut_{k}"], site[f"seat_{k}"], atol=1e-13)
        assert np.abs(closure @ projection).max() < 1e-12
        data.qacc = projection @ qdd + bias
        mujoco.mj_rnePostConstraint(oracle._model, data)
        for k in range(3 + telescope):  # second route to the closing accelerations
            cut, seat = (_acceleration(oracle, f"{name}_{k}") for name in ("cut", "seat"))
            np.testing.assert_allclose(cut, seat, rtol=0, atol=1e-10)


def _acceleration(oracle: DeltaOracle, site: str) -> np.ndarray:
    out = np.zeros(6)
    model, kind = oracle._model, mujoco.mjtObj.mjOBJ_SITE
    mujoco.mj_objectAcceleration(model, oracle._data, kind, model.site(site).id, out, 0)
    return out[3:]


@pytest.mark.parametrize("telescope", [False, True])
def test_strut_axes(telescope: bool) -> None:
    oracle, rng = _oracle(2, telescope), np.random.default_rng(3)
    _, q, qd, _ = oracle.random_state(rng)
    oracle._set(q, qd)
    for i in range(3):
        upper = oracle._data.body(f"U{i}").xmat.reshape(3, 3)
        strut = oracle._data.body(f"S{i}").xmat.reshape(3, 3)
        z = np.cross(strut[:, 0], upper[:, 1])
        np.testing.assert_allclose(strut[:, 2], z / np.linalg.norm(z), atol=1e-14)


@pytest.mark.parametrize("telescope", [False, True])
def test_mass_matrix(telescope: bool) -> None:
    oracle, rng = _oracle(4, telescope, friction=False), np.random.default_rng(5)
    for _ in range(20):
        _, q, _, qdd = oracle.random_state(rng)
        mass, rest = oracle.mass_matrix(q), np.zeros_like(q)
        np.testing.assert_allclose(mass, mass.T, atol=1e-13)
        assert np.linalg.eigvalsh(mass)[0] > 0
        inertial = oracle.inverse_dynamics(q, rest, qdd) - oracle.inverse_dynamics(q, rest, rest)
        np.testing.assert_allclose(inertial, mass @ qdd, atol=1e-11)


@pytest.mark.parametrize("telescope", [False, True])
def test_power_is_the_rate_of_energy(telescope: bool) -> None:
    oracle, rng = _oracle(6, telescope, friction=False), np.random.default_rng(7)
    _, q, qd, qdd = oracle.random_state(rng)

    def energy(t: float) -> float:
        at, rate = q + qd * t + qdd * t**2 / 2, qd + qdd * t
        return oracle.kinetic_energy(at, rate) + oracle.potential_energy(at)

    h = 1e-3
    steps, weights = np.array([-2, -1, 1, 2]) * h, np.array([1, -8, 8, -1]) / (12 * h)
    rate = weights @ [energy(t) for t in steps]
    assert oracle.inverse_dynamics(q, qd, qdd) @ qd == pytest.approx(rate, rel=1e-7)


def test_velocity_torques_by_lagrange() -> None:
    """Every component, by differences: C qd = Mdot qd - d(qd M qd / 2)/dq, and g = dV/dq."""
    oracle, rng = _oracle(8, True, friction=False), np.random.default_rng(9)
    _, q, qd, _ = oracle.random_state(rng)
    h, rest = 1e-3, np.zeros(4)

    def slope(f: Callable[[np.ndarray], Any], along: np.ndarray) -> Any:
        steps = ((-2, 1), (-1, -8), (1, 8), (2, -1))
        return sum(w * f(q + s * h * along) for s, w in steps) / (12 * h)

    lagrange = slope(oracle.mass_matrix, qd) @ qd
    lagrange -= [slope(lambda x: oracle.kinetic_energy(x, qd), e) for e in np.eye(4)]
    weight = [slope(oracle.potential_energy, e) for e in np.eye(4)]
    still = oracle.inverse_dynamics(q, rest, rest)
    np.testing.assert_allclose(still, weight, rtol=1e-7, atol=1e-8)
    moving = oracle.inverse_dynamics(q, qd, rest)
    np.testing.assert_allclose(moving - still, lagrange, rtol=1e-7, atol=1e-7)


def test_friction_of_the_slide_is_dissipated_along_the_bar() -> None:
    lossy, rng = _oracle(10, True), np.random.default_rng(11)
    free = _oracle(10, True, friction=False)
    _, q, qd, qdd = lossy.random_state(rng)
    h = 1e-6
    length = [np.linalg.norm(lossy.task(q + s * h * qd)[:3]) for s in (-1, 1)]
    v = np.append(qd, (length[1] - length[0]) / (2 * h))
    power = v @ (lossy.viscous * v + lossy.coulomb * np.sign(v))
    tau = lossy.inverse_dynamics(q, qd, qdd) - free.inverse_dynamics(q, qd, qdd)
    assert tau @ qd == pytest.approx(power, rel=1e-8)
