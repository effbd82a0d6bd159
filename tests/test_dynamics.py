"""Dynamics against recordings of known truth, and what is refused; all terms: test_class.py."""

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError, KinematicsError
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
