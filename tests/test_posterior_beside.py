"""What is identified beside the robot is averaged out of a posterior."""

import numpy as np
import pytest

import deltaid
from deltaid.dynamics.parameters import least_margin
from deltaid.identification.identify import identify
from deltaid.identification.marginal import base_covariance
from deltaid.recording.mapping import ColumnMapping
from stout_robot import ROBOT
from test_loads import table


@pytest.mark.parametrize("held", [pytest.param("cycles", marks=pytest.mark.slow), "always"])
def test_what_is_beside_the_robot_is_averaged_out(held: str) -> None:
    """Against the joint normal distribution of base parameters and of what is beside them."""
    columns = ColumnMapping(load=deltaid.Load(column="gripper"))
    found = identify(ROBOT, table(3, held, ROBOT), columns=columns)
    problem, record = found.problem, found.model.posterior
    assert record is not None
    assert problem.layout.added >= 10
    own, base = len(problem.p), problem.base
    K, robots = base.combination(), np.array([g.representative < own for g in base.groups])
    r, added = int(robots.sum()), problem.layout.added
    design = np.zeros((len(K), r + added))
    design[robots, :r] = np.eye(r)
    design[:, r:] = K[:, own:]
    scale = np.array([one.scale for one in problem.layout.parameters[own:]])
    prior = np.array([one.prior for one in problem.layout.parameters[own:]])
    size = np.sqrt(np.diag(base_covariance(problem)))
    information = np.linalg.inv(base_covariance(problem) / np.outer(size, size))
    unit = np.concatenate([size[robots], record.spread * scale])
    scaled = design / size[:, None] * unit
    H = scaled.T @ information @ scaled
    H[r:, r:] += np.eye(added)
    g = scaled.T @ information @ (problem.estimate.values / size)
    g[r:] += prior / (record.spread * scale)
    joint = np.linalg.inv(H)
    values = (joint @ g)[:r] * unit[:r]
    std = np.sqrt(np.diag(joint)[:r]) * unit[:r]
    np.testing.assert_allclose(np.linalg.norm(record.root, axis=1), std, rtol=1e-4)
    assert np.abs(np.array(record.values) - values).max() < 1e-3 * np.abs(values).max()
    assert np.all(np.abs(np.array(record.values) - values) < 1e-2 * std)
    wider = std / np.sqrt(np.diag(base_covariance(problem)))[robots]
    assert (wider.max() > 2) == (held == "always")
    assert min(least_margin(found.model.layout, p)[1] for p in found.model.sample(20).p) > 0
