"""Dynamics against recordings of known truth, and what is refused; all terms: test_class.py."""

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError, KinematicsError
from deltaid.model.model import Model
from geometries import generic_states
from recordings import stored_robot, stored_rows
from test_oracle import inward_solution_from_pi


@pytest.mark.parametrize("name", ["delta3", "delta4"])
def test_truth_predicts_the_exact_recording(name: str) -> None:
    """Within 1e-7 of the largest torque, but for rows that rounding corrupted when recorded.

    `test_oracle.test_recording` says which those are and why; delta3 has none that matters.
    """
    stored, (q, qd, qdd, tau) = stored_robot(name), stored_rows(name)
    dynamics = Dynamics(stored.robot)
    difference = np.abs(dynamics.inverse_dynamics(q, qd, qdd, stored.p) - tau)
    error = difference.max(axis=1) / np.abs(tau).max()
    sound = np.ones(len(error), bool)
    if name == "delta4":
        sound = inward_solution_from_pi(stored.oracle, dynamics.kinematics.forward(q), q) > 3e-3
        assert sound.mean() > 0.95
    assert np.median(error) < 1e-11
    assert error[sound].max() < 1e-7


@pytest.mark.parametrize("method", ["inverse_dynamics", "regressor", "mass_matrix", "terms"])
def test_angles_that_close_no_loop_are_refused(method: str, irb360: Dynamics) -> None:
    _, q, qd, qdd = generic_states(irb360, 3)
    q[1, :3] = [-1.5, 1.5, 3.0]
    p = prior_parameters(irb360.robot)
    arguments = {
        "inverse_dynamics": (q, qd, qdd, p),
        "regressor": (q, qd, qdd),
        "mass_matrix": (q, p),
        "terms": (q, qd, p),
    }
    with pytest.raises(KinematicsError, match="sample 1"):
        getattr(irb360, method)(*arguments[method])


def test_wrong_number_of_parameters_is_refused(irb360: Dynamics) -> None:
    z, _, qd, qdd = generic_states(irb360, 3)
    with pytest.raises(DescriptionError, match=r"shape \(70,\), but the robot has 71 parameters"):
        irb360.torque(z, qd, qdd, np.zeros(70))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("method", "arguments"),
    [
        ("torque", ("z", "qd", "qdd")),
        ("inverse_dynamics", ("q", "qd", "qdd")),
        ("regressor", ("q", "qd", "qdd")),
        ("terms", ("q", "qd")),
        ("carried", ("z", "qd", "qdd")),
    ],
)
def test_numbers_that_are_not_finite_are_named(
    method: str, arguments: tuple[str, ...], value: float, irb360: Dynamics
) -> None:
    z = np.tile(irb360.kinematics.home, (3, 1))
    state = {"z": z, "q": irb360.kinematics.inverse(z), "qd": 0 * z, "qdd": 0 * z}
    good = [state[name] for name in arguments]
    for k, name in enumerate(arguments[1:], 1):
        given = [array.copy() for array in good]
        given[k][2, 1] = value
        with pytest.raises(KinematicsError, match=rf"{name}\[2, 1\]: is {value:g}, not a finite"):
            getattr(irb360, method)(*given)
        with pytest.raises(KinematicsError, match=rf"{name}\[0, 1\]: is {value:g}"):
            getattr(irb360, method)(*(array[2] for array in given))
    if "q" in arguments:
        q = state["q"].copy()
        q[2, 1] = value
        with pytest.raises(KinematicsError, match=rf"q\[2, 1\]: is {value:g}, not a finite"):
            getattr(irb360, method)(q, *good[1:])
    if method != "regressor":
        p = prior_parameters(irb360.robot)
        p[-1] = value
        wrong = rf"p\[{len(p) - 1}\]: is {value:g}, but {irb360.layout.names[-1]} must be"
        with pytest.raises(DescriptionError, match=wrong):
            getattr(irb360, method)(*good, p)
        with pytest.raises(DescriptionError, match=wrong):
            Model(irb360.robot, p)


def test_a_pose_out_of_reach_has_no_torque(irb360: Dynamics) -> None:
    nowhere = np.full((1, irb360.dof), np.nan)
    assert np.isnan(irb360.torque(nowhere, nowhere, nowhere)).all()
