"""What a residual says of pushes, against noise drawn by the thousand; weak pushes for a minute."""

import casadi as ca
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.signal import lfilter
from scipy.stats import chi2

import deltaid
from deltaid.errors import DeltaidError
from deltaid.online.contact import ContactResidual, contact, least_force, threshold
from deltaid.online.settings import OnlineSettings
from shuttling import RATE, Shuttle, shuttle

S = np.array([[0.5, 0.1, 0.0, 0.02], [0.1, 0.4, -0.1, 0.0], [0.0, -0.1, 0.6, 0.03],
              [0.02, 0.0, 0.03, 0.05]])  # fmt: skip
# ∂(platform point)/∂q of a robot with a drive that turns its tool only.
T = np.array([[0.3, -0.1, -0.2, 0.0], [0.05, 0.25, -0.3, 0.0], [-0.2, -0.15, -0.25, 0.0]])
U = 6.0


def judged(
    rho: ArrayLike,
    bound: ArrayLike = (0, 0, 0, 0),
    before: float = 0.0,
    lifted: ArrayLike | None = None,
    light: float = 0.0,
    heavy: float = 0.0,
) -> dict[str, np.ndarray]:
    """A residual judged in numbers."""
    column = np.zeros(4) if lifted is None else lifted
    parts = [ca.SX(ca.DM(np.array(x))) for x in (rho, S, bound, T, column)]
    residual = ContactResidual(*parts, ca.SX(light), ca.SX(heavy))
    found = contact(residual, ca.SX(before), U)
    names = ("size", "detected", "limb", "force", "effort", "information")
    f = ca.Function("f", [], [getattr(found, name) for name in names])
    return dict(zip(names, (np.array(x).squeeze() for x in f.call([])), strict=True))


@pytest.mark.parametrize("dof", [1, 3, 4])
@pytest.mark.parametrize("corner", [30.0, 100.0])
def test_false_alarms_are_as_many_as_stated(dof: int, corner: float) -> None:
    rng, rate, hours = np.random.default_rng(dof), 1000.0, 1.0
    a = np.exp(-corner / rate)
    noise = rng.standard_normal((dof, round(3600 * hours * rate))) * np.sqrt(1 - a * a)
    size = np.sqrt(sum(lfilter([1.0], [1.0, -a], row) ** 2 for row in noise))
    above = size > threshold(200.0, corner, dof)
    starts = np.flatnonzero(above[1:] & ~above[:-1])
    alarms = 1 + np.sum(np.diff(starts) > 2 * rate / corner)  # those of one excursion count once
    assert 0.2 * 200 * hours < alarms < 1.1 * 200 * hours  # samples miss short excursions


def test_more_drives_and_fewer_alarms_need_more() -> None:
    assert threshold(1.0, 100.0, 3) < threshold(1.0, 100.0, 4)
    assert threshold(10.0, 100.0, 3) < threshold(1.0, 100.0, 3) < threshold(1.0, 200.0, 3)
    with pytest.raises(DeltaidError, match="an hour"):
        threshold(0.0, 100.0, 3)


def test_push_at_the_platform() -> None:
    force = np.array([20.0, -30.0, 10.0])
    found = judged(-T.T @ force)
    assert found["detected"] == 1
    assert found["limb"] == 0
    np.testing.assert_allclose(found["force"], force, rtol=1e-9)
    np.testing.assert_allclose(found["effort"], T.T @ force, rtol=1e-9)


@pytest.mark.parametrize(("share", "limb"), [(0.999, 2), (1.001, 0)])
def test_a_limb_explains_what_leaves_no_more_than_noise(share: float, limb: int) -> None:
    """Of noise of one drive less, in 70 of 100 cases, and of two thousandths of all."""
    W, push = np.linalg.inv(S), 20.0 * np.eye(4)[1]
    left = np.array([1.0, 0.0, 0.0, 0.0])
    left -= (W[1] @ left) / W[1, 1] * np.eye(4)[1]  # nothing of it is explained by drive 2
    most = (chi2.ppf(0.7, 3) + 0.002 * push @ W @ push) / (1 - 0.002)
    left *= np.sqrt(share * most / (left @ W @ left))
    assert judged(push + left)["limb"] == limb


@pytest.mark.parametrize("drive", range(4))
def test_push_at_a_limb(drive: int) -> None:
    rho = 12.0 * np.eye(4)[drive]
    found = judged(rho)
    assert found["detected"] == 1
    assert found["limb"] == drive + 1
    assert found["effort"][drive] == pytest.approx(-12.0)


def test_size_is_mahalanobis_distance() -> None:
    rho = np.array([0.3, -0.2, 0.5, 0.1])
    assert judged(rho)["size"] == pytest.approx(np.sqrt(rho @ np.linalg.solve(S, rho)) / U)


def test_no_contact_has_no_place_and_no_force() -> None:
    found = judged([0.1, 0.2, -0.1, 0.0])
    assert found["detected"] == 0
    assert found["limb"] == -1
    np.testing.assert_array_equal(found["force"], 0)


def test_friction_at_rest_is_no_contact() -> None:
    rho = np.array([8.0, -8.0, 8.0, 0.1])
    assert judged(rho)["detected"] == 1
    held = judged(rho, bound=(6.5, 6.5, 6.5, 0.5))
    assert held["detected"] == 0
    assert held["size"] == 0
    more = judged(2 * rho, bound=(6.5, 6.5, 6.5, 0.5))
    assert more["detected"] == 1
    np.testing.assert_allclose(more["effort"][:3], -np.sign(rho[:3]) * (16 - 1.3 * 6.5))


def test_contact_holds_until_it_is_well_below_the_threshold() -> None:
    rho = np.sqrt(S[0, 0]) * 0.7 * U * np.array([1.0, 0, 0, 0])
    assert judged(rho)["detected"] == 0
    assert judged(rho, before=1.0)["detected"] == 1
    assert judged(0.5 * rho, before=1.0)["detected"] == 0


def test_what_a_load_explains_is_no_contact_where_nobody_tells() -> None:
    kilogram = T.T @ np.array([0.0, 0.0, -9.81]) + np.array([0.3, 0.1, -0.2, 0.0])
    assert judged(2.0 * kilogram)["detected"] == 1
    assert judged(2.0 * kilogram, lifted=kilogram, light=-1.0, heavy=3.0)["detected"] == 0
    assert judged(9.0 * kilogram, lifted=kilogram, light=-1.0, heavy=3.0)["detected"] == 1
    assert judged(-4.0 * kilogram, lifted=kilogram, light=-1.0, heavy=3.0)["detected"] == 1
    aside = -T.T @ np.array([40.0, 0.0, 0.0])
    assert judged(aside, lifted=kilogram, light=-1.0, heavy=3.0)["detected"] == 1


def test_least_force_is_found_in_95_of_100_cases() -> None:
    rng, u = np.random.default_rng(1), threshold(1.0, 100.0, 4)
    A = T @ np.linalg.solve(S, T.T)
    (best,), (worst,) = least_force(A[None], u)
    _, vectors = np.linalg.eigh(A)
    assert best < worst
    for force, n in ((best, vectors[:, 2]), (worst, vectors[:, 0])):
        rho = T.T @ (force * n) + rng.multivariate_normal(np.zeros(4), S, size=20000)
        found = np.einsum("ki,ij,kj->k", rho, np.linalg.inv(S), rho) > u * u
        assert 0.95 <= found.mean() < 0.98  # noise aside of n adds to χ as well


@pytest.mark.parametrize("drive", range(3))
def test_place_does_not_suffer_from_a_load_that_nobody_declared(drive: int) -> None:
    kilogram = T.T @ np.array([0.0, 0.0, -9.81])
    for mass in (0.0, 1.5):
        rho = 20.0 * np.eye(4)[drive] + mass * kilogram
        found = judged(rho, lifted=kilogram, light=0.0, heavy=3.0)
        assert found["detected"] == 1
        assert found["limb"] == drive + 1
    aside = judged(-T.T @ np.array([40.0, 20.0, 0.0]), lifted=kilogram, light=0.0, heavy=3.0)
    assert aside["limb"] == 0
    np.testing.assert_allclose(aside["force"][:2], (40.0, 20.0), rtol=0.2)


# Seconds without pushes, with weak ones, with strong ones; a push lasts so many rows.
QUIET, WEAK, STRONG, PUSH = 90, 60, 30, 100
# By which the reported limit may grow.
MOST = 1.3


def produced(
    robot: Shuttle, seconds: float, forces: tuple[float, float], seed: int
) -> tuple[np.ndarray, ...]:
    """q, torques, gripper and rows of pushes [N], one a second, of picks with friction that the
    model has not: 20 % of Coulomb more, Stribeck and ripple."""
    rng, rows = np.random.default_rng(seed), len(robot.q)
    count = round(seconds * RATE / rows)
    q, tau, held = robot.rounds(np.exp(rng.uniform(np.log(0.05), 0.0, count)))
    qd = RATE * np.gradient(robot.q, axis=0)
    lacked = 0.2 + 0.3 * np.exp(-((qd / 0.3) ** 2))
    tau += np.tile(robot.coulomb * (robot.sign * lacked + 0.1 * np.sin(12 * robot.q)), (count, 1))
    kinematics = robot.model.dynamics.kinematics
    starts = np.arange(500, len(q) - 500, 1000)
    starts += rng.integers(0, 400, len(starts))
    for first in starts if max(forces) else ():
        force = rng.standard_normal(3)
        force *= rng.uniform(*forces) / np.linalg.norm(force)
        for k in range(first, first + PUSH):
            z = kinematics.forward(robot.q[k % rows])
            tau[k] -= np.linalg.solve(kinematics.jacobian(z).T, force)
    return q, tau, held, starts


def test_a_minute_of_weak_pushes_does_not_make_it_deaf() -> None:
    """With speeds of unknown noise, where how large residuals are is learnt."""
    robot, noise = shuttle(), np.random.default_rng(9)
    settings = OnlineSettings(speed="differenced", largest_mass=1.0)
    online, limits = deltaid.Online(robot.model, settings), []
    u = threshold(settings.false_alarms, settings.corner, 3)
    for seed, (seconds, *forces) in enumerate(((QUIET, 0, 0), (WEAK, 5, 15), (STRONG, 30, 30))):
        q, tau, held, starts = produced(robot, seconds, (forces[0], forces[1]), seed)
        tau += online.known.noise * noise.standard_normal(tau.shape)
        found = online.run(q, None, tau, held)
        information = found.outputs["contact_information"][-6000:].reshape(-1, 3, 3)
        limits.append(np.median(least_force(information, u), axis=1))
        if not forces[0]:
            assert not found.contact.any()
        soon = [found.contact[first : first + 20].any() for first in starts]
        assert forces[1] < 30 or np.mean(soon) >= 0.9  # at rest friction takes up a push
    assert np.all(limits[1] <= MOST * limits[0])
