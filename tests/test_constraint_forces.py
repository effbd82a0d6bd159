"""Constraint forces against MuJoCo's Lagrange multipliers, against torques, and by hand."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from composed import (
    SINGLE,
    SPACING,
    Make,
    describe,
    label,
    parameters,
    random_composed,
    random_states,
)
from composed import dynamics as composed_dynamics
from composed import twin as composed_twin
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from oracle.forces import ForceOracle
from support import example

SUMS = [Make(kind="par4"), Make(kind="i4", linear=True), Make(telescope=True, struts=1)]


def spaced(robot: RobotDescription, spacing: float | None = SPACING, **more: float):
    limbs = robot.limbs.changed(strut_spacing=spacing, **more)
    return robot.changed(limbs=limbs)


@cache
def twin(make: Make) -> tuple[ForceOracle, RobotDescription, np.ndarray]:
    """The oracle, the description with the oracle's spacing, and p."""
    oracle = random_composed(make, np.random.default_rng(11))
    if make.kind == "h4":  # a tool that the middle bar can carry
        oracle = replace(oracle, tool=np.array([0.0, 0.0, -0.07]))
    robot = describe(oracle, make)
    return ForceOracle.like(oracle), spaced(robot), parameters(oracle)


@pytest.mark.parametrize("make", SINGLE, ids=label)
def test_forces_are_the_lagrange_multipliers_of_the_cut_tree(make: Make) -> None:
    oracle, robot, p = twin(make)
    z, _, qd, qdd = random_states(oracle, np.random.default_rng(1), 5)
    forces = ConstraintForces(robot)
    found = forces.evaluate(z, qd, qdd, p)
    reference = [oracle.forces(*state) for state in zip(z, qd, qdd, strict=True)]
    expected = np.array([[row[name] for name in forces.names] for row in reference])
    assert set(forces.names) >= {"strut1a.platform.x", "strut3b.elbow.y", "motor2.moment.x"}
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)
    C = forces.coefficients(z, qd, qdd)
    np.testing.assert_allclose(C @ p / scale, expected / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("make", [*SINGLE, *SUMS], ids=label)
def test_what_drives_must_give_to_these_forces_is_their_torque(make: Make) -> None:
    """Virtual work, by the package's own regressor: torques without drives' friction and rotors."""
    if make in SUMS:
        robot, p = composed_twin(make).robot, composed_twin(make).p
        z, _, qd, qdd = random_states(composed_twin(make).oracle, np.random.default_rng(2), 5)
        dynamics = composed_dynamics(make)
    else:
        oracle, robot, p = twin(make)
        z, _, qd, qdd = random_states(oracle, np.random.default_rng(2), 5)
        dynamics = Dynamics(robot)
    drives = set(robot.drives)
    without = [
        0.0 if name.split(".")[1] in drives else value
        for name, value in zip(dynamics.layout.names, p, strict=True)
    ]
    tau = dynamics.torque(z, qd, qdd, np.array(without))
    forces = ConstraintForces(robot)
    found = forces.evaluate(z, qd, qdd, p)
    limbs = len(robot.limb_geometry)
    names = [f"motor{i + 1}.drive" for i in range(limbs)]
    names += ["telescope.drive"] if make.telescope else []
    mine = found[:, [forces.index(name) for name in names]]
    np.testing.assert_allclose(mine, tau, rtol=0, atol=1e-10 * np.abs(tau).max())


def test_a_hanging_mass_by_hand() -> None:
    """Massless struts, a mass off the platform's centre: Newton's second law and three moments."""
    robot = spaced(load_robot("clavel-delta3"), 0.1)
    dynamics, forces = Dynamics(robot), ConstraintForces(robot)
    p = np.zeros(len(dynamics.layout.names))
    mass, offset = 3.0, np.array([0.02, -0.01, -0.04])
    p[dynamics.layout.body("P")][:4] = [mass, *(mass * offset)]
    z, zero = np.array([[0.05, -0.08, -0.75]]), np.zeros((1, 3))
    F = forces.evaluate(z, zero, zero, p)[0]
    pull, moment = np.zeros(3), np.zeros(3)
    q = dynamics.kinematics.inverse(z)[0]
    for i, limb in enumerate(robot.limb_geometry):
        elbow = limb.base + limb.R_WL @ [
            limb.upper_arm * np.cos(q[i]), 0, -limb.upper_arm * np.sin(q[i])
        ]  # fmt: skip
        for letter, side in (("a", 0.05), ("b", -0.05)):
            end = z[0] + limb.attachment + side * limb.R_WL[:, 1]
            along = (end - elbow - side * limb.R_WL[:, 1]) / limb.strut
            tension = F[forces.index(f"strut{i + 1}{letter}.platform.x")]
            assert tension == pytest.approx(F[forces.index(f"strut{i + 1}{letter}.elbow.x")])
            pull -= tension * along
            moment -= tension * np.cross(end - z[0], along)
    weight = mass * np.array(robot.gravity)
    np.testing.assert_allclose(pull, -weight, atol=1e-12)
    np.testing.assert_allclose(moment, -np.cross(offset, weight), atol=1e-12)


def test_without_spacing_the_sum_of_a_pair() -> None:
    oracle, robot, p = twin(SINGLE[1])
    z, _, qd, qdd = random_states(oracle, np.random.default_rng(3), 4)
    single, sums = ConstraintForces(robot), ConstraintForces(spaced(robot, None))
    assert sums.struts == ("strut1", "strut2", "strut3")
    assert "strut_spacing" in sums.note
    single_forces, pair_forces = (f.evaluate(z, qd, qdd, p) for f in (single, sums))
    for i in (1, 2, 3):
        for end in ("platform.x", "platform.z", "elbow.x", "elbow.moment"):
            pair = sum(single_forces[:, single.index(f"strut{i}{s}.{end}")] for s in "ab")
            np.testing.assert_allclose(
                pair_forces[:, sums.index(f"strut{i}.{end}")], pair, atol=1e-9
            )
        name = f"motor{i}.force.x"
        np.testing.assert_allclose(
            pair_forces[:, sums.index(name)], single_forces[:, single.index(name)]
        )
        assert f"motor{i}.moment.x" not in sums.names


def test_overconstrained_platforms_say_so() -> None:
    robot = spaced(load_robot("par4"))
    forces = ConstraintForces(robot)
    assert "stiff" in forces.note
    assert forces.struts[0] == "strut1"


def test_one_strut_has_no_spacing() -> None:
    with pytest.raises(DescriptionError, match="strut_spacing: is given"):
        load_robot("clavel-delta3").limbs.changed(struts_per_limb=1, strut_spacing=0.1)


def test_own_mechanism_is_refused() -> None:
    with pytest.raises(DescriptionError, match="which joints carry them"):
        ConstraintForces(example("heli4"))
