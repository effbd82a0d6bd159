"""The MuJoCo oracle against recordings of known truth and against mechanics itself."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from composed import Make, random_composed, random_states
from deltaid.mechanism.kinematics import Kinematics
from oracle.composed import ComposedOracle
from recordings import stored_robot, stored_rows
from support import slope

both_deltas = pytest.mark.parametrize("telescope", [False, True])
State = tuple[np.ndarray, ...]


def _delta(seed: int, telescope: bool, *, lossless: bool = True) -> tuple[ComposedOracle, State]:
    """A Delta without springs, and 20 states z, q, qd, qdd."""
    rng = np.random.default_rng(seed)
    oracle = random_composed(Make(telescope=telescope, unequal=True, springs=False), rng)
    if lossless:
        oracle = replace(oracle, viscous=np.zeros(0), coulomb=np.zeros(0))
    return oracle, random_states(oracle, rng, 20)


def _tangent(oracle: ComposedOracle, z: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Rates of z that go with rates of q."""
    return np.linalg.solve(oracle.jacobian(z), qd)


@pytest.mark.parametrize("name", ["delta3", "delta4"])
def test_recording(name: str) -> None:
    """Torques by another library, as far as that file's own rounding lets them be compared.

    Its joint rates come from a half-angle formula that cancels where the elbow-inward solution of
    some limb passes pi; two rows a period apart then differ by up to 5e-5 rad/s^2 in qdd.
    """
    stored, (q, qd, qdd, tau) = stored_robot(name), stored_rows(name)
    z = Kinematics(stored.robot).forward(q)
    np.testing.assert_allclose(stored.oracle.positions(z), q, rtol=0, atol=1e-12)
    error = np.abs(stored.oracle.inverse_dynamics(z, qd, qdd) - tau).max(axis=1)
    error /= np.abs(tau).max()
    sound = error[inward_solution_from_pi(stored.oracle, z, q) > 3e-3]
    print(f"{name}: median {np.median(error):.1e}, sound {sound.max():.1e}, all {error.max():.1e}")
    assert np.median(error) < 1e-11
    assert len(sound) > 0.95 * len(error)
    assert sound.max() < 1e-8
    assert error.max() < 2e-6


def inward_solution_from_pi(oracle: ComposedOracle, z: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Smallest distance (rad) over the limbs between the other arm angle and pi, for each row."""
    gaps = []
    for angle, limb in zip(q.T, oracle.limbs, strict=False):
        outward, _, up = ((z[:, :3] + limb.seat - limb.base) @ limb.axes).T
        gaps.append(np.abs(2 * np.arctan2(-up, outward) - angle - np.pi))
    return np.min(gaps, axis=0)


@both_deltas
def test_kinematics(telescope: bool) -> None:
    """MuJoCo's own positions and, by a second route, accelerations must close the loops."""
    oracle, states = _delta(0, telescope)
    model, data = oracle._model, oracle._data
    for z, _, qd, qdd in zip(*states, strict=True):
        projection, bias = oracle._set(z, qd)
        assert np.abs(oracle._closure() @ projection).max() < 1e-12
        data.qacc = projection @ qdd + bias
        mujoco.mj_rnePostConstraint(model, data)
        for tie in oracle._ties:
            places = sum(weight * data.site(name).xpos for name, weight in tie.items())
            np.testing.assert_allclose(places, 0, atol=1e-13)
            pulled = sum(weight * _acceleration(oracle, name) for name, weight in tie.items())
            np.testing.assert_allclose(pulled, 0, atol=1e-10)


def _acceleration(oracle: ComposedOracle, site: str) -> np.ndarray:
    out = np.zeros(6)
    model, kind = oracle._model, mujoco.mjtObj.mjOBJ_SITE
    mujoco.mj_objectAcceleration(model, oracle._data, kind, model.site(site).id, out, 0)
    return out[3:]


@both_deltas
def test_strut_axes(telescope: bool) -> None:
    oracle, states = _delta(2, telescope)
    poses = oracle.body_poses(states[0][0])
    for i in range(3):
        upper, strut = poses[f"driven{i}"][0], poses[f"strut{i}+1"][0]
        z = np.cross(strut[:, 0], upper[:, 1])
        np.testing.assert_allclose(strut[:, 2], z / np.linalg.norm(z), atol=1e-14)


@both_deltas
def test_mass_matrix(telescope: bool) -> None:
    oracle, states = _delta(4, telescope)
    for z, _, _, qdd in zip(*states, strict=True):
        mass, rest = oracle.mass_matrix(z), np.zeros_like(z)
        np.testing.assert_allclose(mass, mass.T, atol=1e-13)
        assert np.linalg.eigvalsh(mass)[0] > 0
        inertial = oracle.inverse_dynamics(z, rest, qdd) - oracle.inverse_dynamics(z, rest, rest)
        np.testing.assert_allclose(inertial, mass @ qdd, atol=1e-11)


@both_deltas
def test_power_is_the_rate_of_energy(telescope: bool) -> None:
    oracle, states = _delta(6, telescope)
    z, _, qd, qdd = (part[0] for part in states)
    zd = _tangent(oracle, z, qd)

    def energy(t: np.ndarray) -> float:
        pose = z + zd * t
        return oracle.kinetic_energy(pose, qd + qdd * t) + oracle.potential_energy(pose)

    rate = slope(energy, np.zeros(1), np.ones(1))
    assert oracle.inverse_dynamics(z, qd, qdd) @ qd == pytest.approx(rate, rel=1e-7)


def test_velocity_torques_by_lagrange() -> None:
    """Every component, by differences: C qd = Mdot qd - d(qd M qd / 2)/dq, and g = dV/dq."""
    oracle, states = _delta(8, True)
    z, _, qd, _ = (part[0] for part in states)
    rest, axes = np.zeros(4), [_tangent(oracle, z, axis) for axis in np.eye(4)]
    lagrange = slope(oracle.mass_matrix, z, _tangent(oracle, z, qd), 1e-3) @ qd
    lagrange -= [slope(lambda x: oracle.kinetic_energy(x, qd), z, axis, 1e-3) for axis in axes]
    weight = [slope(oracle.potential_energy, z, axis, 1e-3) for axis in axes]
    still = oracle.inverse_dynamics(z, rest, rest)
    np.testing.assert_allclose(still, weight, rtol=1e-7, atol=1e-8)
    moving = oracle.inverse_dynamics(z, qd, rest)
    np.testing.assert_allclose(moving - still, lagrange, rtol=1e-7, atol=1e-7)


def test_friction_of_the_slide_is_dissipated_along_the_bar() -> None:
    lossy, states = _delta(10, True, lossless=False)
    free = replace(lossy, viscous=np.zeros(0), coulomb=np.zeros(0))
    z, _, qd, qdd = (part[0] for part in states)
    top, bottom = lossy.telescope
    rate = slope(lambda x: np.linalg.norm(top - x[:3] - bottom), z, _tangent(lossy, z, qd))
    v = np.append(qd, rate)
    power = v @ (lossy.viscous * v + lossy.coulomb * np.sign(v))
    tau = lossy.inverse_dynamics(z, qd, qdd) - free.inverse_dynamics(z, qd, qdd)
    assert tau @ qd == pytest.approx(power, rel=1e-8)
