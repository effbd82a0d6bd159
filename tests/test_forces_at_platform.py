"""Forces at the platform that a description lacks: springs, cables, hoses."""

from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.effects.at_platform import Cable, ConstantForce, platform_forces
from deltaid.effects.cable_search import _explained, largest_cable
from deltaid.effects.point import TracePoint
from deltaid.estimation.shrinkage import Shrunk
from deltaid.identification.study import studied_trace
from deltaid.model.parameter_record import Parameter
from deltaid.robot.load import load_robot
from drives import case
from drives.identify import identified
from drives.judge import judge
from identified import identified as clean

KINDS = ("clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "par4")


def parameters(*values: float) -> list[Parameter]:
    """Parameters of these values, known to ± 1."""
    return [
        Parameter(
            name="k",
            value=value,
            std=0.5,
            low=value - 1,
            high=value + 1,
            unit="",
            prior=0.0,
            determined_by="data",
        )
        for value in values
    ]


def potentials(x: np.ndarray) -> np.ndarray:
    """V of each column of a force without drag, F = −∂V/∂x."""
    squares = 0.5 * x**2
    springs = [squares.sum(axis=1), *-x.T, *(squares[:, :2] - squares[:, 2:]).T]
    coupled = [x[:, 0] * x[:, 1], x[:, 0] * x[:, 2], x[:, 1] * x[:, 2]]
    return np.array([*-x.T, *springs, *coupled])


@pytest.mark.parametrize("name", KINDS)
def test_forces_do_the_work_that_drives_have_to_do(name: str) -> None:
    """τ·dq = dV along any small step, and −F·dx for drag, with positions by inverse kinematics
    alone."""
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(1)
    kinematics = dynamics.kinematics
    z = kinematics.home + 0.02 * rng.standard_normal((6, dynamics.dof))
    qd, step = rng.standard_normal((6, dynamics.dof)), 1e-6
    moves = rng.standard_normal((6, dynamics.dof))
    dq = (kinematics.inverse(z + step * moves) - kinematics.inverse(z - step * moves)) / (2 * step)
    x, dx = z[:, :3] - kinematics.home[:3], moves[:, :3]
    dV = (potentials(x + step * dx) - potentials(x - step * dx)) / (2 * step)
    v = np.linalg.solve(kinematics.jacobian(z), qd[:, :, None])[:, :3, 0]
    against = np.sum(v * dx, axis=1)
    expected = np.array([*dV, against / np.linalg.norm(v, axis=1), against])
    forces = platform_forces(dynamics, 1e-3)
    torques = [force.of_motion(z, qd, qd).reshape(-1, dynamics.dof, 6) for force in forces]
    work = np.sum(np.concatenate(torques) * dq.T, axis=1)
    assert work == pytest.approx(expected, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("name", KINDS)
def test_columns_of_a_cable_are_slopes_of_its_energy(name: str) -> None:
    """τ·dq = dV, V = T (ℓ − ‖a‖) + ½ k (ℓ − ‖a‖)², by T, k and a."""
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(2)
    kinematics = dynamics.kinematics
    z = kinematics.home + 0.02 * rng.standard_normal((6, dynamics.dof))
    moves, step = rng.standard_normal((6, dynamics.dof)), 1e-6
    dq = (kinematics.inverse(z + step * moves) - kinematics.inverse(z - step * moves)) / (2 * step)
    x, dx = z[:, :3] - kinematics.home[:3], step * moves[:, :3]

    def energy_gained(T: float, k: float, a: np.ndarray) -> np.ndarray:
        longer = np.linalg.norm(a - np.stack([x + dx, x - dx]), axis=2) - np.linalg.norm(a)
        V = T * longer + 0.5 * k * longer**2
        return (V[0] - V[1]) / (2 * step)

    a, T, k, near = np.array([0.3, -0.5, 0.4]), 3.0, 40.0, 1e-4 * np.eye(3)
    cable = Cable(dynamics, (), (1.0,) * 5, (*a.tolist(), T, k))
    torques = cable.of_motion(z, z, z).reshape(-1, dynamics.dof, 6)
    of_anchor = [(energy_gained(T, k, a + e) - energy_gained(T, k, a - e)) / 2e-4 for e in near]
    expected = np.array([energy_gained(1.0, 0.0, a), energy_gained(0.0, 1.0, a), *of_anchor])
    assert np.sum(torques * dq.T, axis=1) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def beside_others(x: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Without what forces that are constant or linear in the height, and weights that are linear in
    x, explain."""
    constant, by_height = (
        np.kron(column, np.eye(3)) for column in (np.ones((len(x), 1)), x[:, 2:])
    )
    weights = np.kron(x[:, :1], np.eye(3)[:, 2:])
    Q = np.linalg.qr(np.hstack([constant, by_height, weights]))[0]
    return forces - Q @ (Q.T @ forces)


@pytest.mark.parametrize(
    ("pull", "is_cable", "seed"),
    [(5.0, True, 1), (5.0, True, 9), (5.0, True, 17), (1e-4, False, 1), (-5.0, False, 1)],
)
def test_a_cable_is_found_if_it_pulls(pull: float, is_cable: bool, seed: int) -> None:
    """From any direction, also where another direction far away explains more than those near it;
    seeds 1, 9 and 17 have several maxima."""
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(seed)
    way = rng.standard_normal(3)
    true = way / np.linalg.norm(way) * rng.uniform(0.7, 2.4)
    x = np.random.default_rng(0).uniform(-0.2, 0.2, (60, 3))
    point = Mock(spec=TracePoint, dynamics=dynamics, motion=Mock(z=dynamics.kinematics.home + x))
    # As if each drive moved the platform along one axis.
    point.added.return_value = np.tile(np.eye(3)[:, None], (1, len(x), 1))
    length = np.linalg.norm(true - x, axis=1, keepdims=True)
    tension = pull + 30.0 * (length - np.linalg.norm(true))
    forces = beside_others(x, (tension * (true - x) / length).ravel())

    def explained(
        numbers: object, sets: list[np.ndarray], alike: float
    ) -> tuple[np.ndarray, np.ndarray]:
        each = np.moveaxis(np.stack(sets, axis=1), 2, 0)
        columns = [beside_others(x, A.reshape(-1, 2)) for A in each]
        fits = [np.linalg.lstsq(A, forces, rcond=None)[0] for A in columns]
        left = [forces - A @ fit for A, fit in zip(columns, fits, strict=True)]
        return forces @ forces - np.sum(np.square(left), axis=1), np.array(fits)

    cable = largest_cable([point], Mock(spec=Shrunk, explained=explained))
    assert bool(cable) == is_cable
    if cable:
        assert isinstance(cable.addition, Cable)
        assert cable.addition.orders == pytest.approx((*true, pull, 30.0), rel=0.05, abs=0.05)


def test_the_search_has_the_filtered_torques_of_a_cable() -> None:
    """Of one that is 0.8 m away, in each drive."""
    result = clean("clavel-delta3").result
    trace = studied_trace(result.problem.dynamics, result.recordings[0], result.model.p)
    assert trace is not None
    point, fit = TracePoint(trace, result.model.p), Mock(spec=Shrunk)
    fit.explained.return_value = np.zeros(1), np.zeros((1, 2))
    anchor = np.array([0.48, 0.0, 0.64])
    task, home = trace.dynamics.robot.task, trace.dynamics.kinematics.home
    pull = point.added(ConstantForce(trace.dynamics, (), (1.0,) * 3))
    _explained(fit, [task.point(point.motion.z) - task.point(home)], [pull], anchor[None])
    searched = np.stack(fit.explained.call_args.args[1])[:, :, 0]
    cable = Cable(trace.dynamics, (), (1.0,) * 5, (*anchor.tolist(), 0.0, 0.0))
    exact = point.added(cable)[:, :, :2]
    error = np.linalg.norm(searched - exact, axis=1)
    assert np.all(error < 0.02 * np.linalg.norm(exact, axis=1))


def test_a_cable_is_corrected_as_its_stiffness_and_its_pull_at_home() -> None:
    dynamics = compiled(load_robot("clavel-delta3"))
    cable = Cable(dynamics, (), (1.0,) * 5, (0.0, 0.6, 0.8, 5.0, 30.0))
    spring, pull = cable.to_corrections(parameters(5.0, 30.0, 0.1, 0.0, 0.0))
    assert (spring.kind, spring.value, spring.low) == ("platform-spring", 30.0, 29.0)
    assert spring.unit == "N/m"
    assert (pull.kind, pull.unit) == ("platform-force", "N")
    # the anchor is 0.1 m to the side, so that the pull turns by 0.1 rad
    assert pull.value == pytest.approx(5.0 * np.hypot(1.0, 0.1))
    assert "along (0.10, 0.60, 0.80)" in pull.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "kinds"),
    [
        ("force", {"platform-force"}),
        ("balancer", {"drive-spring"}),
        ("cable", {"platform-spring", "platform-force"}),
    ],
)
def test_what_pulls_is_no_fault_of_drives_or_geometry(row: str, kinds: set[str]) -> None:
    """Zeros and gains mimic a force that springs make needless at first, springs at the platform
    those at the drives, and lengths, ripples and friction laws a cable."""
    made = case(row, "delta3", 1)
    judged = judge(made, identified(made))
    assert set(dict(judged.said)) == kinds
    assert judged.M < 0.005
    assert judged.friction_shape < 0.005


def test_springs_at_the_platform_are_corrections_by_their_largest_stiffness() -> None:
    dynamics = compiled(load_robot("clavel-delta3"))
    _, isotropic, anisotropic, _ = platform_forces(dynamics, 1.0)
    judged = parameters(2.0, -7.0, 3.0, 4.0, 0.0)
    (uneven,) = anisotropic.to_corrections(judged)
    assert (uneven.value, uneven.low, uneven.unit) == (-7.0, -8.0, "N/m")
    spring, pull = isotropic.to_corrections(judged[1:])
    assert (spring.kind, spring.value, spring.unit) == ("platform-spring", -7.0, "N/m")
    assert (pull.kind, pull.value, pull.unit) == ("platform-force", 5.0, "N")
    assert "along (0.60, 0.80, 0.00)" in pull.text
