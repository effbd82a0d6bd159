"""One sample or many: a vector gives what its row gives, without the axis of samples."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

import deltaid
from deltaid.motion.excitation.run import Run
from deltaid.motion.fourier import FourierMotion

NAME = "clavel-delta3"
KINEMATICS, DYNAMICS = deltaid.Kinematics(NAME), deltaid.Dynamics(NAME)
FORWARD, FORCES = deltaid.ForwardDynamics(NAME), deltaid.ConstraintForces(NAME)
Z = np.array([[0.05, 0.02, -0.95], [-0.1, 0.0, -0.9], [0.0, 0.12, -1.0]])
RATE, TORQUE = np.array([[0.4, -0.2, 0.3]] * 3), np.array([[5.0, -3.0, 4.0]] * 3)
Q = KINEMATICS.inverse(Z)

# What is called, with the arrays that go in.
CALLS: dict[str, tuple[Callable[..., Any], tuple[np.ndarray, ...]]] = {
    "inverse": (KINEMATICS.inverse, (Z,)),
    "forward": (KINEMATICS.forward, (Q,)),
    "forward unchecked": (KINEMATICS.forward_unchecked, (Q,)),
    "jacobian": (KINEMATICS.jacobian, (Z,)),
    "jacobian rate": (KINEMATICS.jacobian_rate, (Z, RATE)),
    "condition": (KINEMATICS.condition, (Z,)),
    "regularity": (KINEMATICS.regularity, (Z,)),
    "motion of drives": (KINEMATICS.drive_motion, (Z, RATE, RATE)),
    "poses": (KINEMATICS.poses, (Z,)),
    "regressor": (DYNAMICS.regressor, (Q, RATE, RATE)),
    "inverse dynamics": (DYNAMICS.inverse_dynamics, (Q, RATE, RATE)),
    "torque": (DYNAMICS.torque, (Z, RATE, RATE)),
    "what gears carry": (DYNAMICS.carried, (Z, RATE, RATE)),
    "mass matrix": (DYNAMICS.mass_matrix, (Q,)),
    "terms": (DYNAMICS.terms, (Q, RATE)),
    "acceleration": (FORWARD.acceleration, (Z, RATE, TORQUE)),
    "acceleration of drives": (FORWARD.drive_acceleration, (Q, RATE, TORQUE)),
    "energy": (FORWARD.energy, (Z, RATE)),
    "forces": (FORCES.evaluate, (Z, RATE, RATE)),
    "coefficients of forces": (FORCES.coefficients, (Z, RATE, RATE)),
}


def arrays(found: Any) -> list[np.ndarray]:
    """All arrays and numbers in what was returned, in their order."""
    if isinstance(found, tuple):
        return [array for part in found for array in arrays(part)]
    if is_dataclass(found):
        held = [getattr(found, one.name) for one in fields(found)]
        return [np.asarray(one) for one in held if not isinstance(one, str)]
    return [np.asarray(found)]


@pytest.mark.parametrize("name", CALLS)
def test_a_vector_gives_what_its_row_gives(name: str) -> None:
    call, given = CALLS[name]
    many, one = arrays(call(*given)), arrays(call(*(array[1] for array in given)))
    rows = arrays(call(*(array[1:2] for array in given)))
    assert len(many) == len(one) == len(rows)
    for several, single, row in zip(many, one, rows, strict=True):
        assert several.shape == (3, *single.shape)
        assert row.shape == (1, *single.shape)
        np.testing.assert_array_equal(row[0], single)
        np.testing.assert_allclose(several[1], single, rtol=1e-12, atol=1e-15)


def test_lists_and_names_of_arguments_will_do() -> None:
    expected = DYNAMICS.inverse_dynamics(Q[0], RATE[0], RATE[0])
    assert expected.shape == (3,)
    found = DYNAMICS.inverse_dynamics(qdd=list(RATE[0]), q=tuple(Q[0]), qd=list(RATE[0]))
    np.testing.assert_array_equal(found, expected)
    whole = KINEMATICS.inverse([[0, 0, -1], [0, 0, -1]])
    assert whole.shape == (2, 3)


def test_one_load_goes_with_one_sample() -> None:
    load = np.array([0.5, -0.5, 0.2])
    found = DYNAMICS.regressor(Q[0], RATE[0], RATE[0], load=load)
    many = DYNAMICS.regressor(Q[:1], RATE[:1], RATE[:1], load=load[None])
    np.testing.assert_array_equal(found, many[0])


def test_no_samples_are_none() -> None:
    assert KINEMATICS.inverse(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("shape", [(), (2,), (4,), (3, 4), (1, 2, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(deltaid.DeltaidError, match=r"z: expected arrays of shape \(samples, 3\)"):
        KINEMATICS.inverse(np.zeros(shape))


def test_a_model_brings_its_parameters_to_all_that_computes() -> None:
    p = 1.5 * deltaid.prior_parameters(NAME)
    model = deltaid.load(deltaid.load_robot(NAME))
    for own, call, arguments in (
        (DYNAMICS.at(p), "torque", (Z, RATE, RATE)),
        (FORWARD.at(p), "acceleration", (Z, RATE, TORQUE)),
        (FORCES.at(p), "evaluate", (Z, RATE, RATE)),
    ):
        found = getattr(own, call)(*arguments)
        np.testing.assert_array_equal(found, getattr(own, call)(*arguments, p))
        assert not np.allclose(found, getattr(own, call)(*arguments, model.p))
        np.testing.assert_array_equal(own.p, p)
    np.testing.assert_array_equal(DYNAMICS.p, model.p)  # `at` leaves the other as it was


def test_a_motion_at_one_time() -> None:
    motion = FourierMotion(2.0, np.zeros(3), np.eye(3), 0.5 * np.eye(3))
    run = Run(motion, 0.1, 0.5, 1)
    for moving in (motion, run):
        many = moving.evaluate(np.array([0.2, 0.7]))
        one = moving.evaluate(0.7)
        for several, single in zip(many, one, strict=True):
            assert single.shape == (3,)
            np.testing.assert_allclose(several[1], single, rtol=1e-12)
